"""Sphinx configuration: MyST pages, every example executed, every warning an error (-W)."""

from importlib.metadata import version as installed

project = "trimtab"
version = release = installed("trimtab")
author = "trimtab maintainers"
copyright = "trimtab maintainers, MIT licence"

extensions = ["myst_nb"]
exclude_patterns = ["_build"]
nitpicky = True

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_execution_raise_on_error = True
nb_execution_timeout = 120

html_theme = "furo"
html_title = f"trimtab {release}"

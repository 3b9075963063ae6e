"""Sphinx configuration: MyST pages, every example executed, every warning an error (-W)."""

import os
import sys
import tempfile
import uuid
from importlib.metadata import version as installed
from pathlib import Path

from jupyter_client.connect import ConnectionFileMixin

os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"  # pages run `trimtab`

project = "trimtab"
version = release = installed("trimtab")
author = "trimtab maintainers"
copyright = "trimtab maintainers, MIT licence"

extensions = ["myst_nb"]
exclude_patterns = ["_build"]
suppress_warnings = ["toc.empty_glob"]
nitpicky = True

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
# Pages run side by side, and two kernels can draw the same free TCP port: they talk over files, of a name for each.
sockets = tempfile.TemporaryDirectory()
ConnectionFileMixin.transport.default_value = "ipc"
ConnectionFileMixin._ip_default = lambda _: f"{sockets.name}/{uuid.uuid4().hex}"

html_theme = "furo"
html_title = f"trimtab {release}"

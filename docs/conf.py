"""Sphinx configuration: MyST pages, every example executed, every warning an error (-W)."""

import os
import sys
import tempfile
import uuid
from importlib.metadata import version as installed
from pathlib import Path

import jupyter_client

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

sockets = tempfile.TemporaryDirectory()


class OverFiles(jupyter_client.AsyncKernelManager):
    """Pages run side by side, and two kernels can draw the same free TCP port: these talk over files of their own."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)
        self.transport, self.ip = "ipc", f"{sockets.name}/{uuid.uuid4().hex}"


jupyter_client.AsyncKernelManager = OverFiles

html_theme = "furo"
html_title = f"trimtab {release}"

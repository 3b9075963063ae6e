"""Sphinx configuration: MyST pages, every example executed, every warning an error (-W)."""

import os
import sys
import tempfile
import uuid
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

import jupyter_client
import myst_nb.core.render
import sphinx.application
from jupyter_client.provisioning import local_provisioner

sys.path.insert(0, str(Path(__file__).parent))
import kernels

os.environ["COLUMNS"] = "90"  # a page is as wide: tables of commands are cut to it
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"  # pages run `trimtab`
ROOT = str(Path(__file__).parents[1])  # and import the studies beside the package
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (ROOT, os.environ.get("PYTHONPATH"))))

project = "trimtab"
version = release = installed("trimtab")
author = "trimtab maintainers"
copyright = "trimtab maintainers, MIT licence"

extensions = ["myst_nb", "reference_pages"]
exclude_patterns = ["_build"]
suppress_warnings = ["toc.empty_glob"]
nitpicky = True

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_merge_streams = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120
if os.environ.get("TRIMTAB_PAGES") == "unexecuted":
    # Links, references and markup only, as at the gate. tests/docs/test_pages.py builds all pages with their cells.
    nb_execution_mode = "off"
    suppress_warnings += ["myst-nb.lexer"]  # a page says its language only once a kernel has run it

sockets = tempfile.TemporaryDirectory()


class OverFiles(jupyter_client.AsyncKernelManager):
    """Pages run side by side, and two kernels can draw the same free TCP port: these talk over files of their own."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)
        self.transport, self.ip = "ipc", f"{sockets.name}/{uuid.uuid4().hex}"


jupyter_client.AsyncKernelManager = OverFiles


def join_streams(outputs: list[Any]) -> list[Any]:
    """A cell's text in one piece, before its pictures: a command's arrives in pieces that end within a line."""
    texts: dict[str, Any] = {}
    for output in (o for o in outputs if o["output_type"] == "stream"):
        if output["name"] in texts:
            texts[output["name"]]["text"] += output["text"]
        else:
            texts[output["name"]] = output
    return [*texts.values(), *(o for o in outputs if o["output_type"] != "stream")]


myst_nb.core.render.coalesce_streams = join_streams

LONGEST = ("studies/", "design/any-vehicle", "laws/rotor-loss", "tutorial/", "plots/runs", "estimators/flexible-modes")
"""Pages that take longest, begun first: what is begun last keeps one core waiting."""


def before_reading(app: sphinx.application.Sphinx, env: object, pages: list[str]) -> None:
    """Put the longest pages first, and have the kernels forked from one that is warm."""
    pages.sort(key=lambda page: (not page.startswith(LONGEST), page))
    if pages and nb_execution_mode != "off" and sys.platform == "linux":
        kernels.start(sockets.name)
        local_provisioner.launch_kernel = kernels.launch


def after_building(app: sphinx.application.Sphinx, error: Exception | None) -> None:
    """Say which pages took longest to run."""
    took = {p: (found.get("exec_data") or {}).get("runtime") or 0.0 for p, found in app.env.nb_metadata.items()}
    print("longest pages: " + ", ".join(f"{p} {took[p]:.0f} s" for p in sorted(took, key=took.get)[:-13:-1]))


def setup(app: sphinx.application.Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("env-before-read-docs", before_reading)
    app.connect("build-finished", after_building)


html_theme = "furo"
html_title = f"trimtab {release}"

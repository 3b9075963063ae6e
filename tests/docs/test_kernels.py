"""Kernels of the pages are forked from one server; each is a fresh process without state of other pages."""

import importlib.util
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import pytest
from jupyter_client.provisioning import local_provisioner
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError
from nbformat.v4 import new_code_cell, new_notebook
from traitlets.config import Config

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each page starts a kernel of its own"),
]
FILE = Path(__file__).parents[2] / "docs" / "kernels.py"
spec = importlib.util.spec_from_file_location("kernels", FILE)
kernels = importlib.util.module_from_spec(spec)
spec.loader.exec_module(kernels)


@pytest.fixture(scope="module")
def folder():
    """Of the server and of the files it talks over; short, for their names are limited."""
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        patch.setenv(kernels.ADDRESS, "")
        patch.setattr(local_provisioner, "launch_kernel", kernels.launch)
        server = kernels.start(name)
        yield Path(name)
        server.communicate(timeout=20)


def execute(folder, *cells, timeout=60):
    """Run cells as a page's are; gives the outputs of each."""
    page = new_notebook(cells=[new_code_cell(c) for c in cells])
    files = Config(AsyncKernelManager={"transport": "ipc", "ip": str(folder / f"k{time.monotonic_ns()}")})
    NotebookClient(page, timeout=timeout, config=files, resources={"metadata": {"path": str(folder)}}).execute()
    return [c.outputs for c in page.cells]


def printed(outputs):
    return json.loads("".join(o.text for o in outputs))


ABOUT = """
import json, os, sys
print(json.dumps([os.getpid(), os.getppid(), "left" in globals(), "left" in os.environ,
    "jax" in sys.modules, "trimtab" in sys.modules, os.getcwd(), os.getpgid(0), sys.stdin.fileno()]))
"""
LEAVE = "left = 1; os.environ['left'] = '1'; sys.modules['trimtab'] = 1; sys.modules.pop('jax'); os.chdir('/')"


def test_each_kernel_is_a_fresh_process(folder):
    first, _, after = execute(folder, ABOUT, LEAVE, ABOUT)
    first, after = printed(first), printed(after)
    assert after[2:6] == [True, True, False, True]
    second = printed(execute(folder, ABOUT)[0])
    for found in (first, second):
        assert found[2:6] == [False, False, True, False], "as a kernel that was started, with JAX imported already"
        assert found[6] == str(folder)
        assert found[7] == found[0], "a group of its own, which is interrupted and killed with what it runs"
    assert first[0] != second[0]
    assert first[1] == second[1]


def test_forked_kernel_draws_pictures(folder):
    (outputs,) = execute(folder, "import matplotlib.pyplot as plt\nplt.plot([1, 2]);")
    assert any("image/png" in o.get("data", {}) for o in outputs)


def test_cell_error_is_raised(folder):
    with pytest.raises(CellExecutionError, match="one over zero"):
        execute(folder, "raise ValueError('one over zero')")


def test_too_slow_cell_is_stopped_by_timeout(folder):
    began = time.monotonic()
    with pytest.raises(CellTimeoutError):
        execute(folder, "import time\nwhile True: time.sleep(0.01)", timeout=1)
    assert time.monotonic() - began < 15


def test_kernel_exit_is_detected_and_terminated_kernel_exits(folder):
    argv = [sys.executable, "-m", "ipykernel_launcher", "-f"]
    one, other = (kernels.launch([*argv, str(folder / f)], env=os.environ, cwd=str(folder)) for f in ("a", "b"))
    assert one.poll() is None
    one.kill()
    assert one.wait(timeout=20) == 0
    assert other.poll() is None
    other.terminate()
    assert other.wait(timeout=20) == 0

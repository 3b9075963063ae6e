"""Kernels of the pages: one process for each page, forked from one that has imported what pages import.

Python, JAX, SciPy and Matplotlib take three seconds of a core to start, and there are more than a hundred pages. The
server (this file, run by itself) imports them once and runs nothing of any page, so what is forked from it is as new as
a process of its own. trimtab it leaves alone: each page imports that, and finds out whether its imports are enough.

Only the start differs. jupyter_client gives a kernel its connection file, interrupts it when a cell takes too long and
kills it in the end as it does with one that it started.
"""

import atexit
import importlib
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

WARM = ("ipykernel.kernelapp", "ipykernel.ipkernel", "jax", "jax.numpy", "matplotlib.pyplot")
WARM += ("scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.stats")
"""What most pages import, and nothing that asks for a shell or starts a thread of its own while it is imported."""


class Forked:
    """A kernel as `subprocess.Popen` would show it: what jupyter_client's local provisioner asks of a process."""

    stdin = stdout = stderr = None

    def __init__(self, command: list[str], env: Mapping[str, str], cwd: str | None) -> None:
        self._line = socket.socket(socket.AF_UNIX)
        self._line.connect(os.environ[ADDRESS])
        argv = command[command.index("ipykernel_launcher") + 1 :]
        asked = {"argv": argv, "env": dict(env), "cwd": cwd or os.getcwd()}
        with self._line.makefile("rw", encoding="utf-8") as text:
            print(json.dumps(asked), file=text, flush=True)
            self.pid = int(text.readline())

    def wait(self, timeout: float | None = None) -> int | None:
        """0 when it has ended, for then its end of the line is closed; None if it lives on after timeout (s)."""
        if self._line.fileno() >= 0:
            with selectors.DefaultSelector() as lines:
                lines.register(self._line, selectors.EVENT_READ)
                if not lines.select(timeout):
                    return None
            self._line.close()
        return 0

    def poll(self) -> int | None:
        """None while it lives."""
        return self.wait(0)

    def send_signal(self, signum: int) -> None:
        """To the kernel alone."""
        if self.poll() is None:
            os.kill(self.pid, signum)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


ADDRESS = "TRIMTAB_DOCS_KERNELS"
"""Environment variable: the file at which the server listens."""


def launch(command: list[str], *, env: Mapping[str, str], cwd: str | None = None, **_: Any) -> Forked:
    """In place of jupyter_client's launch_kernel."""
    return Forked(command, env, cwd)


def start(folder: str) -> subprocess.Popen[bytes]:
    """Start the server. It listens at a file in the folder, and ends with this process, and its kernels with it."""
    os.environ[ADDRESS] = str(Path(folder) / "kernels")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(os.environ[ADDRESS])
        listener.listen(100)
        command = [sys.executable, __file__, str(listener.fileno())]
        inline = os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}  # as a kernel does
        how = {"stdin": subprocess.PIPE, "pass_fds": (listener.fileno(),), "start_new_session": True}
        server = subprocess.Popen(command, env=inline, **how)
    atexit.register(server.communicate)  # closes its standard input, on which it ends
    return server


def serve(listener: socket.socket) -> socket.socket | None:
    """Fork for each who calls, until standard input is closed; in the fork, give the line to who called."""
    for name in WARM:
        importlib.import_module(name)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # who called sees that a kernel ended: nobody waits for it here
    with listener, selectors.DefaultSelector() as sources, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # a fork beside threads: BLAS's, which expect it
        sources.register(listener, selectors.EVENT_READ)
        sources.register(sys.stdin, selectors.EVENT_READ)
        while all(key.fileobj is listener for key, _ in sources.select()):
            line, _ = listener.accept()
            if os.fork() == 0:
                return line
            line.close()
    return None


def become(line: socket.socket) -> None:
    """Be the kernel that was asked for. Its end closes the line."""
    os.setsid()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    with line.makefile("rw", encoding="utf-8") as text:
        asked = json.loads(text.readline())
        print(os.getpid(), file=text, flush=True)
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    os.environ.clear()
    os.environ.update(asked["env"])
    os.chdir(asked["cwd"])
    application = importlib.import_module("ipykernel.kernelapp").IPKernelApp
    application.launch_instance([*asked["argv"], f"--IPKernelApp.parent_handle={os.getppid()}"])


if __name__ == "__main__":
    del sys.path[0]  # this folder
    called = serve(socket.socket(fileno=int(sys.argv[1])))
    if called is not None:
        become(called)

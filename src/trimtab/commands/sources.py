"""Which files a run was made from: those of the package, and the user's own, as loaded and as read.

Importing this brings neither JAX nor numpy along. Import it before a scenario is loaded: `is_settled` tells files that
were changed since, and may hold something else than what was loaded from them.
"""

import functools
import hashlib
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

PACKAGE = os.path.realpath(Path(__file__).parents[1])
SITES = ("site-packages", "dist-packages")
"""Names of the folders in which packages are installed."""
START_NS = time.time_ns()
SETTLING_NS = 2_000_000_000
"""How old a file must have been then: the coarsest file systems round the time of a change to 2 s."""

_readers: list[set[str]] = []


def sha256(path: str) -> str:
    """SHA-256 of a file's contents, as text."""
    with open(path, "rb", buffering=0) as stream:
        return hashlib.sha256(stream.read()).hexdigest()


def fingerprint(files: Iterable[str]) -> str:
    """SHA-256 over names and contents of files."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path}\0{sha256(path)}\n".encode(errors="surrogateescape"))
    return digest.hexdigest()


def list_package_files() -> list[str]:
    """Every file of the trimtab package but hidden and compiled ones: Python, C, and data."""
    found: list[str] = []
    for folder, below, names in os.walk(PACKAGE):
        below[:] = [b for b in below if b != "__pycache__" and not b.startswith(".")]
        found += [os.path.join(folder, name) for name in names if not name.startswith(".")]
    return sorted(found)


def is_settled(path: str) -> bool:
    """Whether a file was last changed well before this program began, so that what was loaded is what it holds."""
    about = os.stat(path)
    return max(about.st_mtime_ns, about.st_ctime_ns) < START_NS - SETTLING_NS


def list_loaded_files() -> list[str]:
    """The files of all modules loaded by now that are neither Python's own, nor installed packages, nor trimtab's."""
    files = {getattr(module, "__file__", None) for module in list(sys.modules.values())}
    command = getattr(sys.modules.get("__main__"), "__file__", None)
    if command and os.path.dirname(command) == os.path.dirname(sys.executable):
        files.discard(command)  # the command trimtab itself
    return _select_user_files(file for file in files if isinstance(file, str))


@contextmanager
def record_read_files() -> Iterator[set[str]]:
    """The files that are opened for reading meanwhile, e.g. a trace that a scenario loads; filled in at the end.

    Python's own files, installed packages, trimtab's files, and devices are left out.
    """
    _install_audit_hook()
    seen: set[str] = set()
    found: set[str] = set()
    _readers.append(seen)
    try:
        yield found
    finally:
        _readers[:] = [r for r in _readers if r is not seen]
        found.update(p for p in _select_user_files(seen) if not p.endswith(".pyc") and not os.path.isdir(p))


@functools.cache
def _install_audit_hook() -> None:
    sys.addaudithook(_record_open)  # cannot be taken away again: once is enough


def _record_open(event: str, given: tuple[Any, ...]) -> None:
    if event != "open" or not _readers:
        return
    with suppress(Exception):  # what is raised here would come out of the open() that is watched
        if (given[2] or 0) & (os.O_WRONLY | os.O_RDWR) != os.O_WRONLY and not isinstance(given[0], int):
            path = os.path.abspath(os.fsdecode(given[0]))
            for seen in _readers:
                seen.add(path)


def _select_user_files(files: Iterable[str]) -> list[str]:
    import sysconfig

    own = sysconfig.get_paths()
    apart = {own[k] for k in ("stdlib", "platstdlib", "purelib", "platlib")} | {os.path.dirname(os.__file__), PACKAGE}
    apart |= {os.path.realpath(p) for p in apart}
    starts = (*(os.path.join(p, "") for p in apart), "/dev/", "/proc/", "/sys/")
    found: set[str] = set()
    for path in {os.path.abspath(file) for file in list(files)}:
        inside = path.startswith(starts) or any(f"{os.sep}{site}{os.sep}" in path for site in SITES)
        if not inside and not os.path.realpath(path).startswith(starts):
            found.add(path)
    return sorted(found)

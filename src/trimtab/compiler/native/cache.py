"""Cache of compiled libraries, in folders that only this user can write to.

An entry is a library KEY.so and a manifest KEY.txt with the library's checksum. Both are written under other names and
then renamed, the manifest last, so an entry is either complete or absent. A library that does not match its manifest is
ignored. Libraries are stored in the user's cache or, if that cannot be used, in a folder that is removed at the end of
the process.
"""

import contextlib
import os
import stat
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from trimtab.core.cache_folder import cache_folder, is_owned_by_user

LIMIT = 512 * 2**20
"""Maximum size of the cache in bytes. Beyond it, the least recently used entries are removed."""
PATIENCE = 300.0
"""Maximum time (s) to wait for another process that builds the same library."""
DAY = 86400.0
MAKE_ROOM_FIX = (
    "free some space, or set TRIMTAB_CACHE to a folder that only you can write to, and in which programs can run."
)
"""Fix that the error suggests if no cache folder can be used."""

_private_folders: list[Path] = []
_folder_problems: list[str] = []

Result = TypeVar("Result")


def cached_library_folder() -> Path:
    """Return the folder of libraries that are kept for later processes. Raise OSError if no folder is safe."""
    return _check_runnable(cache_folder("c"))


def private_folder() -> Path:
    """Return a folder that only this process uses. It is removed at the end of the process."""
    if not _private_folders or not _private_folders[-1].is_dir():
        import atexit
        import shutil
        import tempfile

        folder, maker = Path(tempfile.mkdtemp(prefix="trimtab-")).absolute(), os.getpid()
        # A forked child inherits this registration, and must not remove the folder that its parent still uses.
        atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == maker else None)
        _private_folders.append(folder)
    return _check_runnable(_private_folders[-1])


def cache_problem() -> str:
    """Return the reason why this process cannot use the user's cache and compiles everything again, else ""."""
    return _folder_problems[-1] if _folder_problems else ""


def try_folders(action: Callable[[Path], Result]) -> Result:
    """Return the result of the action in the first folder where it succeeds. Raise OSError if all folders fail."""
    reasons: list[str] = []
    for folder in (cached_library_folder, private_folder):
        try:
            return action(folder())
        except OSError as reason:
            reasons.append(str(reason))
            if folder is cached_library_folder:
                _folder_problems.append(str(reason))
    raise OSError("; ".join(dict.fromkeys(reasons)))


def find_library(key: str) -> Path | None:
    """Return the cached library for this key, or None if it is missing or damaged."""
    with contextlib.suppress(OSError):
        if library := find_in_folder(cached_library_folder(), key):
            return library
    return find_in_folder(_private_folders[-1], key) if _private_folders else None


def find_in_folder(folder: Path, key: str) -> Path | None:
    """Return the library for this key in a folder, or None if it is missing or its owner, mode or checksum is wrong."""
    manifest, library = folder / f"{key}.txt", folder / f"{key}.so"
    said = _parse_manifest(read_private_file(manifest))
    content = read_private_file(library)
    if content is None or said.get("key") != key or said.get("sha256") != sha256(content).hexdigest():
        return None
    with contextlib.suppress(OSError):
        if time.time() - manifest.stat().st_mtime > 3600.0:
            os.utime(manifest)
    return library


def store_library(folder: Path, key: str, library: Path, about: dict[str, str]) -> Path:
    """Move a finished library from the work folder into the cache, as the entry for this key. Return its path."""
    library.chmod(0o700)
    with library.open("rb+") as file:
        said = {"key": key, "sha256": sha256(file.read()).hexdigest(), **about}
        os.fsync(file.fileno())
    taken = folder / f"{key}.so"
    os.replace(library, taken)
    write_atomically(folder / f"{key}.txt", "".join(f"{name} {value}\n" for name, value in said.items()))
    _remove_old_entries(folder, spare=key)
    return taken


def read_private_file(path: Path) -> bytes | None:
    """Return the content of a file, or None unless it is a regular file that only this user can write to."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return None
    with open(descriptor, "rb") as file:
        about = os.fstat(descriptor)
        if not stat.S_ISREG(about.st_mode) or not is_owned_by_user(about):
            return None
        try:
            return file.read()
        except OSError:
            return None


def write_atomically(path: Path, text: str) -> None:
    """Write a file atomically: it is either complete or absent."""
    with work_folder(path.parent) as work:
        draft = work / "draft"
        with draft.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        draft.chmod(0o600)
        os.replace(draft, path)


@contextlib.contextmanager
def work_folder(folder: Path) -> Iterator[Path]:
    """Create a temporary folder in the given folder that only this user can access, and remove it at the end."""
    import shutil
    import tempfile

    work = Path(tempfile.mkdtemp(prefix="tmp-", dir=folder))
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


@contextlib.contextmanager
def lock_key(folder: Path, key: str) -> Iterator[None]:
    """Wait while another process builds the library of this key. Without a lock, both processes build the library,
    which does no harm."""
    from filelock import FileLock  # imported here: the import takes longer than the use of an existing library

    name = folder / f"{key}.lock"
    lock = FileLock(name, timeout=PATIENCE, mode=0o600, poll_interval=0.02)
    with contextlib.suppress(OSError):
        lock.acquire()
    try:
        yield
    finally:
        if lock.is_locked:
            with contextlib.suppress(OSError):  # while locked, so that no other process's lock is removed
                name.unlink()
            with contextlib.suppress(OSError):
                lock.release()


def _check_runnable(folder: Path) -> Path:
    if hasattr(os, "ST_NOEXEC") and os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise PermissionError(f"{folder} is on a file system that runs no programs (mounted noexec)")
    return folder


def _parse_manifest(content: bytes | None) -> dict[str, str]:
    lines = (content or b"").decode("utf-8", "replace").splitlines()
    return {name: value for name, _, value in (line.partition(" ") for line in lines)}


def _remove_old_entries(folder: Path, spare: str) -> None:
    """Remove files of interrupted builds after a day, and the least recently used entries beyond the size limit."""
    now, whole, total = time.time(), [], 0
    for name, ends in _files_by_key(folder).items():
        used = max(about.st_mtime for about in ends.values())
        if ends.keys() == {".so", ".txt"}:
            whole.append((used, name))
            total += ends[".so"].st_size
        elif now - used > DAY:
            for end in ends:
                _remove_path(folder / f"{name}{end}")
    for _, name in sorted(whole):
        if total <= LIMIT:
            break
        if name != spare:
            library = folder / f"{name}.so"
            with contextlib.suppress(OSError):
                total -= library.stat().st_size
            _remove_path(folder / f"{name}.txt")
            _remove_path(library)


def _files_by_key(folder: Path) -> dict[str, dict[str, os.stat_result]]:
    found: dict[str, dict[str, os.stat_result]] = {}
    with contextlib.suppress(OSError), os.scandir(folder) as files:
        for file in files:
            with contextlib.suppress(OSError):
                name, end = os.path.splitext(file.name)
                found.setdefault(name, {})[end] = file.stat(follow_symlinks=False)
    return {name: ends for name, ends in found.items() if ends}


def _remove_path(path: Path) -> None:
    import shutil

    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()

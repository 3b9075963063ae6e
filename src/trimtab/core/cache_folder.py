"""The user's cache: folders of this user's alone, for code that will be run again."""

import os
from pathlib import Path


def cache_folder(name: str) -> Path:
    """The folder `name` of the cache, made if need be: absolute, this user's own, writable by nobody else.

    The cache is $TRIMTAB_CACHE, else trimtab below $XDG_CACHE_HOME or ~/.cache. That the file system is full or
    read-only shows only when something is written.

    Raises OSError where there can be no such folder, PermissionError where it isn't safe to run what lies there.
    """
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = Path(os.environ.get("TRIMTAB_CACHE") or cache / "trimtab").absolute() / name
    except RuntimeError as unknown:
        raise FileNotFoundError(f"no home folder: {unknown}") from unknown
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not is_owned_by_user(folder.stat()):
        raise PermissionError(f"{folder} belongs to somebody else, or others can write to it")
    return folder


def is_owned_by_user(about: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user and nobody else can write to it."""
    return not hasattr(os, "getuid") or (about.st_uid == os.getuid() and not about.st_mode & 0o022)

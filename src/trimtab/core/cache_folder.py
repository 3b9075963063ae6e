"""Cache folders for compiled code that later runs use again. Only the user can write to these folders."""

import hashlib
import os
from pathlib import Path


def cache_folder(name: str) -> Path:
    """Return the absolute path of the folder `name` in the cache. Create the folder if it is missing.

    Only this user can write to the folder.

    The cache is the folder named by the environment variable TRIMTAB_CACHE, if it is set. Otherwise the cache is the
    folder `trimtab` in the user's cache folder: on Linux in $XDG_CACHE_HOME or ~/.cache, on macOS in ~/Library/Caches.
    Raises OSError if the folder cannot be created, and PermissionError if other users could change the code in the
    folder. A full or read-only file system is detected only at the first write.
    """
    cache = os.environ.get("TRIMTAB_CACHE")
    if not cache:
        import platformdirs  # imported here: the import is slow

        try:
            cache = platformdirs.user_cache_dir("trimtab", appauthor=False)
        except RuntimeError as unknown:
            raise FileNotFoundError(f"the home folder is unknown: {unknown}") from unknown
    folder = Path(cache).absolute() / name
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not is_owned_by_user(folder.stat()):
        raise PermissionError(f"{folder} belongs to another user, or others can write to it")
    return folder


def enable_cache() -> None:
    """Enable JAX's compilation cache, in the folder `jax` of this package's cache, if this folder is writable."""
    import jax

    try:
        folder = cache_folder("jax")
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def package_stamp() -> str:
    """Return a hash that changes with the package's files. For speed, only names, sizes and times are hashed."""
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    about = [f"{file} {(s := file.stat()).st_mtime_ns} {s.st_size}" for file in files]
    return hashlib.sha256("\n".join(about).encode()).hexdigest()


def is_owned_by_user(about: os.stat_result) -> bool:
    """Return True if a file or folder belongs to this user and nobody else can write to it."""
    return not hasattr(os, "getuid") or (about.st_uid == os.getuid() and not about.st_mode & 0o022)

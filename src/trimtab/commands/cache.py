"""The cache of compiled programs: a folder of this user's alone, so that a second run starts faster."""

import os
from pathlib import Path

import jax


def use_cache() -> None:
    """Keep compiled programs between runs, where a folder for it can be had; without one everything still works.

    The folder is $TRIMTAB_CACHE, else trimtab below $XDG_CACHE_HOME or ~/.cache. It holds code that will be run, so it
    is refused when it belongs to somebody else or others can write to it.
    """
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = Path(os.environ.get("TRIMTAB_CACHE") or cache / "trimtab") / "jax"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = folder.stat()
    except (OSError, RuntimeError):
        return
    if hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022):
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

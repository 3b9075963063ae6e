"""The cache of compiled programs: a folder of this user's alone, so that a second run starts faster."""

import os

import jax

from trimtab.core.cache_folder import cache_folder


def enable_cache() -> None:
    """Keep compiled programs between runs, where a folder for it can be had; without one everything still works.

    It is the folder `jax` of the cache, see `cache_folder`. It holds code that will be run, so it is refused when it
    belongs to somebody else or others can write to it.
    """
    try:
        folder = cache_folder("jax")
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

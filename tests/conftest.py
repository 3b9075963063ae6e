"""Property tests: no deadline (first calls compile), and the same examples each time in CI. Memory: file by file.

What XLA compiles is kept beside pytest's own cache, so that after an edit only what it touched is compiled again; and
XLA's older emitters, which compile in half the time.
"""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

settings.register_profile("trimtab", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("trimtab")


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_are_dropped():
    """What one file compiled is of no use to the next, and takes gigabytes in the end."""
    yield
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()

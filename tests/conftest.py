"""Property tests: no deadline (first calls compile), and the same examples each time in CI. Memory: file by file."""

import os
import sys

import pytest
from hypothesis import settings

settings.register_profile("trimtab", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("trimtab")


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_are_dropped():
    """What one file compiled is of no use to the next, and takes gigabytes in the end."""
    yield
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()

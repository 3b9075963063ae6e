"""Property tests: no deadline (first calls compile), and the same examples each time in CI."""

import os

from hypothesis import settings

settings.register_profile("trimtab", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("trimtab")

"""The same dialect and the same two ends of a line as in the tests of mavlink."""

from flight.mavlink.conftest import _own_cache, clock, dialect, open_pair, pair

__all__ = ["_own_cache", "clock", "dialect", "open_pair", "pair"]

"""The dialect and endpoint pairs of the tests of mavlink."""

from flight.mavlink.conftest import _own_cache, clock, dialect, open_pair, pair

__all__ = ["_own_cache", "clock", "dialect", "open_pair", "pair"]

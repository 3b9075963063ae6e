"""A dialect with every kind of number, and both ends of a link."""

import numpy as np
import pytest
from flight.mavlink.line import KEY, Clock, Wide, every, sample

from trimtab.core.signals import Command, Frame
from trimtab.flight.mavlink.dialect import Dialect, derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint


def made() -> Dialect:
    """The dialect of the tests."""
    wide = Wide(np.zeros((8, 9)), np.zeros(5), every())
    frame = Frame(t=np.int64(0), samples={"every": sample(every()), "double-wide": sample(wide)})
    return derive_dialect(frame, Command(t=np.int64(0), valid=False, value=every()))


@pytest.fixture(scope="session")
def dialect() -> Dialect:
    return made()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def pair(dialect, clock):
    """Two endpoints that share a key. The second accepts the first one's packets as new."""
    ends = [Endpoint(dialect, s, 1, KEY, clock=clock) for s in (1, 2)]
    clock.now += 1
    return ends


@pytest.fixture
def open_pair(dialect):
    """Two endpoints without a key."""
    return [Endpoint(dialect, s, 1, unsigned=True) for s in (1, 2)]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))

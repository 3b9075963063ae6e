import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.flight.station.parameters import Parameters, parameter_names, round_to_float32


@record
class Inner:
    """Bounds of each kind. Source: none, a test."""

    mass: Scalar = quantity("kg", "Above zero.", above=0)
    gains: object = quantity("1", "Two numbers.", low=-1, high=1)
    count: Scalar = quantity("1", "A count.", kind="count", low=0)
    choice: Scalar = quantity("1", "A mode.", kind="mode", modes=("a", "b"))
    on: Scalar = quantity("1", "A flag.", kind="flag")


@record
class Outer:
    """A record in a record. Source: none, a test."""

    inner: Inner = part("The inner one.")
    drag: Scalar = quantity("kg/s", "Drag.")


def parameters() -> Parameters:
    return Parameters(Outer(Inner(2.6, np.array([0.1, 0.2]), 3, 1, True), 0.2), "world.vehicle")


def test_every_parameter_has_a_name_path_and_value():
    own = parameters()
    assert own.table() == {
        "WVI_MASS": ("world.vehicle.inner.mass", 0),
        "WVI_GAINS_0": ("world.vehicle.inner.gains", 0),
        "WVI_GAINS_1": ("world.vehicle.inner.gains", 1),
        "WVI_COUNT": ("world.vehicle.inner.count", 0),
        "WVI_CHOICE": ("world.vehicle.inner.choice", 0),
        "WVI_ON": ("world.vehicle.inner.on", 0),
        "WV_DRAG": ("world.vehicle.drag", 0),
    }
    assert own.values == [2.6, 0.1, 0.2, 3.0, 1.0, 1.0, 0.2]
    assert own.find_index("WV_DRAG", -1) == own.find_index("", 6) == 6
    assert own.find_index("WV_DRAGS", -1) is None
    assert own.find_index("", 7) is None


PATHS = st.lists(st.text("abc_é0-", min_size=1, max_size=20), min_size=1, max_size=5).map(".".join)


@settings(max_examples=40)
@given(st.lists(PATHS, unique=True, max_size=40))
def test_parameter_names_are_valid_and_unique(paths):
    names = parameter_names(paths)
    assert len(set(names)) == len(names) == len(paths)
    assert all(0 < len(n) <= 16 and n.isascii() for n in names)


def test_name_depends_on_others_only_on_collision():
    assert parameter_names(["autopilot.law.lateral_gain"]) == ["AL_LATERAL_GAIN"]
    assert (
        parameter_names(["autopilot.law.k2", "world.x.mass"])[0] == parameter_names(["autopilot.law.k2"])[0] == "AL_K2"
    )
    met = parameter_names(["a.law.k2", "a.link.k2"])
    assert met == [parameter_names(["a.law.k2", "a.line.k2"])[0], met[1]]
    assert len(set(met)) == 2


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("WVI_MASS", 0.0, "above 0"),
        ("WVI_MASS", math.nan, "not a number"),
        ("WVI_MASS", math.inf, "not a number"),
        ("WVI_GAINS_1", 1.5, "at most 1"),
        ("WVI_COUNT", -1.0, "at least 0"),
        ("WVI_COUNT", 1.5, "whole number"),
        ("WVI_CHOICE", 2.0, "from 0 to 1"),
        ("WVI_ON", 2.0, "0 or 1"),
        ("WVI_MASS", 1e30, "at most 26 in flight"),
        ("WVI_MASS", 26.1, "at most 26 in flight"),
        ("WVI_MASS", 0.25, "at least 0.26 in flight"),
        ("WVI_MASS", 4.2e-45, "smaller than any normal number"),
        ("WVI_MASS", -5e-324, "smaller than any normal number"),
    ],
)
def test_values_beyond_declared_bounds_are_rejected(name, value, why):
    own = parameters()
    index = own.find_index(name, -1)
    before = own.values[index]
    assert why in own.change_value(index, value)
    assert own.values[index] == before


@record
class Unbounded:
    """Numbers without bounds. Source: none, a test."""

    gain: Scalar = quantity("1", "A gain.", default=-2.0)
    offset: Scalar = quantity("m", "An offset.", default=0.0)
    pause: Scalar = quantity("s", "A time.", low=0.0, default=0.4)
    none: Scalar = quantity("s", "A time that is off.", low=0.0, default=0.0)


def test_unbounded_parameters_stay_near_their_start_value():
    own = Parameters(Unbounded(), "law")
    assert [own.bounds(k) for k in range(4)] == [(-22.0, 18.0), (-10.0, 10.0), (0.0, 4.0), (0.0, 10.0)]
    assert own.change_value(1, 10.0) == ""
    assert own.bounds(1) == (-10.0, 10.0)  # of the start, so that no number walks away
    assert "at most 10 in flight" in own.change_value(1, 1e6)


def test_fault_parameters_are_not_bounded_around_zero():
    own = Parameters(Unbounded(), "world.sensors.navigation.fault")
    assert own.change_value(1, 1e4) == ""


def test_values_within_bounds_are_accepted():
    own = parameters()
    for index, value in ((1, -1.0), (1, 0.9), (2, 1.0), (3, 0.0), (4, 0.0), (0, 0.3), (0, 25.9)):
        assert own.change_value(index, value) == ""
        assert own.values[index] == value


def test_float32_read_back_keeps_the_stored_digits():
    own = parameters()
    read = round_to_float32(2.6)
    assert read != 2.6
    assert (own.change_value(0, read), own.values[0]) == ("", 2.6)
    assert (own.change_value(0, 3.5), own.values[0]) == ("", 3.5)


def test_rounding_to_float32_matches_four_bytes():
    assert round_to_float32(0.1) == struct.unpack("f", struct.pack("f", 0.1))[0]
    assert round_to_float32(-1e300) == -math.inf


@record
class Tables:
    """A short and a long array. Source: none, a test."""

    short: object = quantity("1", "As many as there may be.")
    long: object = quantity("1", "One more.")


def test_tables_are_not_parameters():
    listed = Parameters(Tables(np.zeros(64), np.zeros((5, 13)))).listed
    assert {p.path for p in listed} == {"short"}
    assert len(listed) == 64

"""Roll, pitch, yaw and altitude, computed from the estimate and appended to the rows of a live flight."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.console.flight_numbers import FlightNumbers
from trimtab.console.hello import describe_signal
from trimtab.core.quantity import Quantity
from trimtab.flight.console_packets import HEAD

PARTS = {
    "estimate.age": (Quantity("s", "Age."), 0),
    "estimate.state.velocity": (Quantity("m/s", "Velocity.", "B"), 3),
    "estimate.state.attitude": (Quantity("1", "Attitude.", "WB"), 4),
    "downlink.gps.value.position": (Quantity("m", "Measured.", "W"), 3),
    "estimate.state.position": (Quantity("m", "Position.", "W"), 3),
}


def list_signals(frame: str = "WB") -> list:
    """Return the signals as described to a page."""
    found = []
    for path, (declared, size) in PARTS.items():
        if path.endswith("attitude"):
            declared = Quantity("1", "Attitude.", frame)
        found += [describe_signal(p, declared) for p in ([f"{path}.{k}" for k in range(size)] if size else [path])]
    return found


def pack(angles, velocity=(3.0, 0.0, 0.0)) -> bytes:
    x, y, z, w = Rotation.from_euler("ZYX", angles[::-1]).as_quat()
    values = [0.01, *velocity, w, x, y, z, 9.0, 9.0, 9.0, 1.0, 2.0, -30.0]
    return HEAD.pack(1.5, 7.0) + np.array(values, "<f4").tobytes()


def unpack(numbers: FlightNumbers, row: bytes) -> dict[str, float]:
    end = np.frombuffer(row, "<f4", offset=HEAD.size)[14:]
    return dict(zip(numbers.declared, end.tolist(), strict=True))


def test_appends_angles_position_and_speeds_to_a_row():
    numbers = FlightNumbers(list_signals())
    row = pack((0.3, -0.2, 2.0))
    more = numbers.extend(row)
    assert more[: len(row)] == row
    found = unpack(numbers, more)
    assert [found[f"flight.{n}"] for n in ("roll", "pitch", "yaw")] == pytest.approx([0.3, -0.2, 2.0], abs=1e-6)
    assert [found[f"flight.{n}"] for n in ("north", "east", "altitude")] == [1.0, 2.0, 30.0]
    assert found["flight.climb"] == pytest.approx(3 * np.sin(-0.2), abs=1e-6)
    assert found["flight.ground_speed"] == pytest.approx(3 * np.cos(-0.2), abs=1e-6)


def test_yaw_is_unwrapped_through_a_full_turn():
    numbers = FlightNumbers(list_signals())
    seen = [unpack(numbers, numbers.extend(pack((0.0, 0.0, yaw))))["flight.yaw"] for yaw in np.arange(0, 14, 0.5)]
    np.testing.assert_allclose(seen, np.arange(0, 14, 0.5), atol=1e-5)


def test_missing_estimate_gives_nan_without_warnings():
    numbers = FlightNumbers(list_signals())
    bare = np.full(14, np.nan, "<f4").tobytes()
    assert np.isnan(unpack(numbers, numbers.extend(HEAD.pack(0.0, 0.0) + bare))["flight.yaw"])
    zero = np.zeros(14, "<f4").tobytes()  # a quaternion of no length
    assert np.isnan(unpack(numbers, numbers.extend(HEAD.pack(0.0, 0.0) + zero))["flight.roll"])
    assert unpack(numbers, numbers.extend(pack((0.0, 0.0, 1.0))))["flight.yaw"] == pytest.approx(1.0)


def test_rows_of_other_vehicles_are_unchanged():
    for signals in (list_signals("IB"), [describe_signal("estimate.state.heading", Quantity("rad", "Heading."))]):
        numbers = FlightNumbers(signals)
        assert (numbers.declared, numbers.extend(b"row")) == ({}, b"row")


def test_added_signals_are_not_read_as_flight_signals():
    signals = list_signals()
    more = [describe_signal(path, declared) for path, declared in FlightNumbers(signals).declared.items()]
    row = pack((0.1, 0.2, 0.3))
    assert FlightNumbers([*signals, *more]).extend(row) == FlightNumbers(signals).extend(row)


def test_scalar_angle_estimates_are_passed_through():
    names = ("altitude", "roll", "pitch", "alpha")
    signals = [describe_signal(f"estimate.state.{n}", Quantity("1", "A number.")) for n in names]
    numbers = FlightNumbers(signals)
    assert list(numbers.declared) == ["flight.roll", "flight.pitch", "flight.altitude"]
    row = HEAD.pack(0.0, 0.0) + np.array([100.0, 0.25, -0.5, 0.1], "<f4").tobytes()
    assert np.frombuffer(numbers.extend(row)[len(row) :], "<f4").tolist() == [0.25, -0.5, 100.0]

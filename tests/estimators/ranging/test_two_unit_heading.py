import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.estimators.ranging.multilateration import assisted_heading, heading_sigma, two_unit_heading

A, B = np.array([0.2, 0.0]), np.array([-0.2, 0.0])


def on_arc(t, lever, rate=2.0, radius=0.3048, start=0.4):
    """A point of a vehicle that turns on a circle, its heading along it: [1] section 6.2.1's rig."""
    angle = rate * t
    heading = start + angle + np.pi / 2
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    return radius * np.array([np.cos(start + angle), np.sin(start + angle)]) + R @ lever, heading


@pytest.mark.parametrize("heading", [-3.1, -1.0, 0.0, 0.7, 3.1])
@pytest.mark.parametrize("levers", [(A, B), (np.array([0.1, 0.3]), np.array([-0.2, 0.1]))], ids=["on x", "anywhere"])
def test_heading_of_units_located_at_once(heading, levers):
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    found = two_unit_heading(R @ levers[0] + 5.0, R @ levers[1] + 5.0, *levers)
    assert float(found) == pytest.approx(heading, abs=1e-12)


def test_assisted_is_exact_and_direct_is_not():
    """A is located first, B 100 ms later; at 115 deg/s the plain line is 5.75° off, half of what it turned."""
    rate = np.radians(115)
    place_a, _ = on_arc(0.0, A, rate)
    later_a, heading = on_arc(0.1, A, rate)
    place_b, _ = on_arc(0.1, B, rate)
    exact = assisted_heading(place_a, place_b, later_a - place_a, A, B)
    assert np.exp(1j * float(exact)) == pytest.approx(np.exp(1j * heading), abs=1e-12)
    direct = two_unit_heading(place_a, place_b, A, B)
    assert np.angle(np.exp(1j * (float(direct) - heading))) == pytest.approx(-rate * 0.1 / 2, abs=1e-9)


def test_another_point_leaves_out_what_the_turn_moves_the_unit():
    """With the displacement of the reference point the error is the turn's part: about half the angle turned."""
    rate = np.radians(115)
    moved = on_arc(0.1, np.zeros(2), rate)[0] - on_arc(0.0, np.zeros(2), rate)[0]
    found = assisted_heading(on_arc(0.0, A, rate)[0], on_arc(0.1, B, rate)[0], moved, A, B)
    error = np.angle(np.exp(1j * (float(found) - on_arc(0.1, A, rate)[1])))
    assert error == pytest.approx(-rate * 0.1 / 2, rel=0.02)


def test_error_follows_the_base():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.004, (20000, 2, 2))
    found = [float(np.arctan2(*(A - B + n[0] - n[1])[::-1])) for n in noise]
    assert np.std(found) == pytest.approx(float(heading_sigma(0.004, A, B)), rel=0.02)


def test_exportable():
    assert lower_function(assisted_heading, [np.zeros(2)] * 5).outputs

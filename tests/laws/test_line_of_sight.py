"""Line of sight: the guidance against the published differential equations, and path following."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.record import replace
from trimtab.core.reference import Circle, interpolate_path
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.laws.line_of_sight import LineOfSight
from trimtab.sensors.planar_pose import PlanarPoseState

DT = 0.05


def eastward(length):
    """Return a straight path to the east at 0.5 m/s."""
    t = np.linspace(0.0, 2 * length, 8)
    return interpolate_path(t, np.stack([np.zeros(8), t / 2], axis=1))


EAST = eastward(200.0)


def sail(law, seconds, *, speed=0.58, current=(0.0, 0.0), start=(0.0, 0.0), valid=True):
    """Return rows of north, east and outputs of a vessel in a current whose heading follows at once."""

    @jax.jit
    def step(state, north, east, heading):
        c, s = jnp.cos(heading), jnp.sin(heading)
        v = jnp.stack([c * speed + current[0], s * speed + current[1]])
        x = PlanarPoseState(c * v[0] + s * v[1], c * v[1] - s * v[0], 0.0, heading, north, east)
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(valid), state=x, dt=DT)
        state, out = law.step(0, state, estimate)
        return state, out, north + DT * v[0], east + DT * v[1], out.heading_command

    state, (north, east), heading, rows = law.init(key(0)), start, jnp.asarray(0.0), []
    for _ in range(round(seconds / DT)):
        state, out, north, east, heading = step(state, north, east, heading)
        rows.append([north, east, out.cross_track, out.along_track, out.integral, out.progress, out.heading_command])
    return np.array(rows, float)


@pytest.mark.thorough
def test_straight_path_in_current_matches_the_published_equations():
    """[1] eq. 12 with heading and speed as asked: e' = U sin(psi - chi) + V_y, I' = D e/((e + s I)² + D²)."""
    law = replace(LineOfSight(), reference=EAST, far=3.0, near=3.0, integral_gain=0.2)
    rows = sail(law, 60, current=(-0.2, 0.0), start=(2.0, 0.5))

    def rates(t, y):
        e, integral = y
        psi = -np.arctan2(e + 0.2 * integral, 3.0)
        return 0.58 * np.sin(psi) + 0.2, 3.0 * e / ((e + 0.2 * integral) ** 2 + 9.0)

    exact = solve_ivp(rates, (0, 60), (-2.0, 0.0), max_step=0.05, dense_output=True)
    t = DT * np.arange(len(rows))
    np.testing.assert_allclose(rows[20:, 2], exact.sol(t[20:])[0], atol=0.06)
    np.testing.assert_allclose(rows[20:, 4], exact.sol(t[20:])[1], atol=0.15)


@pytest.mark.thorough
def test_integral_action_removes_cross_track_error_in_current():
    law = replace(LineOfSight(), reference=EAST)
    with_integral = sail(replace(law, integral_gain=0.1), 250, current=(-0.2, 0.0))
    assert with_integral[-1, 2] == pytest.approx(0.0, abs=0.02)
    crab = np.arcsin(0.2 / 0.58)
    assert with_integral[-1, 6] == pytest.approx(np.pi / 2 - crab, abs=0.01)
    without = sail(replace(law, integral_gain=0.0, near=2.0, far=2.0), 250, current=(-0.2, 0.0))
    assert without[-1, 2] == pytest.approx(2.0 * np.tan(crab), rel=0.01), "D tan(crab), where it settles"


@pytest.mark.thorough
def test_path_point_stays_abreast_of_the_vessel():
    rows = sail(replace(LineOfSight(), reference=EAST), 60)
    assert np.abs(rows[100:, 3]).max() < 0.1
    pace = np.diff(rows[200:, 5]).mean() / DT
    assert pace == pytest.approx(0.58 / 0.5, rel=0.02), "the path's own is 0.5 m/s"


@pytest.mark.thorough
def test_vessel_continues_straight_beyond_the_path_end():
    short = eastward(10.0)
    rows = sail(replace(LineOfSight(), reference=short), 40, start=(0.3, 0.0))
    assert rows[-1, 1] > 15
    assert rows[-1, 0] == pytest.approx(0.0, abs=0.05)
    assert np.isfinite(rows).all()


@pytest.mark.thorough
def test_circle_is_tracked_within_the_geometric_error():
    """A point D ahead on a circle of radius R lies D²/(2 R) off the tangent, which bounds the tracking error."""
    law = replace(LineOfSight(), reference=Circle(radius=8.0, period=87.0, ease=0.0), integral_gain=0.0)
    rows = sail(law, 200, start=(8.0, 0.0))
    radius = np.hypot(rows[1000:, 0], rows[1000:, 1])
    assert np.abs(radius - 8.0).max() < 0.1


def test_lookahead_shrinks_with_cross_track_error():
    law = LineOfSight(near=1.0, far=3.0, width=2.0)
    course, _ = law._guide(0.0, jnp.asarray(100.0), 0.0)
    assert float(course) == pytest.approx(-np.arctan2(100.0, 1.0))
    course, _ = law._guide(0.0, jnp.asarray(0.01), 0.0)
    assert float(course) == pytest.approx(-np.arctan2(0.01, 3.0), rel=1e-4)


def test_shaft_speed_controller_is_limited_with_held_integral():
    law = LineOfSight(speed=0.5, shaft_limit=100.0)
    shaft, integral = law._drive(jnp.asarray(0.3), jnp.asarray(0.0), DT)
    assert (float(shaft), float(integral)) == (100.0, 0.3), "at the limit the integral waits"
    shaft, integral = law._drive(jnp.asarray(0.0), jnp.asarray(0.5), DT)
    assert float(shaft) == pytest.approx(90.0)
    assert float(law._drive(jnp.asarray(0.0), jnp.asarray(5.0), DT)[0]) == 0.0


@pytest.mark.thorough
def test_invalid_estimate_holds_integral_and_progress():
    law = replace(LineOfSight(), reference=EAST)
    rows = sail(law, 1, start=(2.0, 0.0), valid=False)
    assert np.all(rows[:, 4] == 0.0)
    assert np.all(rows[:, 5] == 0.0)

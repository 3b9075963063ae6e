"""Depth and heading autopilots: signs, limits, and zero steady depth error of a buoyant vehicle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.laws.diving import Diving
from trimtab.scenarios.torpedo.depth import LEVEL
from trimtab.sensors.dive import DiveReading, DiveSensor
from trimtab.vehicles.torpedo import Torpedo

DT = 0.05


def ask(law, *, depth=5.0, pitch=0.0, heading=0.0, u=1.76, q=0.0, r=0.0, steps=1):
    state = law.init(key(0))
    reading = DiveReading(*map(jnp.asarray, (depth, 0.0, pitch, heading, u, q, r)))
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(True), state=reading, dt=DT)
    for _ in range(steps):
        state, out = law.step(0, state, estimate)
    return state, out


def dive(law, seconds, torpedo=None):
    """Return rows of depth, heading, stern planes and reference."""
    torpedo, sensor = torpedo or Torpedo(), DiveSensor()

    @jax.jit
    def step(state, x):
        reading = sensor.measure(torpedo.motion(0, x, None))
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=jnp.asarray(True), state=reading, dt=DT)
        state, out = law.step(0, state, estimate)
        for _ in range(2):
            x = rk4(lambda t, x: torpedo.dynamics(t, x, out.demand), 0.0, x, DT / 2)
        return state, x, (reading.depth, reading.heading, x.stern, out.depth_reference, reading.pitch)

    state, x, rows = law.init(key(0)), to_arrays(LEVEL), []
    for _ in range(round(seconds / DT)):
        state, x, row = step(state, x)
        rows.append(row)
    return np.array(rows, float)


def test_pitch_stern_and_rudder_commands_have_correct_signs():
    law = Diving(depth=5.0, heading=0.3, steering=replace(Diving().steering, ki=0.0))
    _, out = ask(law, depth=3.0, steps=5)
    assert out.pitch_command < 0, "to go deeper the nose goes down"
    assert out.demand.stern > 0, "for which the tail is pushed up"
    assert out.demand.rudder < 0, "to starboard"
    assert ask(law, depth=7.0, steps=5)[1].demand.stern < 0
    assert ask(Diving(), q=0.1)[1].demand.stern > 0, "damps"


@pytest.mark.thorough
def test_depth_reference_is_rate_limited_and_starts_at_current_depth():
    _, out = ask(Diving(depth=5.0, climb=0.25), depth=3.0, steps=40)
    assert float(out.depth_reference) == pytest.approx(3.0 + 40 * 0.25 * DT), "of a reading that stands still"
    rows = dive(Diving(depth=5.0, climb=0.25), 4)
    np.testing.assert_allclose(np.diff(rows[:, 3]), 0.25 * DT, rtol=1e-9)


@pytest.mark.thorough
def test_positively_buoyant_vehicle_reaches_depth_and_heading():
    rows = dive(Diving(depth=5.0, heading=0.5), 80)
    assert rows[-1, 0] == pytest.approx(5.0, abs=0.02)
    assert rows[-1, 1] == pytest.approx(0.5, abs=0.01)
    assert rows[:, 0].max() < 5.6
    assert rows[-1, 2] == pytest.approx(LEVEL.stern, abs=0.01), "the planes hold the buoyancy"
    held = dive(replace(Diving(depth=5.0, heading=0.5), kzi=0.0, ki=0.0), 80)
    assert abs(held[-1, 0] - 5.0) > 0.1, "without integrals it does not"


def test_commands_are_limited_and_integrals_held_at_limits():
    law = Diving(depth=50.0, climb=100.0, steepest=0.2, limit=0.1)
    state, out = ask(law, depth=0.0, steps=50)
    assert float(out.pitch_command) == pytest.approx(-0.2)
    assert float(out.demand.stern) == pytest.approx(0.1)
    assert float(state.pitch_integral) == 0.0


def test_plane_angles_scale_with_inverse_square_of_speed():
    law = replace(Diving(depth=5.0), kz=0.0, kzi=0.0, ki=0.0, speed=2.0, slowest=1.0)
    assert float(ask(law, pitch=0.05, u=2.0)[1].demand.stern) == pytest.approx(0.05)
    assert float(ask(law, pitch=0.05, u=1.0)[1].demand.stern) == pytest.approx(0.2)
    assert float(ask(law, pitch=0.05, u=0.5)[1].demand.stern) == pytest.approx(0.2)

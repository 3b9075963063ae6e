"""Ground avoidance: mode transitions, feedback by matrices, and gains by their design."""

import jax
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.rotation import DEG
from trimtab.core.signals import Estimate
from trimtab.laws.ground_avoidance import PULL, ROLL, STANDBY, GroundAvoidance, LoadFactorControl
from trimtab.scenarios.f16._gains import design_load_factor_control
from trimtab.scenarios.f16.gcas import FOR_ACTUATORS
from trimtab.sensors.flight_instruments import FlightInstrumentsReading
from trimtab.vehicles.imperial import FOOT

LAW = GroundAvoidance()
LEVEL = FlightInstrumentsReading(
    speed=165.0,
    alpha=0.04,
    beta=0.0,
    altitude=400.0,
    roll=0.0,
    pitch=0.04,
    roll_rate=0.0,
    pitch_rate=0.0,
    yaw_rate=0.0,
    normal_load=1.0,
    side_load=0.0,
)


def step(law, state, **seen):
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=replace(LEVEL, **seen), dt=0.01)
    return take_step(law, state, estimate)


@jax.jit
def take_step(law, state, estimate):
    return law.step(0, state, estimate)


def modes(law, flight):
    state, said = law.init(key(0)), []
    for seen in flight:
        state, output = step(law, state, **seen)
        assert int(output.mode) == int(state.mode)
        said.append(int(output.mode))
    return said


def test_acts_only_below_the_deck_with_nose_down():
    low, up, down = {"altitude": 304.0}, {"pitch": 0.1}, {"pitch": -0.1}
    assert modes(LAW, [up, low | up, down, low | down]) == [STANDBY, STANDBY, STANDBY, ROLL]
    assert LAW.deck == pytest.approx(1000 * FOOT)


@pytest.mark.thorough
def test_pulls_up_after_wings_level_until_nose_is_up():
    dive = {"altitude": 200.0, "pitch": -0.3}
    banked, rolling = {"roll": 0.5}, {"roll_rate": 0.3}
    assert modes(LAW, [dive | banked, dive | banked, dive | rolling, dive]) == [ROLL, ROLL, ROLL, PULL]
    up = {"altitude": 200.0, "pitch": 0.3}
    said = modes(LAW, [dive, dive, *[up] * 205])
    assert said[:2] == [ROLL, PULL]
    assert said.index(STANDBY) == pytest.approx(1 + 2.0 / 0.01, abs=2), "two seconds at least"


@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_roll_command_is_invariant_to_full_turns_of_bank(turns):
    dive = {"altitude": 200.0, "pitch": -0.3, "roll": 0.5}
    state = replace(LAW.init(key(0)), mode=np.int32(ROLL))
    one, other = (step(LAW, state, **dive | {"roll": 0.5 + 2 * np.pi * n})[1] for n in (0, turns))
    np.testing.assert_allclose(other.roll_rate_command, one.roll_rate_command, atol=1e-12)
    assert float(one.roll_rate_command) == pytest.approx(-4 * 0.5)


def test_each_mode_commands_its_load_and_roll_rate():
    pulls = replace(LAW.init(key(0)), mode=np.int32(PULL))
    assert float(step(LAW, pulls, pitch=-0.3, altitude=200.0)[1].load_command) == 5.0
    rolls = replace(LAW.init(key(0)), mode=np.int32(ROLL))
    limited = replace(LAW, most_roll=1.5)
    assert float(step(limited, rolls, roll=3.0)[1].roll_rate_command) == -1.5
    assert float(step(LAW, rolls, roll=1.0, roll_rate=-0.5)[1].roll_rate_command) == pytest.approx(-4 + 1)


def test_surfaces_are_trim_minus_gain_times_error():
    control, rng = LoadFactorControl(), np.random.default_rng(0)
    for _ in range(20):
        z = rng.normal(size=8)
        x = replace(LEVEL, alpha=z[0], pitch_rate=z[1], beta=z[2], roll_rate=z[3], yaw_rate=z[4])
        u = control.surfaces(x, z[5:])
        along = np.array([z[0] - control.trim_alpha, z[1], z[5]])
        aside = np.array([z[2], z[3], z[4], z[6], z[7]])
        np.testing.assert_allclose(u.elevator, control.trim_elevator - control.longitudinal @ along, rtol=1e-12)
        np.testing.assert_allclose([u.aileron, u.rudder], -control.lateral @ aside, rtol=1e-12)


def test_integrals_accumulate_load_and_rate_errors():
    state = LAW.init(key(0))
    for _ in range(100):
        state, output = step(LAW, state, normal_load=1.5, roll_rate=0.1, yaw_rate=0.2, side_load=-0.05)
    about_path = 0.1 * np.cos(0.04) + 0.2 * np.sin(0.04)
    np.testing.assert_allclose(state.integrals, [0.5, about_path, 0.15], rtol=1e-9)
    assert float(output.load_error) == pytest.approx(0.5)


@pytest.mark.thorough
@pytest.mark.parametrize(("weights", "law"), [("published", LAW), ("actuators", FOR_ACTUATORS)])
def test_gains_match_the_lqr_design(weights, law):
    """Trim, linear model and Riccati equation of the vehicle, to the digits of the law."""
    design = design_load_factor_control(weights)
    np.testing.assert_allclose(law.control.longitudinal, -design.along.K[0], atol=1e-7)
    np.testing.assert_allclose(law.control.lateral, -design.aside.K, atol=1e-7)
    assert float(law.control.trim_alpha) == pytest.approx(design.level.x[1], abs=1e-7)
    assert float(law.control.trim_elevator) == pytest.approx(design.level.u[0], abs=1e-7)
    assert float(law.control.throttle) == pytest.approx(design.level.u[3], abs=1e-7)
    assert float(LAW.level_bank) == pytest.approx(5 * DEG)

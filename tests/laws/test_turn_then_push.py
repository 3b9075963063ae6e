"""The law for one-way thrust: its steps, the force that it asks for, and its limits. Flights: tests/scenarios."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate
from trimtab.laws.turn_then_push import PUSH, REST, TURN, TurnThenPush, TurnThenPushState
from trimtab.vehicles.hovercraft import Friction, HovercraftState

LAW = TurnThenPush()
PLACE = TurnThenPush(goal="place", speed=0.5)


@jax.jit
def take_step(law, state, estimate):
    return law.step(np.int64(0), state, estimate)


def step(law, mode, nose=0.0, valid=True, **x):
    state = TurnThenPushState(np.int32(mode), np.float64(nose), np.int32(3))
    estimate = Estimate(t=np.int64(0), age=0.0, fresh=True, valid=valid, state=HovercraftState(**x))
    return take_step(law, state, estimate)


def test_forward_motion_turns_the_nose_against_the_velocity() -> None:
    now, out = step(LAW, REST, surge_velocity=1.0)
    assert int(now.mode) == TURN
    assert abs(float(now.nose)) == pytest.approx(np.pi)
    assert float(out.demand.FX) == 0.0
    assert int(now.turns) == 4


def test_backward_motion_is_pushed_against_at_once() -> None:
    now, out = step(LAW, REST, surge_velocity=-1.0)
    assert int(now.mode) == PUSH
    assert float(out.demand.FX) == pytest.approx(0.75 * 1.5 * 1.0)
    assert float(out.demand.FY) == 0.0


def test_slow_motion_at_rest_causes_no_thrust() -> None:
    now, out = step(LAW, REST, surge_velocity=0.11, yaw_rate=0.5)
    assert int(now.mode) == REST
    assert float(out.demand.FX) == float(out.demand.FY) == 0.0


def test_push_ends_at_rest() -> None:
    now, _ = step(LAW, PUSH, surge_velocity=-0.02)
    assert int(now.mode) == REST


def test_push_never_pulls_backward() -> None:
    for psi in np.linspace(-3, 3, 13):
        _, out = step(LAW, PUSH, surge_velocity=0.1 * np.cos(psi), sway_velocity=0.1 * np.sin(psi))
        assert float(out.demand.FX) >= 0.0


def test_nose_that_points_away_turns_before_it_pushes() -> None:
    now, out = step(LAW, PUSH, surge_velocity=0.5)
    assert int(now.mode) == TURN
    assert float(out.demand.FX) == 0.0


def test_thrust_balances_the_friction_at_the_reference_speed() -> None:
    friction = LAW.model.friction
    law = replace(LAW, speed=0.6, course=0.0)
    _, out = step(law, PUSH, surge_velocity=0.6)
    drag = friction.force_coulomb + friction.force_viscous * 0.6 + friction.force_quadratic * 0.36
    assert float(out.demand.FX) == pytest.approx(drag, rel=1e-6)


def test_error_across_the_course_has_its_own_gain() -> None:
    law = replace(LAW, speed=0.6, model=replace(LAW.model, friction=Friction()))
    now, _ = step(law, PUSH, surge_velocity=0.5, sway_velocity=0.1)
    assert float(now.nose) == pytest.approx(np.arctan2(-0.5 * 0.1, 1.5 * 0.1))


def test_speed_falls_toward_the_place_and_is_zero_near_it() -> None:
    for north, speed in ((-5.0, 0.5), (-1.0, 0.35), (-0.29, 0.0)):
        _, out = step(PLACE, REST, north=north)
        assert float(out.velocity_error) == pytest.approx(speed)
        assert float(out.distance) == pytest.approx(-north)


def test_invalid_estimate_changes_no_step() -> None:
    now, _ = step(LAW, TURN, nose=0.7, valid=False, surge_velocity=1.0)
    assert int(now.mode) == TURN
    assert float(now.nose) == 0.7


@pytest.mark.parametrize(("field", "value"), [("stop", 0.2), ("aligned", 1.0)])
def test_rejects_a_step_that_ends_as_it_begins(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        replace(LAW, **{field: value}).check()

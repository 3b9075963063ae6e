"""The six steps: every transition, and ideal runs that repeat rounds. [1] Z. Kulis 2006, section 2.3.1."""

import jax
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.laws.heading import DAMP, HeadingLawState
from trimtab.laws.pose_steps import ALIGN, COMPUTE, FINAL, HOLD, MOVE, STOP, PoseBySteps, PoseStepsState
from trimtab.laws.velocity import ForwardMomentum, ZeroVelocity
from trimtab.vehicles.hovercraft import HovercraftState

LAW = PoseBySteps()


def x(north=0.0, east=0.0, heading=0.0, u=0.0, v=0.0, r=0.0):
    return HovercraftState(u, v, r, north, east, heading)


def step(state, mode, bearing=0.0, valid=True, law=LAW):
    turning = HeadingLawState(np.int32(DAMP), np.int32(0), np.float64(0.0))
    before = PoseStepsState(np.int32(mode), np.float64(bearing), turning, np.int32(3))
    return take_step(law, before, Estimate(t=0, age=0.0, fresh=True, valid=valid, state=state))


@jax.jit
def take_step(law, before, estimate):
    return law.step(0, before, estimate)


CASES = {
    "far it aligns": (COMPUTE, x(-2.0), 0.0, ALIGN),
    "near it turns to the heading": (COMPUTE, x(-0.29), 0.0, FINAL),
    "not aligned it goes on": (ALIGN, x(-2.0, heading=0.02), 0.0, ALIGN),
    "aligned it moves": (ALIGN, x(-2.0, heading=0.017), 0.0, MOVE),
    "it moves on": (MOVE, x(-2.0, u=0.3), 0.0, MOVE),
    "passed it stops": (MOVE, x(-0.09, 0.5), 0.0, STOP),
    "off its course it stops": (MOVE, x(-2.0, 2.0), 0.0, STOP),
    "off its course but near it moves on": (MOVE, x(-0.3, 0.25), 0.0, MOVE),
    "fast it goes on stopping": (STOP, x(u=0.2), 0.0, STOP),
    "calm it computes": (STOP, x(u=0.01), 0.0, COMPUTE),
    "not turned yet": (FINAL, x(heading=0.02), 0.0, FINAL),
    "turned it holds": (FINAL, x(heading=0.017), 0.0, HOLD),
    "it holds within one and a half tolerances": (HOLD, x(0.44, heading=0.26), 0.0, HOLD),
    "too far it computes": (HOLD, x(0.46), 0.0, COMPUTE),
    "turned away it computes": (HOLD, x(heading=-0.27), 0.0, COMPUTE),
}


@pytest.mark.parametrize("case", CASES)
def test_each_mode_has_the_expected_transition(case):
    mode, state, bearing, wanted = CASES[case]
    assert int(step(state, mode, bearing)[0].mode) == wanted
    held = step(state, mode, bearing, valid=False)[0]
    assert (int(held.mode), float(held.bearing), int(held.rounds)) == (mode, bearing, 3)


def test_compute_step_stores_the_bearing_to_the_goal():
    now, _ = step(x(1.0, -1.0), COMPUTE)
    assert float(now.bearing) == pytest.approx(3 * np.pi / 4)
    assert int(step(x(1.0, -1.0), STOP)[0].rounds) == 4  # calm: it computes


def test_each_mode_uses_its_own_law():
    state = x(-2.0, 0.0, 0.0, 0.2, 0.1, -0.1)
    estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=state)
    forward = replace(LAW.forward, reference=2.6 * 0.6)
    for mode, law in ((MOVE, forward), (STOP, ZeroVelocity())):
        wanted = law.step(0, (), estimate)[1].demand
        got = step(state, mode)[1].demand
        assert (float(got.FX), float(got.FY)) == pytest.approx((float(wanted.FX), float(wanted.FY)))
    assert isinstance(LAW.forward, ForwardMomentum)
    assert float(step(state, MOVE)[1].speed_reference) == 0.6
    assert float(step(x(-1.0), MOVE)[1].speed_reference) == pytest.approx(0.35)
    assert float(step(x(-0.2), MOVE)[1].speed_reference) == 0.1


@pytest.mark.thorough
def test_comes_near_the_goal_but_repeats_rounds_forever(sampled):
    """20 starts at rest: all come near and none stays, because the heading drifts during braking."""
    rng = np.random.default_rng(5)
    zero = np.zeros(20)
    start = HovercraftState(zero, zero, zero, *rng.uniform(-4, 4, (2, 20)), rng.uniform(-np.pi, np.pi, 20))
    state, output = sampled(LAW, start, 300)
    distance = np.hypot(state.north, state.east)
    near = (distance < 0.3) & (np.abs(wrap(state.heading)) < np.radians(10))
    assert near.any(axis=1).all()
    first = near.argmax(axis=1)
    shares = [(d[k:] < 0.6).mean() for d, k in zip(distance, first, strict=True)]
    assert np.median(first) < 3500
    assert first.max() < 9000
    assert min(shares) > 0.8
    assert np.asarray(output.rounds)[:, -1].min() >= 3

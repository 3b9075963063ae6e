"""Rest at a place and a heading: the centre of percussion, each step, and ideal runs. Derived here, docs page Pose."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.laws.pose import AIM, BRAKE, GO, HOLD, Pose, PoseState
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

PLANT, LAW = Hovercraft(), Pose()
A = 0.096 / (2.6 * 0.32)


def percussion_point(x):
    """Return place and velocity of P in W."""
    c, s = np.cos(x.heading), np.sin(x.heading)
    side = x.sway_velocity + A * x.yaw_rate
    place = np.array([x.north + A * c, x.east + A * s])
    return place, np.array([c * x.surge_velocity - s * side, s * x.surge_velocity + c * side])


def step(law, x, mode, nose=0.0, t=0, valid=True):
    estimate = Estimate(t=t, age=0.0, fresh=True, valid=valid, state=x)
    return take_step(law, t, PoseState(np.int32(mode), np.float64(nose), np.int32(1)), estimate)


@jax.jit
def take_step(law, t, state, estimate):
    return law.step(t, state, estimate)


def at(way, v=(0.0, 0.0), heading=0.0, r=0.0, law=LAW):
    """Return a state whose P has this distance (W) to the law's goal, and this velocity (W)."""
    c, s = np.cos(heading), np.sin(heading)
    rest = np.array([law.north, law.east]) + A * np.array([np.cos(law.heading), np.sin(law.heading)])
    place = rest - np.asarray(way) - A * np.array([c, s])
    u, side = c * v[0] + s * v[1], -s * v[0] + c * v[1]
    return HovercraftState(u, side - A * r, r, *place, heading)


@pytest.mark.thorough
def test_percussion_point_has_no_acceleration_across_the_nose():
    rng = np.random.default_rng(3)
    for mode in (BRAKE, AIM, GO, HOLD):
        for _ in range(20):
            x = HovercraftState(*rng.normal(0.0, 1.0, 6))
            u = step(LAW, x, mode, nose=1.0)[1].demand
            rate, h = PLANT.dynamics(0.0, x, u), 1e-6

            def moved(dt, x=x, rate=rate):
                names = ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading")
                return replace(x, **{n: float(getattr(x, n) + dt * getattr(rate, n)) for n in names})

            dv = (percussion_point(moved(h))[1] - percussion_point(moved(-h))[1]) / (2 * h)
            across = np.array([-np.sin(x.heading), np.cos(x.heading)])
            assert abs(across @ dv) < 1e-6 * (1 + np.abs(dv).max())


def test_nose_aims_along_the_nearer_end_of_the_line():
    for bearing, wanted in ((0.3, 0.3), (2.9, 2.9 - np.pi), (-1.7, np.pi - 1.7)):
        now, _ = step(LAW, at(2.0 * np.array([np.cos(bearing), np.sin(bearing)])), BRAKE)
        assert int(now.mode) == AIM
        assert float(wrap(now.nose)) == pytest.approx(wrap(wanted))


CASES = {
    "brake goes on": (BRAKE, at((1.0, 0.0), (0.5, 0.0)), 0.0, BRAKE),
    "at rest it aims": (BRAKE, at((1.0, 0.0), heading=1.0), 0.0, AIM),
    "it aims until it is aligned": (AIM, at((1.0, 0.0), heading=0.01), 0.0, AIM),
    "and the nose is still": (AIM, at((1.0, 0.0), r=0.01), 0.0, AIM),
    "aligned it goes": (AIM, at((1.0, 0.0)), 0.0, GO),
    "it goes on": (GO, at((1.0, 0.0), (0.3, 0.0)), 0.0, GO),
    "beside the goal it aims again": (GO, at((0.0, 0.1)), 0.0, AIM),
    "fast beside the goal it brakes": (GO, at((0.0, 0.1), (0.0, 0.1)), 0.0, BRAKE),
    "near and at rest it holds": (GO, at((0.005, 0.0)), 0.0, HOLD),
    "near from the start it holds at once": (BRAKE, at((0.005, 0.0), heading=2.0), 0.0, HOLD),
    "near but fast it doesn't": (BRAKE, at((0.005, 0.0), (0.1, 0.0)), 0.0, BRAKE),
    "it holds while it isn't far": (HOLD, at((0.05, 0.0), (0.01, 0.0)), 0.0, HOLD),
    "pushed away it begins again": (HOLD, at((0.2, 0.0), (0.5, 0.0)), 0.0, BRAKE),
    "kicked it begins again": (HOLD, at((0.0, 0.0), (0.0, 0.2)), 0.0, BRAKE),
}


@pytest.mark.parametrize("case", CASES)
def test_each_mode_has_the_expected_transition(case):
    mode, x, nose, wanted = CASES[case]
    assert int(step(LAW, x, mode, nose)[0].mode) == wanted
    held = step(LAW, x, mode, nose, valid=False)[0]
    assert (int(held.mode), float(held.nose), int(held.rounds)) == (mode, nose, 1)


@pytest.mark.parametrize("name", ["near", "rest_speed"])
def test_rejects_thresholds_that_would_break_the_hold(name):
    with pytest.raises(InputError, match=f"Pose.{name}.*must be less"):
        replace(LAW, **{name: 0.5}).check()


def test_counts_rounds_when_leaving_hold_or_go():
    assert int(step(LAW, at((0.2, 0.0), (0.5, 0.0)), HOLD)[0].rounds) == 2
    assert int(step(LAW, at((0.0, 0.1)), GO)[0].rounds) == 2


def random_starts(n, seed):
    rng = np.random.default_rng(seed)
    u, v, north, east = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(-4, 4, n), rng.uniform(-4, 4, n)
    return HovercraftState(u, v, rng.uniform(-4, 4, n), north, east, rng.uniform(-np.pi, np.pi, n))


def within(x, metres, radians):
    return (np.hypot(x.north, x.east) < metres) & (np.abs(wrap(x.heading)) < radians)


def check_runs(sampled, n, seed):
    """Check 5 cm and 3 degrees after 45 s for one minute, and rest at the end."""
    x, output = sampled(LAW, random_starts(n, seed), 105)
    assert within(x, 0.05, np.radians(3))[:, 4500:].all()
    assert within(x, 1e-3, np.radians(0.2))[:, -1].all()
    assert np.asarray(output.speed)[:, -1].max() < 2e-4


@pytest.mark.thorough
def test_comes_to_rest_at_the_goal_and_stays(sampled):
    check_runs(sampled, 40, 1)


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_comes_to_rest_at_the_goal_from_1000_starts(sampled):
    check_runs(sampled, 1000, 2)


def test_swing_removes_the_lateral_offset(sampled):
    """Without the swing the offset stays: at rest there is no force across the nose."""
    start = HovercraftState(*(np.array([v]) for v in (0.0, 0.0, 0.0, 0.0, 0.009, 0.0)))
    for law, is_there in ((LAW, True), (replace(LAW, swing=1e-9), False)):
        x, _ = sampled(law, start, 40)
        assert (abs(x.east[0, -1]) < 1e-4) == is_there

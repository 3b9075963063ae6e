"""Parameters of a law that change in flight, in steps and in ramps."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.time import ms, seconds
from trimtab.laws.velocity import ForwardMomentum
from trimtab.loop.setpoint_schedule import SetpointSchedule, schedule_law, split_schedules
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

PATH = "autopilot.law.reference"


def value(text, t, path=PATH):
    law = build("hovercraft/forward", {path: text}).autopilot
    return float(schedule_law(law.law, law.schedules, seconds(t)).reference)


def test_steps_hold_each_value_after_the_default():
    text = "steps(1 s: 2, 2500 ms: 3)"
    assert [value(text, t) for t in (0.0, 0.9999, 1.0, 2.4, 2.5, 1e3)] == [2.8, 2.8, 2, 2, 3, 3]
    assert float(build("hovercraft/forward", {PATH: text}).autopilot.law.reference) == 2.8


def test_ramps_interpolate_linearly():
    text = "ramps(1: 2, 2: 3, 4: 2.5)"
    t = np.array([0.0, 1.0, 1.25, 2.0, 3.0, 5.0])
    np.testing.assert_allclose([value(text, x) for x in t], np.interp(t, [1, 2, 4], [2, 3, 2.5]))


def test_schedule_values_accept_units():
    law = build("hovercraft/spin", {"autopilot.law.spinning.reference": "steps(0 s: 90 deg/s)"}).autopilot
    assert float(schedule_law(law.law, law.schedules, 0).spinning.reference) == pytest.approx(np.pi / 2)


@pytest.mark.thorough
def test_law_follows_the_scheduled_setpoint():
    """On the ideal model: equal to a run with the first value, then to the analytical response to the second."""
    text = "steps(4 s: 1.3)"
    log = simulate(build("hovercraft/forward", {PATH: text}).ideal(), log_period=ms(10))
    whole = simulate(build("hovercraft/forward").ideal(), log_period=ms(10))
    early = log.t < 4.0
    np.testing.assert_array_equal(log["truth.surge_velocity"][early], whole["truth.surge_velocity"][early])
    u = log["truth.surge_velocity"]
    after = log.t >= 4.0
    start = float(u[after][0])
    wanted = 0.5 + (start - 0.5) * np.exp(-(log.t[after] - 4.0) / 2.6)  # u' = -(k1/m) (u - 1.3/m), k1 = 1
    np.testing.assert_allclose(u[after], wanted, atol=1e-3)


def test_schedules_are_separated_from_plain_settings():
    plain, schedules = split_schedules({"a": "3", "b": "steps(0: 1)", "c": "ramps( 0 s: 1 , 2 s: 3 )"})
    assert (list(plain), list(schedules)) == (["a"], ["b", "c"])


@pytest.mark.parametrize(
    ("path", "text", "problem"),
    [
        (PATH, "steps(0 s)", "'0 s' is not TIME: VALUE"),
        (PATH, "steps(0 s: x)", "'x' is not a number"),
        (PATH, "steps(now: 1)", "'now' is not a time"),
        (PATH, "steps(0: 1 rad/s)", "not a unit"),
        (PATH, "steps(2: 1, 1: 2)", "rising order"),
        (PATH, "ramps(0: 1, 5: -2)", "reference"),
        ("autopilot.law.k1", "ramps(0: 1, 5: -2)", "out of range: it must be above 0"),
        ("autopilot.law.k9", "steps(0: 1)", "a numeric parameter of the law"),
        ("world.vehicle.mass", "steps(0: 1)", "a numeric parameter of the law"),
    ],
)
def test_rejects_invalid_schedules(path, text, problem):
    with pytest.raises(InputError, match=problem) as refused:
        build("hovercraft/forward", {path: text})
    assert refused.value.fix


def test_checks_user_made_schedules():
    with pytest.raises(InputError, match="got 2 times, 1 values"):
        SetpointSchedule("k1", "steps", np.array([0.0, 1.0]), np.array([1.0])).check()
    law = ForwardMomentum()
    assert schedule_law(law, (), 0) is law

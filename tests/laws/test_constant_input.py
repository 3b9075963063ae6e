"""The law with a constant demand."""

import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.signals import PlanarForce
from trimtab.core.time import ms
from trimtab.laws.constant_input import ConstantInput
from trimtab.loop.setpoint_schedule import split_schedules, with_schedules
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build


def test_demand_is_constant_for_any_estimate():
    law = ConstantInput(PlanarForce(1.5, -0.5))
    for estimate in (None, PlanarForce(np.nan, np.nan)):
        state, output = law.step(0, law.init(None), estimate)
        assert (state, output.demand.FX, output.demand.FY) == ((), 1.5, -0.5)


@pytest.mark.thorough
def test_schedule_changes_the_constant_input_in_flight():
    own = build("hovercraft/forward", {"duration": "0.4"})
    held = replace(own, autopilot=replace(own.autopilot, law=ConstantInput(PlanarForce(0.0, 0.0)), schedules=()))
    _, schedules = split_schedules({"autopilot.law.u0.FX": "steps(0 s: 0.5, 0.2 s: -0.25)"})
    log = simulate(with_schedules(held, schedules), log_period=ms(10))
    assert set(log["law.demand.FX"][log.ticks < ms(200)]) == {0.5}
    assert set(log["law.demand.FX"][log.ticks >= ms(200)]) == {-0.25}

"""Direct allocation and actuation: the demand acts unchanged."""

import jax
import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.interfaces import Actuators, Allocation
from trimtab.core.record import replace
from trimtab.core.signals import PlanarForce, new_sample
from trimtab.core.time import ms


def test_demand_passes_unchanged_to_the_input():
    demand = PlanarForce(0.3, -0.7)
    _, value = DirectAllocation().step(0, (), demand)
    _, out = jax.jit(DirectActuation().step)(0, (), new_sample(0, value))
    assert (float(out.u.FX), float(out.u.FY)) == (0.3, -0.7)


def test_input_is_neutral_before_the_first_command():
    actuation = DirectActuation(neutral_input=PlanarForce(0.1, 0.2), period=ms(6))
    nothing = replace(new_sample(0, PlanarForce(5.0, 6.0)), valid=False)
    _, out = actuation.step(0, (), nothing)
    assert (float(out.u.FX), float(out.u.FY)) == (0.1, 0.2)
    assert actuation.neutral().u is actuation.neutral_input
    assert actuation.period == 60_000


def test_accepts_any_record_as_input():
    actuation = DirectActuation(neutral_input={"elevator": np.zeros(2)})
    _, out = actuation.step(0, (), new_sample(0, {"elevator": np.array([0.1, 0.2])}))
    assert out.u["elevator"].tolist() == [0.1, 0.2]


def test_parts_implement_the_interfaces():
    assert isinstance(DirectAllocation(), Allocation)
    assert isinstance(DirectActuation(), Actuators)
    assert DirectAllocation().init(None) == DirectActuation().init(None) == ()

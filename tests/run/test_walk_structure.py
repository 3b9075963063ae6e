"""Structure of a compiled loop: how often JAX traces the estimator."""

from typing import Any, ClassVar

import numpy as np
from loop.cart import SECOND, Place, cart_autopilot, cart_world

from trimtab.core.record import record, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain
from trimtab.run.inputs import RunInputs
from trimtab.run.walk_structure import lower_structure, walk_structure

TRACES: list[str] = []
"""One entry for each trace of the estimator's step()."""


@record
class TracedPassthrough:
    """Passthrough of the ruler's samples that records each trace of its step(). Source: this test."""

    listens: ClassVar[tuple[str, ...]] = ("ruler",)

    def init(self, key: Any) -> Any:
        return Passthrough("ruler").init(key)

    def step(self, t: Any, state: Any, frame: Frame) -> tuple[Any, Estimate]:
        TRACES.append("step")
        return Passthrough("ruler").step(t, state, frame)


def test_shapes_and_loop_share_one_trace_of_the_estimator():
    world = cart_world(downlink=DelayChain(2 * SECOND, 1))
    autopilot = cart_autopilot(estimator=TracedPassthrough())
    inputs = RunInputs(*map(to_arrays, (world, autopilot, Place(0.0))), Key(np.uint32(0), np.uint32(0)))
    lower_structure(walk_structure(inputs, frozenset({SECOND}), ()))
    assert TRACES == ["step"]

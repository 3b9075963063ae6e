"""A link of your own: trimtab run my_link.py:scenario"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab import Scenario, build, ms, option, part, period, quantity, record, replace
from trimtab.core.quantity import imperfection
from trimtab.core.record import tree_where
from trimtab.core.rng import Key, uniform2
from trimtab.core.signals import Sample
from trimtab.core.time import NEVER
from trimtab.links.fifo import empty_slots, measurement_time, read_slot, receive_sample, write_slot


@record
class MyLinkState:
    """Packets in transit, one slot for each, and the last one that arrived. Source: this file."""

    key: Key = part("Random key of the losses.")
    values: Any = part("Values in transit; each number has a leading axis of slots.")
    times: Any = quantity("100 ns", "Measurement times of the values; NEVER: the packet was lost.", kind="time")
    value: Any = part("Last value that arrived.")
    time: Any = quantity("100 ns", "Measurement time of the last value.", kind="time")


@record
class MyLink:  # its fields are settings: --set world.uplink.loss=0.3
    """Each period one packet leaves; it arrives `steps` periods later, or is lost. Source: this file."""

    loss: Any = imperfection("1", "Probability that a packet is lost.", "loss", high=1, default=0.05)
    steps: int = option("Delay of a packet, in periods; 1 or more.", default=2)
    period: int = period("Time between packets.", default=ms(20))

    def init(self, key: Key, like: Sample) -> MyLinkState:
        """Return the first state, without packets, for samples like `like`: of a sensor, or a command."""
        values, times = empty_slots(like.value, self.steps), np.full(self.steps, NEVER, np.int64)
        return MyLinkState(key, values, times, like.value, np.int64(NEVER))

    def step(self, t: Any, state: Any, sample: Sample) -> tuple[MyLinkState, Sample]:
        """Return the sample at the far end at integer time t (100 ns); a command of 100 ms ago has age 0.1 s."""
        k = t // self.period  # number of the packet that leaves
        slot, ring = k % self.steps, (state.values, state.times)
        arrived, time = read_slot(ring, slot)  # which left `steps` periods ago
        value, time = tree_where(time != NEVER, (arrived, time), (state.value, state.time))
        luck, _ = uniform2(state.key, k)  # between 0 and 1
        leaves = (sample.value, jnp.where(luck < self.loss, NEVER, measurement_time(sample)))
        values, times = write_slot(ring, slot, leaves)
        held = receive_sample(t, value, time, state.time)
        return MyLinkState(state.key, values, times, value, time), held


def scenario() -> Scenario:
    """The hovercraft drives forward, its navigation without errors; this link carries the autopilot's commands."""
    base = build("hovercraft/forward", without=["navigation-error"])
    return replace(base, world=replace(base.world, uplink=MyLink()), name="my_link")

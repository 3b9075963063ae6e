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
    """State of the link: packets in transit, one per slot, and the last packet that arrived. Source: this file."""

    key: Key = part("Key of the random numbers that determine the losses.")
    values: Any = part("Values in transit. The first axis of each array is the slot.")
    times: Any = quantity("100 ns", "Measurement times of the values, NEVER for a lost packet.", kind="time")
    value: Any = part("Last value that arrived.")
    time: Any = quantity("100 ns", "Measurement time of the last value.", kind="time")


@record
class MyLink:  # its fields are settings: --set world.uplink.loss=0.3
    """Link that sends one packet per period. A packet arrives `steps` periods later, or is lost. Source: this file."""

    loss: Any = imperfection("1", "Probability that a packet is lost.", "loss", high=1, default=0.05)
    steps: int = option("Delay of a packet, in periods, at least 1.", default=2)
    period: int = period("Time between packets.", default=ms(20))

    def init(self, key: Key, like: Sample) -> MyLinkState:
        """Return the initial state, with no packets in transit. like: example of a sample to transmit."""
        values, times = empty_slots(like.value, self.steps), np.full(self.steps, NEVER, np.int64)
        return MyLinkState(key, values, times, like.value, np.int64(NEVER))

    def step(self, t: Any, state: Any, sample: Sample) -> tuple[MyLinkState, Sample]:
        """Return the newest sample at the receiver at integer time t (100 ns), with its age since the measurement."""
        k = t // self.period  # number of the packet that is sent now
        slot, ring = k % self.steps, (state.values, state.times)
        arrived, time = read_slot(ring, slot)  # the packet that was sent `steps` periods ago
        value, time = tree_where(time != NEVER, (arrived, time), (state.value, state.time))
        luck, _ = uniform2(state.key, k)  # uniform between 0 and 1
        leaves = (sample.value, jnp.where(luck < self.loss, NEVER, measurement_time(sample)))
        values, times = write_slot(ring, slot, leaves)
        held = receive_sample(t, value, time, state.time)
        return MyLinkState(state.key, values, times, value, time), held


def scenario() -> Scenario:
    """Return the scenario: a hovercraft drives forward, with exact navigation. This link carries the commands."""
    base = build("hovercraft/forward", without=["navigation-error"])
    return replace(base, world=replace(base.world, uplink=MyLink()), name="my_link")

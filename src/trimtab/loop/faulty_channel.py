"""A channel with a fault."""

import zlib
from typing import Any

import jax
import numpy as np

from trimtab.core.record import option, part, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Sample
from trimtab.loop.fault import Fault
from trimtab.loop.faulty_samples import FaultySamples, apply_fault, initial_fault_memory

STREAM = zlib.crc32(b"fault of a channel")
"""All that goes over a link is hit at the same time: the draws don't depend on what is carried."""


@record
class FaultyChannelState:
    """State of the channel, and what its fault remembers. Frames: theirs. Source: docs page, Faults."""

    inner: Any = part("State of the channel.")
    samples: FaultySamples = part("What the fault remembers.")


@record
class FaultyChannel:
    """A channel at whose receiving end a fault acts; before and after it is the channel itself, bit for bit.

    What a wire spoils is refused by its checksum, so garbage is silence here. The fault may watch what is carried, e.g.
    `value.surge_velocity` or `age`.

    Frames:  those of the values carried.    Source:  docs page, Faults.
    """

    inner: Any = part("The channel.")
    fault: Fault = part("What goes wrong.", default=Fault())
    capacity: int = option("How many steps a delay may lie back, and one.", default=2)

    @property
    def period(self) -> int:
        """The channel's."""
        return self.inner.period

    def check(self) -> None:
        """Refuse a delay that can't be held."""
        self.fault.check_ring(self.period, self.capacity)

    def init(self, key: Key, like: Sample) -> FaultyChannelState:
        """Nothing received."""
        inner = self.inner.init(key, like)
        sample = jax.eval_shape(lambda s, x: self.inner.step(np.int64(0), s, x)[1], inner, like)
        return FaultyChannelState(
            inner=inner, samples=initial_fault_memory(Key(key.seed, key.run, STREAM), sample, self.capacity)
        )

    def step(self, t: Any, state: FaultyChannelState, sample: Sample) -> tuple[FaultyChannelState, Sample]:
        """What the receiving end holds at integer time t."""
        inner, arrived = self.inner.step(t, state.inner, sample)
        samples, out = apply_fault(t, state.samples, self.fault, arrived, arrived, step=self.period, checked=True)
        return replace(state, inner=inner, samples=samples), out

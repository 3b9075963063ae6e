"""Links without chance: a wire, out of which comes at once what goes in, and a chain of unit delays."""

from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, hold_sample, is_new
from trimtab.core.time import NEVER, SECONDS_PER_UNIT, ms
from trimtab.links.fifo import empty_slots, measurement_time, read_slot, receive_sample, write_slot


@record
class WireState:
    """What the receiving end holds. Source: docs page."""

    seen: Scalar = quantity("100 ns", "When the sample at the receiving end was measured.", kind="time")


@record
class Wire:
    """A channel without any fault: the newest sample comes out each time the wire is looked at, with its age.

    Fresh is what was not there before, so a sensor need not keep the wire's time: a sample measured between two looks
    is fresh at the next.

    Frames:  those of the values carried.    Not modelled: anything.    Source: docs page.
    """

    period: int = period("How often the wire is looked at.", default=ms(1))

    def init(self, key: Key, like: Sample) -> WireState:
        """Nothing received."""
        return WireState(seen=np.int64(NEVER))

    def step(self, t: Any, state: WireState, sample: Sample) -> tuple[WireState, Sample]:
        """The same sample, as seen at integer time t."""
        return WireState(seen=measurement_time(sample)), hold_sample(t, sample, fresh=is_new(sample, state.seen))


@record
class DelayLine:
    """What the unit delays hold. Leaves have a leading axis of `steps` slots. Source: docs page."""

    values: Any = part("The value in each slot.")
    measured: Scalar = quantity("100 ns", "When the value in each slot was measured.", kind="time")
    held: Scalar = quantity("100 ns", "When the sample at the receiving end was measured.", kind="time")


@record
class DelayChain:
    """Sample and hold each `period`, followed by `steps` unit delays of that period.

        y(k) = u(k - steps),   t = k period

    Frames:  those of the values carried.    Not modelled: jitter, loss (see `MeasuredLatency`).
    Valid:   called at every multiple of `period`, as the loop does.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.1: 6 unit delays of 6 ms on the way down, 2 of 20 ms on the way up.
    """

    period: int = period("Of the sample and hold and of each unit delay.")
    steps: int = option("Number of unit delays; 0 leaves the sample and hold.", off={"delay": 0})

    def check(self) -> None:
        """Refuse a number of delays that is not a whole number from 0 on."""
        steps: Any = self.steps
        if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 0:
            raise InputError("DelayChain.steps", f"{steps!r} is not a number of unit delays", fix="write 0, 1, 2, ...")

    def delay(self) -> float:
        """Time from an input sampled to its output (s)."""
        return self.steps * self.period * SECONDS_PER_UNIT

    def init(self, key: Key, like: Sample) -> DelayLine:
        """Nothing under way, for samples of the structure of `like`."""
        return DelayLine(
            values=empty_slots(like.value, self.steps),
            measured=np.full(self.steps, NEVER, np.int64),
            held=np.int64(NEVER),
        )

    def step(self, t: Any, state: DelayLine, sample: Sample) -> tuple[DelayLine, Sample]:
        """What went in `steps` periods before integer time t, a multiple of `period`."""
        new = (sample.value, measurement_time(sample))
        ring = (state.values, state.measured)
        if self.steps:
            slot = t // self.period % self.steps
            value, measured = read_slot(ring, slot)
            ring = write_slot(ring, slot, new)
        else:
            value, measured = new
        return DelayLine(*ring, held=measured), receive_sample(t, value, measured, state.held)

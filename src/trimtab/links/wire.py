"""Deterministic links: an ideal link (wire) without delay, and a chain of unit delays."""

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
    """State of an ideal link at the receiving end. Source: docs page."""

    seen: Scalar = quantity("100 ns", "Measurement time of the sample at the receiving end.", kind="time")


@record
class Wire:
    """Ideal link without delay. At each call it returns the newest sample and the age of this sample.

    A sample is fresh if it was not available at the previous call. So a sensor need not be synchronous with the link: a
    sample measured between two calls is fresh at the next call.

    Frames:  those of the transmitted values.    Not modelled: any delay or loss.    Source: docs page.
    """

    period: int = period("Period at which the receiving end polls the link.", default=ms(1))

    def init(self, key: Key, like: Sample) -> WireState:
        """Return the initial state, before the first sample is received."""
        return WireState(seen=np.int64(NEVER))

    def step(self, t: Any, state: WireState, sample: Sample) -> tuple[WireState, Sample]:
        """Return the new state, and the sample as received at integer time t."""
        return WireState(seen=measurement_time(sample)), hold_sample(t, sample, fresh=is_new(sample, state.seen))


@record
class DelayLine:
    """State of a chain of unit delays. The first axis of each array has one element per delay (`steps`). Source: docs
    page."""

    values: Any = part("Value in each element of the delay chain.")
    measured: Scalar = quantity(
        "100 ns", "Measurement time of the value in each element of the delay chain.", kind="time"
    )
    held: Scalar = quantity("100 ns", "Measurement time of the sample at the receiving end.", kind="time")


@record
class DelayChain:
    """Sample and hold with a period, followed by `steps` unit delays of that period.

        y(k) = u(k - steps),   t = k period

    Frames:  those of the transmitted values.    Not modelled: jitter, loss (see `MeasuredLatency`).
    Valid:   called at every multiple of `period`, as the loop does.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.1: 6 unit delays of 6 ms on the downlink, 2 unit delays of 20 ms on the uplink.
    """

    period: int = period("Period of the sample and hold and of each unit delay.")
    steps: int = option("Number of unit delays after the sample and hold, 0 for no delay.", off={"delay": 0})

    def check(self) -> None:
        """Raise InputError unless `steps` is a whole number, at least 0."""
        steps: Any = self.steps
        if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 0:
            raise InputError(
                "DelayChain.steps",
                f"the number of unit delays must be a whole number, at least 0, got {steps!r}",
                fix="write 0, 1, 2, ...",
            )

    def delay(self) -> float:
        """Return the delay (s) from the sampling of an input to the output of this sample."""
        return self.steps * self.period * SECONDS_PER_UNIT

    def init(self, key: Key, like: Sample) -> DelayLine:
        """Return the initial state, without samples, for samples with the structure of `like`."""
        return DelayLine(
            values=empty_slots(like.value, self.steps),
            measured=np.full(self.steps, NEVER, np.int64),
            held=np.int64(NEVER),
        )

    def step(self, t: Any, state: DelayLine, sample: Sample) -> tuple[DelayLine, Sample]:
        """Return the new state, and the input from `steps` periods before integer time t. t: a multiple of `period`."""
        new = (sample.value, measurement_time(sample))
        ring = (state.values, state.measured)
        if self.steps:
            slot = t // self.period % self.steps
            value, measured = read_slot(ring, slot)
            ring = write_slot(ring, slot, new)
        else:
            value, measured = new
        return DelayLine(*ring, held=measured), receive_sample(t, value, measured, state.held)

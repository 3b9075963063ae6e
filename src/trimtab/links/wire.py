"""A wire: what goes in comes out at once."""

from typing import Any

import numpy as np

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, hold_sample, is_new
from trimtab.core.time import ms
from trimtab.links.fifo import NEVER, measurement_time


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

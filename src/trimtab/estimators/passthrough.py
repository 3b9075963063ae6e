"""Estimator that passes on the samples of one sensor, for a sensor that measures the complete state that a law
needs."""

from typing import Any

from trimtab.core.record import option, record
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds


@record
class Passthrough:
    """Estimator whose estimate is the newest sample of one sensor, however old. The age of the sample is part of the
    estimate.

    Source: docs page, Passthrough.
    """

    sensor: str = option("Name of the sensor whose samples are passed on.", default="navigation")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the name of the sensor whose samples are passed on."""
        return (self.sensor,)

    def init(self, key: Key) -> tuple[()]:
        """Return an empty tuple, because the estimator has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], frame: Frame) -> tuple[tuple[()], Estimate]:
        """Return the value of the newest sample as the estimate. The estimate is valid from the first sample on."""
        newest = frame.samples[self.sensor]
        age = to_seconds(t - newest.t)
        return state, Estimate(t=t, age=age, fresh=newest.fresh, valid=newest.valid, state=newest.value)

"""Estimator that passes on one sensor, for sensors that already give the state that the law reads."""

from typing import Any

from trimtab.core.record import option, record
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds


@record
class Passthrough:
    """Takes the newest sample of one sensor as the estimate, however old it is; its age is a signal.

    Source: docs page, Passthrough.
    """

    sensor: str = option("Name of the sensor.", default="navigation")

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the name of the sensor."""
        return (self.sensor,)

    def init(self, key: Key) -> tuple[()]:
        """Return the empty state."""
        return ()

    def step(self, t: Any, state: tuple[()], frame: Frame) -> tuple[tuple[()], Estimate]:
        """Return the sample's value, valid from the first sample on."""
        newest = frame.samples[self.sensor]
        age = to_seconds(t - newest.t)
        return state, Estimate(t=t, age=age, fresh=newest.fresh, valid=newest.valid, state=newest.value)

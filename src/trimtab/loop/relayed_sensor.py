"""A sensor whose samples pass a bus of the vehicle before anybody can send them to the ground."""

from typing import Any, ClassVar

import jax
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import part, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, no_motion
from trimtab.core.time import format_time
from trimtab.loop.structure import cast_like, strengthen_types


@record
class RelayedSensorState:
    """State of the sensor, and what is on the bus. Frames: theirs. Source: docs page, Slave bus."""

    inner: Any = part("State of the sensor.")
    bus: Any = part("What is on its way.")


@record
class RelayedSensor:
    """A sensor on a unit of its own, seen from the unit with the radio: its samples as they come off a bus.

    Times of measurement travel with the samples, so ages have the bus in them. A real line takes the place of a
    scenario's radio, and not of this.

    Frames:  the sensor's.    Source:  docs page, Slave bus.
    """

    inner: Any = part("The sensor.")
    bus: Any = part("The bus: a channel that looks as often as the sensor does.")

    LATE: ClassVar[bool] = True
    """Samples come out after the time at which they were measured."""

    @property
    def period(self) -> int:
        """The sensor's, and the bus's."""
        return self.inner.period

    def check(self) -> None:
        """Refuse a sensor that feels no motion, and a bus that looks at other times than the sensor."""
        if optional_member(self.inner, "FEELS") != "motion":
            problem = f"{type(self.inner).__name__} feels {self.inner.FEELS!r}: there is nothing of it on a bus"
            raise InputError("RelayedSensor.inner", problem, fix="leave it as it is, without a bus")
        if self.bus.period != self.inner.period:
            problem = f"looks each {format_time(self.bus.period)}, the sensor each {format_time(self.inner.period)}"
            raise InputError("RelayedSensor.bus", problem, fix=f"set bus.period to {format_time(self.inner.period)}")

    def init(self, key: Key) -> RelayedSensorState:
        """Nothing measured, nothing on the bus."""
        inner = self.inner.init(key)
        sample = jax.eval_shape(lambda s: self.inner.step(np.int64(0), s, no_motion())[1], inner)
        return RelayedSensorState(inner=inner, bus=strengthen_types(self.bus.init(key.at("bus"), sample)))

    def measure(self, motion: Any) -> Any:
        """The sensor's, without noise or bus."""
        return self.inner.measure(motion)

    def step(self, t: Any, state: RelayedSensorState, motion: Any) -> tuple[RelayedSensorState, Sample]:
        """What has come off the bus by integer time t."""
        inner, sample = self.inner.step(t, state.inner, motion)
        bus, out = self.bus.step(t, state.bus, sample)
        return RelayedSensorState(inner=inner, bus=cast_like(bus, state.bus)), out

"""Sensor whose samples are transmitted over a bus on board before they are sent to the ground."""

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
    """State of a relayed sensor and its bus. Frames: those of the sensor. Source: docs page, Slave bus."""

    inner: Any = part("State of the sensor.")
    bus: Any = part("State of the bus, with samples in transit.")


@record
class RelayedSensor:
    """Sensor whose samples are transmitted over a bus on board to the microcontroller with the radio.

    A sample contains the time of its measurement, so its age includes the delay of the bus. In a flight over a real
    link, the link replaces the scenario's radio link, but the bus is still simulated.

    Frames:  the sensor's.    Source:  docs page, Slave bus.
    """

    inner: Any = part("Sensor.")
    bus: Any = part("Bus between sensor and radio: a channel whose period equals the sensor's.")

    LATE: ClassVar[bool] = True
    """True for a sensor whose samples arrive later than they are measured."""

    @property
    def period(self) -> int:
        """Return the period of the sensor, which is also that of the bus."""
        return self.inner.period

    def check(self) -> None:
        """Raise InputError if the sensor does not measure the motion, or if bus and sensor have different periods."""
        if optional_member(self.inner, "FEELS") != "motion":
            problem = (
                f"{type(self.inner).__name__} measures {self.inner.FEELS!r}, but a bus needs a sensor of the 'motion'"
            )
            raise InputError("RelayedSensor.inner", problem, fix="use this sensor without a bus")
        if self.bus.period != self.inner.period:
            problem = (
                f"period must equal the sensor's period, {format_time(self.inner.period)}, "
                f"got {format_time(self.bus.period)}"
            )
            raise InputError("RelayedSensor.bus", problem, fix=f"set bus.period to {format_time(self.inner.period)}")

    def init(self, key: Key) -> RelayedSensorState:
        """Return the initial state, with no measurement and no sample on the bus."""
        inner = self.inner.init(key)
        sample = jax.eval_shape(lambda s: self.inner.step(np.int64(0), s, no_motion())[1], inner)
        return RelayedSensorState(inner=inner, bus=strengthen_types(self.bus.init(key.at("bus"), sample)))

    def measure(self, motion: Any) -> Any:
        """Return the sensor's measurement, without noise and without the delay of the bus."""
        return self.inner.measure(motion)

    def step(self, t: Any, state: RelayedSensorState, motion: Any) -> tuple[RelayedSensorState, Sample]:
        """Return the state and the sample that has arrived over the bus by integer time t."""
        inner, sample = self.inner.step(t, state.inner, motion)
        bus, out = self.bus.step(t, state.bus, sample)
        return RelayedSensorState(inner=inner, bus=cast_like(bus, state.bus)), out

"""Heading sensors: one that measures the heading with noise and latency, and a compass that uses a magnetometer.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace
from trimtab.core.rng import Key, normal2
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms
from trimtab.environment.magnetic import magnetic_heading
from trimtab.sensors.late_fix import LateFix, LateSensorState
from trimtab.sensors.magnetometer import Magnetometer


@record
class HeadingReading:
    """Sample of a measured heading. Source: docs page, Heading."""

    heading: Scalar = quantity("rad", "Angle from north to the body's x axis, clockwise; modulo 2 pi.", kind="angle")


@record
class HeadingSensor:
    """Sensor of the heading with noise, a measurement interval and latency.

        z = psi + w

    The sensor represents a heading that is computed from the positions of two ultrasonic units on the vehicle. The
    geometry of the units is not modelled.

    Frames:  heading of B in W.    Not modelled: errors correlated in time.
    Source:  [1] section 6.2.1. The latency is reconstructed, see docs Errata.
    """

    noise: Scalar = imperfection(
        "rad", "Standard deviation of the noise of each measured heading.", "heading-noise", default=0.03
    )
    timing: LateFix = part(
        "Timing of the measurements: interval, latency and time stamp.",
        default=LateFix(),
        off={"heading-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    period: int = period("Time between checks for a new measurement.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the period is too long to catch every measurement."""
        self.timing.check_period(self.period)

    def init(self, key: Key) -> LateSensorState:
        """Return the initial state, before any measurement."""
        return LateSensorState(key, self.timing.initial_state(HeadingReading(heading=jnp.asarray(0.0))))

    def measure(self, motion: Motion) -> HeadingReading:
        """Return the measurement h(x) for the vehicle's motion, without noise."""
        return HeadingReading(heading=motion.attitude[2])

    def step(self, t: Any, state: LateSensorState, motion: Motion) -> tuple[LateSensorState, Sample]:
        """Return the newest heading that has arrived at time t (unit: 100 ns)."""
        w, _ = normal2(state.key, self.timing.measurement_number(t))
        true = self.measure(motion)
        late, sample = self.timing.deliver(t, state.late, HeadingReading(true.heading + self.noise * w))
        return LateSensorState(state.key, late), sample


@record
class Compass:
    """Heading from a magnetometer's field, assuming a level vehicle.

        z = atan2( (b × w)_z, b · w )

    where b is the measured field and w the known field of the earth. Only their horizontal components count.

    Frames:  heading of B in W.    Not modelled: tilt compensation; a tilt shifts the heading by up to tilt tan(dip).
    Source:  [1] eqs. 3.43-3.44, with the arc cosine replaced (docs page, Errata).
    """

    magnetometer: Magnetometer = part(
        "Magnetometer that measures the field.", default=Magnetometer.microstrain_3dm_gx1()
    )

    @property
    def period(self) -> int:
        """Return the magnetometer's period."""
        return self.magnetometer.period

    def init(self, key: Key) -> Any:
        """Return the initial state of the magnetometer."""
        return self.magnetometer.init(key)

    def measure(self, motion: Motion) -> HeadingReading:
        """Return the measurement h(x) for the vehicle's motion, from the earth's field alone."""
        return self._heading(self.magnetometer.measure(motion).field)

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        state, sample = self.magnetometer.step(t, state, motion)
        return state, new_sample(t, self._heading(sample.value.field))

    def _heading(self, field: Any) -> HeadingReading:
        return HeadingReading(heading=magnetic_heading(field, jnp.asarray(self.magnetometer.earth_field)))

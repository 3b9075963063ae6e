"""Three-axis magnetometer, with the iron of the vehicle and magnetic objects nearby."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.environment.magnetic import COLLEGE_PARK
from trimtab.sensors.gyro_dynamics import TICK
from trimtab.sensors.imu import ZERO, digitise

GAUSS = 1e-4
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
PERMEABILITY = 1e-7
"""Magnetic constant mu0/(4 pi) (T m/A)."""


@record
class FieldReading:
    """Sample of a magnetometer. Frames: B. Source: docs page, Magnetometer."""

    field: Any = quantity("T", "Magnetic flux density.", frame="B", shape=(3,))
    saturated: Scalar = quantity("1", "True if an axis is saturated.", kind="flag")


def dipole_field(moment: Any, away: Any, size: Any) -> Any:
    """Return the magnetic field (3,) (T) of a dipole `moment` (3,) (A m²) at an offset `away` (3,) (m) from it.

        B = 1e-7 (3 (m·r) r/(r² + size²) - m)/(r² + size²)^(3/2)

    size: radius (m) of the magnetic body. Within this radius the field stays finite.

    Source: Jackson, "Classical electrodynamics", eq. 5.56.
    """
    r2 = away @ away + size * size
    return PERMEABILITY * (3 * (moment @ away) * away / r2 - moment) / (r2 * jnp.sqrt(r2))


@record
class RunningMotor:
    """Motor on the vehicle: a magnetic dipole fixed in the body, with a moment proportional to the motor's current.

    The current follows a given schedule, because a `Motion` does not contain the vehicle's current. The current is
    constant between two instants and zero before the first. A negative duty reverses the field.

    Frames: position and moment in B.    Not modelled: brush ripple, which the magnetometer's noise represents.
    Source: Jackson, "Classical electrodynamics", eq. 5.56; sizes reconstructed (docs page, Magnetometer).
    """

    position: Any = quantity(
        "m", "Position of the motor on the vehicle.", frame="B", default=(-0.25, 0.0, 0.0), shape=(3,)
    )
    moment: Any = quantity(
        "A m^2", "Dipole moment of the motor at a duty of 1.", frame="B", default=(0.0, 0.3, 0.0), shape=(3,)
    )
    size: Scalar = quantity("m", "Radius of the motor.", default=0.014, above=0)
    instants: Any = quantity(
        "100 ns", "Times at which the motor's duty changes (n,); must increase.", kind="time", default=(0,)
    )
    duty: Any = quantity(
        "1",
        "Duty of the motor from each instant on (n,), as a fraction of the full current; negative: reverse.",
        default=(1.0,),
    )

    def check(self) -> None:
        """Raise InputError if the numbers of duties and instants differ, or the instants do not increase."""
        instants, duty = np.asarray(self.instants), np.asarray(self.duty)
        if instants.ndim != 1 or instants.shape != duty.shape or not instants.size:
            problem = f"instants and duty must have the same shape (n,), got {instants.shape} and {duty.shape}"
            raise InputError("RunningMotor.duty", problem, fix="give one duty for each instant")
        if (np.diff(instants) <= 0).any():
            raise InputError(
                "RunningMotor.instants", f"the times must increase, got {instants.tolist()}", fix="sort the instants"
            )

    def field(self, motion: Motion, place: Any) -> Any:
        """Return the magnetic field of the motor (3,) (T) in B at a position (3,) (m) in B."""
        begun = jnp.sum(motion.t >= jnp.asarray(self.instants))
        duty = jnp.where(begun > 0, jnp.asarray(self.duty)[jnp.maximum(begun - 1, 0)], 0.0)
        away = jnp.asarray(place) - jnp.asarray(self.position)
        return dipole_field(duty * jnp.asarray(self.moment), away, self.size)


@record
class FloorSteel:
    """Piece of magnetised steel in or under the floor: a magnetic dipole fixed in the world.

    Frames: position and moment in W.    Not modelled: the length of the piece (model a beam by several pieces).
    Source: Jackson, "Classical electrodynamics", eq. 5.56; sizes reconstructed (docs page, Magnetometer).
    """

    position: Any = quantity(
        "m", "Position of the steel: north, east, down.", frame="W", default=(1.0, 1.0, 0.3), shape=(3,)
    )
    moment: Any = quantity(
        "A m^2", "Dipole moment of the magnetised steel.", frame="W", default=(2.0, 0.0, 4.0), shape=(3,)
    )
    size: Scalar = quantity("m", "Radius of the magnetised steel.", default=0.1, above=0)

    def field(self, motion: Motion, place: Any) -> Any:
        """Return the magnetic field of the steel (3,) (T) in B at a position (3,) (m) in B."""
        R_WB = from_euler(*motion.attitude)
        away = motion.p_WB + R_WB @ jnp.asarray(place) - jnp.asarray(self.position)
        return R_WB.T @ dipole_field(jnp.asarray(self.moment), away, self.size)


@record
class Magnetometer:
    """Three-axis magnetometer fixed to the body.

        h = R_SB R_BW m_W,    z = quantised( clip( S (h + d) + b + w ) )

    with m_W the earth's field, S soft iron, b hard iron, d the field of objects nearby, w white noise.

    Frames:  north-east-down field in W, iron in the sensor's axes; mounting as roll, pitch, yaw of the sensor in B.
    Not modelled: bandwidth, temperature.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             eqs. 3.43-3.44; the form of the errors is that of Gebre-Egziabher et al., J. Aerospace Eng. 19 (2006).
    """

    earth_field: Any = quantity("T", "Earth's field: north, east, down.", frame="W", default=COLLEGE_PARK, shape=(3,))
    hard_iron: Any = quantity(
        "T",
        "Hard iron: field of magnetised parts on board.",
        frame="B",
        default=ZERO,
        shape=(3,),
        off={"hard-iron": ZERO},
    )
    soft_iron: Any = quantity(
        "1",
        "Soft iron: field distortion by soft magnetic parts on board.",
        frame="B",
        default=IDENTITY,
        shape=(3, 3),
        off={"soft-iron": IDENTITY},
    )
    noise: Scalar = imperfection("T", "Standard deviation of the noise of each axis and sample.", "magnetometer-noise")
    resolution: Scalar = imperfection(
        "T", "Quantisation step of the converter; 0: no quantisation.", "magnetometer-quantisation"
    )
    range: Scalar = imperfection(
        "T", "Largest magnitude of the output of an axis; 0: no limit.", "magnetometer-saturation"
    )
    position: Any = quantity("m", "Position of the sensor on the vehicle, in B.", frame="B", default=ZERO, shape=(3,))
    mounting: Any = quantity(
        "rad",
        "Orientation of the magnetometer in B: roll, pitch, yaw.",
        default=ZERO,
        kind="angle",
        shape=(3,),
        off={"magnetometer-mounting": ZERO},
    )
    disturbances: Any = part(
        "Magnetic objects nearby: a tuple of RunningMotor, FloorSteel, …", default=(), off={"magnetic-disturbances": ()}
    )
    period: int = period("Time between samples.", default=TICK)

    @classmethod
    def microstrain_3dm_gx1(cls, **settings: Any) -> "Magnetometer":
        """Return the magnetometer of the hovercraft of [1]. settings: fields to change, as name=value.

        The noise reproduces the heading variance of [1], 1.6e-4 rad², in the default field. Its standard deviation is
        0.0126 rad times the horizontal field. The 16-bit output with a full scale of 2 gauss is taken from public code
        for the vehicle's inertial unit.
        """
        noise = math.sqrt(1.6e-4) * math.hypot(*COLLEGE_PARK[:2])
        return cls(**{"noise": noise, "resolution": 2 * GAUSS / 32768, "range": 2 * GAUSS, **settings})

    def init(self, key: Key) -> Key:
        """Return the initial state: the key of the random number generator."""
        return key

    def measure(self, motion: Motion) -> FieldReading:
        """Return the measurement h(x) for the vehicle's motion: the earth's field alone, without error."""
        R_SB = from_euler(*jnp.asarray(self.mounting)).T
        field = R_SB @ (from_euler(*motion.attitude).T @ jnp.asarray(self.earth_field))
        return FieldReading(field=field, saturated=jnp.asarray(False))

    def step(self, t: Any, state: Key, motion: Motion) -> tuple[Key, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        near = jnp.zeros(3)
        for disturbance in self.disturbances:
            near = near + disturbance.field(motion, self.position)
        there = self.measure(motion).field + from_euler(*jnp.asarray(self.mounting)).T @ near
        noise = self.noise * normals(state, t // self.period, 3)
        output = jnp.asarray(self.soft_iron) @ there + jnp.asarray(self.hard_iron) + noise
        return state, new_sample(t, FieldReading(*digitise(output, self.range, self.resolution)))

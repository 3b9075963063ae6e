"""Ranges between beacons and a vehicle from the time of flight of ultrasound, with their errors.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, quantity, record
from trimtab.core.rng import Key, normal2, uniform2
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion
from trimtab.environment.acoustics import CONE, Air, off_axis_angle, range_ratio, speed_of_sound

SURVEY, CRYSTAL, NOISE, STRAY, ECHO = 110, 113, 120, 121, 122
"""Identifiers of the random streams for survey errors, timer errors, noise, stray ranges and echoes."""
CEILING = 2.7048
"""Height (m) of the beacons above the vehicle's ultrasonic units in the calibration of [1] (table 5.2)."""
CEILING_SQUARE = np.array([[1.5, 1.5, -CEILING], [1.5, -1.5, -CEILING], [-1.5, -1.5, -CEILING], [-1.5, 1.5, -CEILING]])
"""Positions (4, 3) in W of four beacons at the ceiling, at the corners of a 3 m square."""


@record
class Beacons:
    """Ultrasonic beacons that point straight down, and the deviations of their true positions from the map.

    The number n of beacons is the number of rows of `map`. `moved` and `dead` have one entry for each beacon, or one
    value for all beacons.

    Frames:  positions in W.    Source:  [1] section 5.5 for range and cone; spacing is reconstructed, see docs Errata.
    """

    map: Any = quantity("m", "Surveyed positions of the beacons (n, 3).", default=CEILING_SQUARE, frame="W")
    survey_error: Scalar = imperfection(
        "m", "Standard deviation of the survey error of each beacon coordinate.", "survey-error"
    )
    reach: Scalar = quantity("m", "Longest measurable range (30 ft).", default=9.144, above=0, source="[1] section 5.5")
    cone: Scalar = quantity(
        "rad", "Half the opening angle of a beacon's sound cone.", default=CONE, kind="angle", above=0
    )
    crystal: Scalar = quantity(
        "1", "Standard deviation of the relative error of each beacon's timer.", default=20e-6, low=0
    )
    moved: Any = quantity(
        "m",
        "Displacement of each beacon by a fault (n, 3), or one value for all beacons.",
        default=0.0,
        frame="W",
        off={"beacon-fault": lambda beacons: 0.0 * np.asarray(beacons.moved)},
    )
    dead: Any = quantity(
        "1",
        "True for each beacon silenced by a fault (n,), or one value for all beacons.",
        default=False,
        kind="flag",
        off={"beacon-fault": False},
    )
    fault_time: Scalar = quantity(
        "100 ns", "Time of the beacon fault. From then on the beacons are displaced or silent.", default=0, kind="time"
    )

    def check(self) -> None:
        """Raise InputError if the map's shape is not (n, 3), or the shape of a fault does not match it."""
        shape = np.shape(self.map)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 1:
            raise InputError(
                "Beacons.map",
                f"the map has shape {shape}, but must have shape (n, 3)",
                fix="give one row (north, east, down) for each beacon",
            )
        for name, value, per_beacon in (("moved", self.moved, shape), ("dead", self.dead, shape[:1])):
            if np.shape(value) not in ((), per_beacon):
                problem = f"the array has shape {np.shape(value)}, which does not match the map of {shape[0]} beacons"
                raise InputError(
                    f"Beacons.{name}", problem, fix=f"give one value for all beacons, or an array of shape {per_beacon}"
                )


@record
class RangeErrors:
    """Errors of a single measured range.

    Source: noise reconstructed from the spread of position fixes in [1] section 5.5.4, see docs Errata. [1] has no
    figures for stray ranges and echoes, so both are off by default.
    """

    noise: Scalar = imperfection("m", "Standard deviation of the noise of each range.", "range-noise", default=0.004)
    stray_probability: Scalar = imperfection(
        "1", "Probability of a stray range, which is unrelated to the true distance.", "stray-ranges", high=1
    )
    stray_size: Scalar = quantity("m", "Largest magnitude of the error of a stray range.", default=3.0, low=0)
    echo_probability: Scalar = imperfection(
        "1", "Probability that an echo is measured instead of the direct sound.", "echoes", high=1
    )
    echo_size: Scalar = quantity("m", "Largest extra path length of an echo.", default=1.0, low=0)


@record
class Medium:
    """Air that carries the sound, and the air that the receiver assumes. Source: docs page."""

    actual: Air = part("Actual air through which the sound travels.", default=Air())
    assumed: Air = part(
        "Air for which the receiver computes the speed of sound.",
        default=Air(),
        off={"sound-speed": lambda medium: medium.actual},
    )


def unit_position(motion: Motion, lever: Any) -> Any:
    """Return the position (3,) in W of an ultrasonic unit, from its position `lever` (3,) in B."""
    roll, pitch, yaw = motion.attitude[0], motion.attitude[1], motion.attitude[2]
    return motion.p_WB + from_euler(roll, pitch, yaw) @ lever


def unit_velocity(motion: Motion, lever: Any) -> Any:
    """Return the velocity (3,) in W of an ultrasonic unit, from its position `lever` (3,) in B."""
    roll, pitch, yaw = motion.attitude[0], motion.attitude[1], motion.attitude[2]
    return from_euler(roll, pitch, yaw) @ (motion.v_WB_B + jnp.cross(motion.w_WB_B, lever))


def distances(positions: Any, unit: Any) -> tuple[Any, Any]:
    """Return the distance (n,) (m) from each beacon (n, 3) to an ultrasonic unit (3,), and the angle (n,) (rad) between
    the beacon's axis and the direction to the unit."""
    line = unit - positions
    distance = jnp.sqrt(jnp.sum(line * line, axis=1))
    return distance, off_axis_angle(line[:, 2], distance)


def measured_range(positions: Any, unit: Any, cone_error: bool = True) -> Any:
    """Return noise-free ranges (n,) with the cone error: off a beacon's axis, ranges are too long. Source: [1] 5.5.4.

    Args:     positions: positions of the beacons (n, 3).    unit: position of the ultrasonic unit (3,), or one position
              for each beacon (n, 3).    cone_error: False for exact ranges.
    """
    if not cone_error:
        line = unit - positions
        return jnp.sqrt(jnp.sum(line * line, axis=1))
    distance, beta = distances(positions, unit)
    return distance / range_ratio(jnp.minimum(beta, math.pi / 2))


def audible_beacons(beacons: Beacons, positions: Any, unit: Any) -> Any:
    """Return a mask (n,) of the beacons at positions (n, 3) whose reach and cone contain the ultrasonic unit (3,)."""
    distance, beta = distances(positions, unit)
    return (distance <= beacons.reach) & (beta <= beacons.cone)


def actual_positions(beacons: Beacons, key: Key, t: Any) -> Any:
    """Return the true positions of the beacons (n, 3) at integer time t: map, plus survey errors and displacements by a
    fault."""

    def draw_survey_error(i: Any) -> Any:
        north, east = normal2(key, i, SURVEY)
        down, _ = normal2(key, i, SURVEY + 1)
        return jnp.stack([north, east, down])

    error = beacons.survey_error * lax.map(draw_survey_error, jnp.arange(np.shape(beacons.map)[0]))
    return jnp.asarray(beacons.map) + error + jnp.where(t >= beacons.fault_time, beacons.moved, 0.0)


def responding_beacons(beacons: Beacons, positions: Any, unit: Any, t: Any) -> Any:
    """Return a mask (n,) of the beacons that the ultrasonic unit can receive at integer time t and that no fault
    silences."""
    return audible_beacons(beacons, positions, unit) & ~(jnp.asarray(beacons.dead) & (t >= beacons.fault_time))


def corrupt_ranges(ranges: Any, key: Key, number: Any, errors: RangeErrors, medium: Medium, crystal: Any) -> Any:
    """Return measured ranges (n,) with errors by the speed of sound, timers, noise, stray ranges and echoes.

    Args:     ranges: error-free ranges (n,) (m).    number: number of the ping, an integer.
              crystal: standard deviation of the timers' relative errors.
    """
    n = ranges.shape[0]

    def draws(i: Any) -> Any:
        index = jnp.asarray(number) * n + i
        timer, _ = normal2(key, i, CRYSTAL)
        noise, _ = normal2(key, index, NOISE)
        return timer, noise, *uniform2(key, index, STRAY), *uniform2(key, index, ECHO)

    timer, noise, stray, size, echo, detour = lax.map(draws, jnp.arange(n))
    scale = speed_of_sound(medium.assumed) / speed_of_sound(medium.actual) * (1.0 + crystal * timer)
    error = errors.noise * noise
    error = error + jnp.where(stray < errors.stray_probability, errors.stray_size * (2.0 * size - 1.0), 0.0)
    error = error + jnp.where(echo < errors.echo_probability, errors.echo_size * detour, 0.0)
    return jnp.maximum(ranges * scale + error, 0.0)

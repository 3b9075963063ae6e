"""How the sensor that aids an inertial form with its place is read: positions, or whatever else tells of it.

Source: docs page, Measurement history.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.float64 import jnp
from trimtab.estimators.inertial.measurement_history import POSITION, RANGES, Correct
from trimtab.estimators.inertial.sensor_watch import WIDTH


class Aid(NamedTuple):
    """How the sensor that intake.position names is read.

    kind: of its events.  width: of its values.  numbers: of a sample's value.  correct: what they do to a node.
    """

    kind: int
    width: int
    numbers: Callable[[Any], tuple[Any, ...]]
    correct: Correct


def fixes(form: Any) -> Aid:
    """Positions, north and east, with their variance where they have one."""

    def correct(node: Any, value: Any) -> Any:
        return form.correct_position(node, value[:2], value[2])

    def numbers(value: Any) -> tuple[Any, ...]:
        return value.north, value.east, getattr(value, "variance", 0.0)

    return Aid(POSITION, WIDTH, numbers, correct)


def ranges(form: Any) -> Aid:
    """Ranges of a ping and its unit; what is not a positive number becomes -1, what did not arrive 0."""
    width = np.shape(form.beacons)[0] + 1

    def numbers(value: Any) -> tuple[Any, ...]:
        sound = jnp.isfinite(value.range) & (value.range > 0)
        ranges = jnp.where(value.arrived, jnp.where(sound, value.range, -1.0), 0.0)
        return (*ranges, value.unit)

    return Aid(RANGES, width, numbers, getattr(form, "correct_ranges", lambda node, value: node))

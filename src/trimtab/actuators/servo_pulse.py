"""Pulses of servos and speed controllers: which width stands for which value of a command."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, imperfection, quantity, record

SHORTEST, LONGEST = 0.8e-3, 2.2e-3
"""Of the pulses that servos and speed controllers take (s)."""


@record
class ServoPulse:
    """A servo, or a motor's speed controller, told by the width of pulses: a value becomes a pulse, and a value again.

        ServoPulse(values=(-0.44, 0.0, 0.44), widths=(2e-3, 1.52e-3, 1e-3))     a servo whose horn is turned round

    A stage of an ActuatorBank, the first of its row: values beyond the table come out as its ends, those between as
    fine as a timer counts. Firmware sends the pulses by the same table (docs page, Servo pulses).

    Frames:  its field's.    Not modelled: that a servo hears of a pulse once a frame only: a ServoFrame does.
    Source:  the pulses of radio control: 1.5 ms in the middle, half a millisecond to either end.
    """

    values: Any = quantity("1", "Values, rising, in the field's unit (n,).", default=np.array([-1.0, 1.0]))
    widths: Any = quantity(
        "s", "Width of the pulse at each (n,), rising or falling.", default=np.array([1e-3, 2e-3]), low=0
    )
    resolution: Scalar = imperfection("s", "Step of the widths.", "pulse-steps", default=0.5e-6)

    def check(self) -> None:
        """Refuse tables that can't be read in both directions, and pulses that nothing takes."""
        values, widths = np.asarray(self.values, float), np.asarray(self.widths, float)
        if values.ndim != 1 or np.size(values) < 2 or values.shape != widths.shape:
            problem = f"there are values of shape {values.shape} and widths of shape {widths.shape}"
            raise InputError("values", problem, fix="give as many widths as values, two at least")
        if not (np.diff(values) > 0).all():
            raise InputError("values", f"{values.tolist()} do not rise", fix="order the table by its values")
        steps = np.diff(widths)
        if not ((steps > 0).all() or (steps < 0).all()):
            problem = f"{widths.tolist()} neither rise nor fall"
            raise InputError("widths", problem, fix="no two values of a servo can have one pulse")
        if widths.min() < SHORTEST or widths.max() > LONGEST:
            problem = f"{widths.min() * 1e3:g} to {widths.max() * 1e3:g} ms"
            raise InputError("widths", problem, fix=f"keep to {SHORTEST * 1e3:g} to {LONGEST * 1e3:g} ms, in seconds")

    def width(self, value: Any) -> Any:
        """Of the pulse (s) for a value."""
        return _read_table(self.values, self.widths, value)

    def value(self, width: Any) -> Any:
        """What a pulse of a width (s) stands for."""
        return _read_table(self.widths, self.values, width)

    def init(self, rest: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: tuple[()], value: Any, dt: Any) -> tuple[tuple[()], StageOutput]:
        """What the pulse for a value stands for."""
        values = jnp.asarray(self.values)
        limited = jnp.any((value < values[0]) | (value > values[-1]))
        fine = self.resolution > 0
        step = jnp.where(fine, self.resolution, 1.0)
        width = self.width(value)
        return state, StageOutput(self.value(jnp.where(fine, jnp.round(width / step) * step, width)), limited)


def linear_pulse(low: Any, high: Any) -> ServoPulse:
    """From 1 ms for the least value to 2 ms for the greatest."""
    return ServoPulse(values=np.array([float(low), float(high)]))


def _read_table(x: Any, y: Any, at: Any) -> Any:
    """y at a place among the points x, which rise or fall: linear between them, beyond them the ends."""
    x, y = jnp.asarray(x), jnp.asarray(y)
    share = jnp.clip((jnp.asarray(at)[..., None] - x[:-1]) / (x[1:] - x[:-1]), 0.0, 1.0)
    return y[0] + jnp.sum(share * (y[1:] - y[:-1]), axis=-1)

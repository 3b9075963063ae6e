"""Pulses of servos and speed controllers: conversion between the values of a command and pulse widths."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, imperfection, quantity, record

SHORTEST, LONGEST = 0.8e-3, 2.2e-3
"""Limits of the pulse widths that servos and speed controllers accept (s)."""


@record
class ServoPulse:
    """Pulse of a servo or of a motor's speed controller: a value is converted to a pulse width and back.

        ServoPulse(values=(-0.44, 0.0, 0.44), widths=(2e-3, 1.52e-3, 1e-3))     a servo with a reversed horn

    Use it as the first stage of a field in an ActuatorBank. Values beyond the table are limited to its ends. Pulse
    widths are rounded to the timer's resolution. The firmware uses the same table (docs page, Servo pulses).

    Frames:  those of the actuated value.    Not modelled: the frame in which pulses are sent; use a ServoFrame for it.
    Source:  pulses of radio control servos: 1.5 ms in the middle, 1 and 2 ms at the ends.
    """

    values: Any = quantity(
        "1",
        "Values of the table in increasing order (n,), in the unit of the actuated value.",
        default=np.array([-1.0, 1.0]),
    )
    widths: Any = quantity(
        "s",
        "Pulse width at each value of the table (n,), strictly monotonic.",
        default=np.array([1e-3, 2e-3]),
        low=0,
    )
    resolution: Scalar = imperfection("s", "Resolution of the pulse width.", "pulse-steps", default=0.5e-6)

    def check(self) -> None:
        """Raise InputError for tables that can't be inverted, and pulses outside the limits."""
        values, widths = np.asarray(self.values, float), np.asarray(self.widths, float)
        if values.ndim != 1 or np.size(values) < 2 or values.shape != widths.shape:
            problem = (
                f"values and widths must have equal lengths of at least 2, got shapes {values.shape} and {widths.shape}"
            )
            raise InputError("values", problem, fix="give as many widths as values, at least two")
        if not (np.diff(values) > 0).all():
            raise InputError(
                "values", f"values must increase, got {values.tolist()}", fix="sort the table by increasing values"
            )
        steps = np.diff(widths)
        if not ((steps > 0).all() or (steps < 0).all()):
            problem = f"widths must be strictly monotonic, got {widths.tolist()}"
            raise InputError("widths", problem, fix="give widths that only increase or only decrease")
        if widths.min() < SHORTEST or widths.max() > LONGEST:
            problem = (
                f"pulse widths of {widths.min() * 1e3:g} to {widths.max() * 1e3:g} ms are outside the accepted range"
            )
            raise InputError(
                "widths", problem, fix=f"give widths from {SHORTEST * 1e3:g} to {LONGEST * 1e3:g} ms, in seconds"
            )

    def width(self, value: Any) -> Any:
        """Return the pulse width (s) for a value."""
        return _read_table(self.values, self.widths, value)

    def value(self, width: Any) -> Any:
        """Return the value for a pulse width (s)."""
        return _read_table(self.widths, self.values, width)

    def init(self, rest: Any) -> tuple[()]:
        """Return an empty record, because this stage has no state."""
        return ()

    def step(self, state: tuple[()], value: Any, dt: Any) -> tuple[tuple[()], StageOutput]:
        """Return the value after conversion to a pulse and back."""
        values = jnp.asarray(self.values)
        limited = jnp.any((value < values[0]) | (value > values[-1]))
        fine = self.resolution > 0
        step = jnp.where(fine, self.resolution, 1.0)
        width = self.width(value)
        return state, StageOutput(self.value(jnp.where(fine, jnp.round(width / step) * step, width)), limited)


def linear_pulse(low: Any, high: Any) -> ServoPulse:
    """Return a linear pulse table from 1 ms at the smallest value to 2 ms at the largest value."""
    return ServoPulse(values=np.array([float(low), float(high)]))


def _read_table(x: Any, y: Any, at: Any) -> Any:
    """Return y at x = `at`, interpolated linearly, constant beyond the ends of x. x must be strictly monotonic."""
    x, y = jnp.asarray(x), jnp.asarray(y)
    share = jnp.clip((jnp.asarray(at)[..., None] - x[:-1]) / (x[1:] - x[:-1]), 0.0, 1.0)
    return y[0] + jnp.sum(share * (y[1:] - y[:-1]), axis=-1)

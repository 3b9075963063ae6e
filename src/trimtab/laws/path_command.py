"""Command of altitude and speed: filtered steps, which are smooth enough for the inversion."""

import math
from typing import Any

import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record


@record
class PathPoint:
    """Commanded altitude and speed at one instant, with the derivatives that an inversion needs. Source: [1] eq. 5."""

    h: Scalar = quantity("ft", "Commanded altitude.", frame="W")
    h_rate: Scalar = quantity("ft/s", "Rate of the commanded altitude.", frame="W")
    h_acceleration: Scalar = quantity("ft/s^2", "Second time derivative of the commanded altitude.", frame="W")
    h_jerk: Scalar = quantity("ft/s^3", "Third time derivative of the commanded altitude.", frame="W")
    V: Scalar = quantity("ft/s", "Commanded speed along the path.")
    V_rate: Scalar = quantity("ft/s^2", "Rate of the commanded speed.")
    V_acceleration: Scalar = quantity("ft/s^3", "Second time derivative of the commanded speed.")


@record
class FilteredClimb:
    """Step of altitude and step of speed, each smoothed by a critically damped filter with equal poles.

        h_d = h0 + dh / (s/wh + 1)^4          V_d = V0 + dV / (s/wV + 1)^3          both steps at `start`

    The response is known in closed form at any time, including future times. With a = w (t - start) it is

        1 - e^-a (1 + a + … + a^(n-1)/(n-1)!)

    With these orders h'' and V' are continuous, so the inputs of the inversion have no jump.

    Source: our own choice of filters (docs page). [1] "Angular-accelerometer-based flexible-state estimation and
            tracking controller design for hypersonic flight vehicle", Aerospace 2022, 9(4), 206, does not print its
            filters.
    """

    h0: Scalar = quantity("ft", "Altitude before the step.", default=85000.0)
    V0: Scalar = quantity("ft/s", "Speed before the step.", default=7702.0808, above=0)
    dh: Scalar = quantity("ft", "Size of the altitude step.", default=0.0)
    dV: Scalar = quantity("ft/s", "Size of the speed step.", default=0.0)
    wh: Scalar = quantity("rad/s", "Bandwidth wh of the altitude filter.", default=0.06, above=0, source="chosen")
    wV: Scalar = quantity("rad/s", "Bandwidth wV of the speed filter.", default=0.06, above=0, source="chosen")
    start: Scalar = quantity("s", "Time of the altitude step and the speed step.", default=5.0, low=0, source="chosen")

    def check(self) -> None:
        """Raise InputError if the final speed is zero or below."""
        end = float(self.V0) + float(self.dV)
        if end <= 0:
            problem = f"the final speed V0 + dV must be above 0, got {end:g} ft/s"
            raise InputError("FilteredClimb.dV", problem, fix=f"set dV above {-float(self.V0):g} ft/s")

    def at(self, t: Any) -> PathPoint:
        """Return the command at time t (s)."""
        since = jnp.maximum(t - self.start, 0.0)
        h = filtered_step(since * self.wh, 4)
        V = filtered_step(since * self.wV, 3)
        return PathPoint(
            h=self.h0 + self.dh * h[0],
            h_rate=self.dh * self.wh * h[1],
            h_acceleration=self.dh * self.wh**2 * h[2],
            h_jerk=self.dh * self.wh**3 * h[3],
            V=self.V0 + self.dV * V[0],
            V_rate=self.dV * self.wV * V[1],
            V_acceleration=self.dV * self.wV**2 * V[2],
        )


def filtered_step(a: Any, order: int) -> list[Any]:
    """Return the step response of (s + 1)^-order at a time a >= 0, and its derivatives up to the (order - 1)-th.

    The k-th derivative is e^-a times a polynomial: each differentiation of a^j/j! e^-a gives a^(j-1)/(j-1)! - a^j/j!.
    """
    powers = [a**j / math.factorial(j) for j in range(order)]
    fading = jnp.exp(-a)
    values, weights = [1.0 - fading * sum(powers)], [0.0] * (order - 1) + [1.0]
    for _ in range(1, order):
        values.append(fading * sum(w * p for w, p in zip(weights, powers, strict=True) if w))
        weights = [(weights[j + 1] if j + 1 < order else 0.0) - weights[j] for j in range(order)]
    return values

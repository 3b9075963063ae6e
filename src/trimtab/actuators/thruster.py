"""Thrust of a fan as a function of its speed and the rudder angle, and the inverse function.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record
from trimtab.core.rotation import DEG

NEWTON_STEPS = 5
"""Number of Newton steps that invert the reverse thrust down to the rounding error. A test checks this number."""


@record
class Thruster:
    """Thrust of a reversible fan with a rudder behind it.

        F(n, theta) = c n |n| ratio(n) eta(theta),  n in krpm, signed      [1, chapter 4]
        ratio = 1 forward;  y(|n|) = y3 n^3 + y2 n^2 + y1 n + y0 in reverse    [1, eq. 4.4]
        eta = cos(theta - offset)

    F is the thrust, n the fan speed and theta the rudder angle. The ratio is constant outside the measured speeds (6 to
    12 krpm), because the cubic is negative below 4.17 krpm and exceeds 1 far above. eta is constant beyond
    `deflection_max`. The map is therefore defined and invertible for any demand, also in runs without saturation.

    Valid:   at rest.    Not modelled: inflow, battery sag, motor (see `time_constant`).
    Source:  [1] chapter 4, eq. 4.4; c and eta are reconstructed (quadratic law, 3000 rpm just registering on a gauge
             with 0.1 N divisions, thrust falling with rudder angle): docs page, Errata.
    """

    coefficient: Scalar = quantity(
        "N/krpm^2", "Coefficient of the thrust: thrust divided by speed squared.", default=1.6 / 144, above=0
    )
    reverse_ratio: Any = quantity(
        "1",
        "Polynomial coefficients of the ratio of reverse to forward thrust, highest power first, speed in krpm.",
        default=np.array([9.734e-4, -3.277e-2, 3.833e-1, -1.099]),
        shape=(4,),
        source="[1] eq. 4.4",
    )
    reverse_low_rpm: Scalar = quantity(
        "rpm", "Lowest fan speed at which the ratio of reverse to forward thrust was measured.", default=6000.0, above=0
    )
    speed_max_rpm: Scalar = quantity(
        "rpm", "Maximum fan speed under load.", default=12000.0, above=0, source="[1] ch. 4"
    )
    offset: Scalar = quantity(
        "rad", "Rudder angle at which the fan's thrust is largest.", default=0.566 * DEG, source="[1] eq. 4.3"
    )
    deflection_max: Scalar = quantity(
        "rad",
        "Rudder deflection beyond which the thrust factor eta is constant.",
        default=40 * DEG,
        above=0,
        high=80 * DEG,
        source="[1] fig. 4.2",
    )
    time_constant: Scalar = quantity(
        "s",
        "Time constant of the lag from the commanded speed to the fan speed; 0: no lag, as in Kulis (2006).",
        default=0.0,
        low=0,
    )

    def check(self) -> None:
        """Raise InputError unless the reverse thrust is positive and rises with speed, so that it has an inverse."""
        low, high = float(self.reverse_low_rpm), float(self.speed_max_rpm)
        if not low < high:
            problem = f"the lowest measured speed of {low:g} rpm must be below speed_max_rpm, {high:g} rpm"
            raise InputError("reverse_low_rpm", problem, fix="set the lowest measured speed below speed_max_rpm")
        n = np.linspace(low, high, 200) / 1000
        thrust = n**2 * np.polyval(np.asarray(self.reverse_ratio), n)
        if thrust[0] <= 0 or (np.diff(thrust) <= 0).any():
            problem = f"reverse thrust must be positive and rise with speed from {low:g} to {high:g} rpm"
            raise InputError(
                "reverse_ratio",
                problem,
                fix="fit reverse_ratio again, only to speeds at which reverse thrust is measurable",
            )

    def eta(self, rudder_angle: Any) -> Any:
        """Return the fraction eta of the thrust that remains with the rudder at theta (rad)."""
        xp = _namespace(self, rudder_angle)
        return xp.cos(xp.clip(rudder_angle - self.offset, -self.deflection_max, self.deflection_max))

    def ratio(self, speed_rpm: Any) -> Any:
        """Return the ratio y of reverse to forward thrust at an unsigned speed (rpm)."""
        xp = _namespace(self, speed_rpm)
        return self._cubic(xp.clip(speed_rpm, self.reverse_low_rpm, self.speed_max_rpm) * 1e-3)

    def force(self, speed_rpm: Any, rudder_angle: Any) -> Any:
        """Return the signed thrust (N) at a signed speed (rpm) with the rudder at theta (rad)."""
        xp = _namespace(self, speed_rpm, rudder_angle)
        n = speed_rpm * 1e-3
        ratio = xp.where(n < 0, self.ratio(abs(speed_rpm)), 1.0)
        return self.coefficient * n * abs(n) * ratio * self.eta(rudder_angle)

    def speed_rpm(self, force: Any, rudder_angle: Any) -> Any:
        """Return the signed speed (rpm) for a signed thrust (N) and rudder angle (rad): the inverse of `force`."""
        xp = _namespace(self, force, rudder_angle)
        q = abs(force) / (self.coefficient * self.eta(rudder_angle))
        root = xp.where(q > 0, xp.sqrt(xp.where(q > 0, q, 1.0)), 0.0)
        return 1e3 * xp.where(force < 0, -self._reverse_speed(xp, q, root), root)

    def follow_speed(self, speed_rpm: Any, rpm_command: Any, dt: Any) -> Any:
        """Return the speed (rpm) after a first-order lag for dt (s), or the commanded speed if the time constant is
        0."""
        share = -jnp.expm1(-dt / jnp.maximum(self.time_constant, 1e-9))
        return speed_rpm + share * (rpm_command - speed_rpm)

    def _cubic(self, n: Any) -> Any:
        y = self.reverse_ratio
        return ((y[0] * n + y[1]) * n + y[2]) * n + y[3]

    def _reverse_speed(self, xp: Any, q: Any, root: Any) -> Any:
        """Return the speed n (krpm) that solves n^2 ratio(n) = q.

        Where the ratio is constant, n is a square root. Elsewhere Newton's method is used.
        """
        y = self.reverse_ratio
        low, high = self.reverse_low_rpm * 1e-3, self.speed_max_rpm * 1e-3
        root_low, root_high = low * xp.sqrt(self._cubic(low)), high * xp.sqrt(self._cubic(high))
        inside = xp.clip(root, root_low, root_high)
        n = low + (inside - root_low) * (high - low) / (root_high - root_low)
        for _ in range(NEWTON_STEPS):
            slope = (((5 * y[0] * n + 4 * y[1]) * n + 3 * y[2]) * n + 2 * y[3]) * n
            n = xp.clip(n - (n * n * self._cubic(n) - inside * inside) / slope, low, high)
        outside = root * xp.where(root < root_low, low / root_low, high / root_high)
        return xp.where((root < root_low) | (root > root_high), outside, n)


def _namespace(*values: Any) -> Any:
    """Return jax.numpy if any value is a JAX array, else numpy, so that tables can be built without starting JAX."""
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)) else np

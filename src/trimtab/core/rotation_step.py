"""Integration steps on the rotation group: a quaternion is updated by rotations, so that its length stays one.

Source: [1] Hairer, Lubich, Wanner, "Geometric numerical integration", 2nd ed., Springer 2006, section IV.8: methods of
Munthe-Kaas. [2] Bortz, "A new mathematical formulation for strapdown inertial navigation", IEEE T-AES 7 (1971).
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.integrate import Derivative, Step
from trimtab.core.record import replace

SERIES = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600)
"""Coefficients of the power series of (1 - a/2 cot(a/2))/a^2 in a^2. The error is 1e-10 at a rotation a of 0.5 rad per
step. Source: [1] eq. III.4.10."""


def rotation_step(step: Step, names: Sequence[str]) -> Step:
    """Return a step that integrates the fields `names` of the state, quaternions q_WB (4,), by rotations instead of
    sums.

    Within a step q = q0 exp(v), and v (3,) obeys Bortz's equation v' = w + v × w/2 + …, with the angular velocity w
    computed from the derivative of q. Other parts of that derivative, such as a term that corrects the length, are
    ignored. The order of the integration method does not change: RK4 becomes Munthe-Kaas's method of order four. The
    returned error estimate is the error of q.
    """

    def turn(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
        def state(y: Any) -> Any:
            return replace(y, **{n: quaternion.retract(getattr(x, n), getattr(y, n)) for n in names})

        def rate(time: Any, y: Any) -> Any:
            at = state(y)
            dx = f(time, at)
            return replace(dx, **{n: _turn_rate(getattr(y, n), getattr(at, n), getattr(dx, n)) for n in names})

        y0 = replace(x, **{n: jnp.zeros(3) for n in names})
        y1, error = step(rate, t, y0, h)
        x1 = state(y1)
        errors = {n: quaternion.rate(getattr(x1, n), getattr(error, n)) for n in names}
        return x1, replace(error, **errors)

    return turn


def _turn_rate(v: Any, q: Any, dq: Any) -> Any:
    """Return v' (3,) for q = q0 exp(v), given the derivative dq of q."""
    w = 2 * quaternion.multiply(quaternion.conjugate(q), jnp.asarray(dq))[1:] / (q @ q)
    a2, c = v @ v, jnp.zeros(())
    for term in reversed(SERIES):
        c = term + a2 * c
    across = jnp.cross(v, w)
    return w + across / 2 + c * jnp.cross(v, across)

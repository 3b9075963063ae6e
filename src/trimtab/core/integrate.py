"""Integration of the truth between two instants."""

from collections.abc import Callable
from typing import TypeVar

import jax

from trimtab.core.record import Scalar

X = TypeVar("X")


def rk4(f: Callable[[Scalar, X], X], t: Scalar, x: X, h: Scalar) -> X:
    """One classical Runge–Kutta step of x' = f(t, x) from t to t + h; x is any pytree of floats.

    Args:
        f: derivative, same structure as x.
        t: time (s).
        h: step (s); 0 gives x back.

    Source: Hairer, Nørsett, Wanner, "Solving ordinary differential equations I", table 1.2.
    """

    def ahead(k: X, by: Scalar) -> X:
        return jax.tree.map(lambda a, d: a + by * d, x, k)

    k1 = f(t, x)
    k2 = f(t + h / 2, ahead(k1, h / 2))
    k3 = f(t + h / 2, ahead(k2, h / 2))
    k4 = f(t + h, ahead(k3, h))
    return jax.tree.map(lambda a, b, c, d, e: a + h / 6 * (b + 2 * c + 2 * d + e), x, k1, k2, k3, k4)

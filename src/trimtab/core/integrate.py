"""Integration of the true state between two instants: explicit steps with error estimates.

A step is a function (f, t, x, h) -> (x at t + h, estimate of its error), where x may be any pytree of floats.

Source: [1] Hairer, Nørsett, Wanner, "Solving ordinary differential equations I", Springer 1993.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from trimtab.core.record import Scalar

X = TypeVar("X")
Derivative = Callable[[Any, Any], Any]
Step = Callable[[Derivative, Any, Any, Any], tuple[Any, Any]]

C = (1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0)
A = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
)
WEIGHTS = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
ERROR_WEIGHTS = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
"""Weights of the error: result of order five minus result of order four. Source: [1] table 5.2."""
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
"""Safety factor, and smallest and largest ratio of the next step size to the present one. Source: [1] eq. 4.13."""


def rk4(f: Callable[[Scalar, X], X], t: Scalar, x: X, h: Scalar) -> X:
    """Return x after one classical Runge–Kutta step of x' = f(t, x) from t to t + h; x is any pytree of floats.

    Args:
        f: derivative, same structure as x.
        t: time (s).
        h: step (s); a step of 0 returns x.

    Source: Hairer, Nørsett, Wanner, "Solving ordinary differential equations I", table 1.2.
    """
    return _rk4_stages(f, t, x, h)[0]


def rk4_with_error(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
    """Return the result of `rk4`, bit for bit, and its difference from an embedded formula of order three.

    The difference is h/10 (f(t + h, x1) - k4). The embedded formula moves a tenth of k4's weight to the derivative at
    the end of the step, which still satisfies the conditions of order three [1, theorem 2.1]. The difference is larger
    than the error of the step.
    """
    x1, k4 = _rk4_stages(f, t, x, h)
    return x1, jax.tree.map(lambda a, b: h / 10 * (a - b), f(t + h, x1), k4)


def rk4_with_doubling(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
    """Return the result of `rk4`, bit for bit, and its error estimated by two steps of half the length.

    The estimate is 16/15 of the difference between the two results. For small steps it equals the error, which is
    proportional to h^5. The estimate by an embedded formula would be larger: it is proportional to h^4.
    Source: [1] section II.4.
    """
    x1 = rk4(f, t, x, h)
    finer = rk4(f, t + h / 2, rk4(f, t, x, h / 2), h / 2)
    return x1, jax.tree.map(lambda a, b: 16 / 15 * (b - a), x1, finer)


def _rk4_stages(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
    def ahead(k: Any, by: Any) -> Any:
        return jax.tree.map(lambda a, d: a + by * d, x, k)

    k1 = f(t, x)
    k2 = f(t + h / 2, ahead(k1, h / 2))
    k3 = f(t + h / 2, ahead(k2, h / 2))
    k4 = f(t + h, ahead(k3, h))
    return jax.tree.map(lambda a, b, c, d, e: a + h / 6 * (b + 2 * c + 2 * d + e), x, k1, k2, k3, k4), k4


def dormand_prince(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
    """Return x after a step of order five, and its difference from the embedded result of order four. Source: [1] table
    5.2."""

    def combine(weights: tuple[float, ...], ks: list[Any]) -> Any:
        terms = [(w, k) for w, k in zip(weights, ks, strict=True) if w]
        return jax.tree.map(lambda *d: sum(w * v for (w, _), v in zip(terms, d, strict=True)), *[k for _, k in terms])

    ks = [f(t, x)]
    for c, row in zip(C, A, strict=True):
        ks.append(f(t + c * h, jax.tree.map(lambda a, d: a + h * d, x, combine(row, ks))))
    x1 = jax.tree.map(lambda a, d: a + h * d, x, combine(WEIGHTS, ks))
    ks.append(f(t + h, x1))
    return x1, jax.tree.map(lambda d: h * d, combine(ERROR_WEIGHTS, ks))


def error_ratio(error: Any, x: Any, x1: Any, relative: Any, absolute: Any) -> Any:
    """Return the largest |error| / (absolute + relative max(|x|, |x1|)) of all elements; infinite if an error is NaN.

    x, x1: state before and after a step.  error: estimated error, with the same structure as the state.
    """
    worst = jnp.zeros(())
    for e, a, b in zip(*map(jax.tree.leaves, (error, x, x1)), strict=True):
        allowed = absolute + relative * jnp.maximum(jnp.abs(a), jnp.abs(b))
        worst = jnp.maximum(worst, jnp.max(jnp.where(jnp.isfinite(e), jnp.abs(e) / allowed, jnp.inf)))
    return worst


def next_step(h: Any, ratio: Any, order: int) -> Any:
    """Return the size of the next step after a step h. ratio: error divided by tolerance. Source: [1] eq. 4.13."""
    bounded = jnp.clip(ratio, 1e-12, 1e12)  # an infinite ratio, from a NaN, gives the smallest step
    return h * jnp.clip(SAFETY * jnp.exp(-jnp.log(bounded) / order), SHRINK, GROW)

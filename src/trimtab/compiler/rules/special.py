"""Rules for special functions: JAX's own programs where it has them, which are what it computes itself."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.special
from jax import lax
from numpy.polynomial import chebyshev

from trimtab.compiler import jaxprs
from trimtab.compiler.lower import Rule
from trimtab.compiler.rules.composite import composite

BERNOULLI = (1 / 6, -1 / 30, 1 / 42, -1 / 30, 5 / 66, -691 / 2730, 7 / 6, -3617 / 510, 43867 / 798, -174611 / 330)
BERNOULLI += (854513 / 138, -236364091 / 2730)
"""B2, B4, .. B24."""
EXPLICIT = 10
"""Terms of the zeta function that are added one by one."""


def _zeta(s: Any, a: Any, **_: Any) -> Any:
    """Hurwitz's: Euler and Maclaurin's sum for s > 1 and a > 0."""
    s, a = jnp.broadcast_arrays(s, a)
    total = a ** (-s)
    for i in range(1, EXPLICIT):
        total = total + (a + i) ** (-s)
    end = a + EXPLICIT
    power = end ** (-s)
    total = total + power * end / (s - 1) + 0.5 * power
    factor, power = s, power / end
    for k, bernoulli in enumerate(BERNOULLI, 1):
        total = total + bernoulli / math.factorial(2 * k) * factor * power
        factor = factor * (s + (2 * k - 1)) * (s + 2 * k)
        power = power / (end * end)
    # at whole a <= 0 a term is infinite; for a < 0 it is real only where s is even
    below = jnp.where(a == jnp.floor(a), jnp.inf, jnp.where(s == jnp.floor(s), total, jnp.nan))
    found = jnp.where(a <= 0, below, total)
    return jnp.where(s > 1, found, jnp.where(s == 1, jnp.inf, jnp.nan))


def _polygamma(n: Any, x: Any, **_: Any) -> Any:
    sign = jnp.where(n % 2 == 0, -1.0, 1.0).astype(x.dtype)
    higher = sign * jnp.exp(lax.lgamma(n + 1)) * _zeta(n + 1, x)
    return jnp.where(n == 0, lax.digamma(x), jnp.where((n < 0) | (n != jnp.floor(n)), jnp.nan, higher))


I1E_NEAR = chebyshev.chebinterpolate(lambda t: scipy.special.ive(1, 4 + 4 * t) * (1 + 0.25 / (1 + t)), 30)
"""Of exp(-x) I1(x) (1 + x) / x, for x up to 8."""
I1E_FAR = chebyshev.chebinterpolate(lambda t: scipy.special.ive(1, 16 / (t + 1)) * np.sqrt(16 / (t + 1)), 26)
"""Of exp(-x) I1(x) sqrt(x), in 16 / x - 1 from x = 8 on."""


def _bessel_i1e(x: Any, **_: Any) -> Any:
    a = jnp.abs(x)
    near, far = jnp.minimum(a, 8.0), jnp.maximum(a, 8.0)
    small = _chebyshev(near / 4 - 1, I1E_NEAR) * near / (1 + near)
    return jnp.sign(x) * jnp.where(a <= 8, small, _chebyshev(16 / far - 1, I1E_FAR) / jnp.sqrt(far))


def _chebyshev(t: Any, coefficients: Any) -> Any:
    """Clenshaw's sum."""
    one, two = jnp.zeros_like(t), jnp.zeros_like(t)
    for c in coefficients[:0:-1]:
        one, two = (2 * t) * one - two + float(c), one
    return t * one - two + float(coefficients[0])


def _own(name: str) -> Rule:
    """The rule that takes JAX's own program; numbers go along with arrays."""

    def program(*operands: Any, **_: Any) -> Any:
        return jaxprs.special_function(name)(*jnp.broadcast_arrays(*operands))

    return composite(program)


RULES: dict[str, Rule] = {name: _own(name) for name in jaxprs.SPECIAL_FUNCTIONS}
RULES |= {
    "bessel_i1e": composite(_bessel_i1e),
    "polygamma": composite(_polygamma),
    "random_gamma": composite(jaxprs.draw_gamma),
    "zeta": composite(_zeta),
}

"""Lowering rules for special functions. If JAX has its own program for a function, that program is lowered."""

import math
from typing import Any

import jax.numpy as jnp
from jax import lax

from trimtab.compiler import jaxprs
from trimtab.compiler.lower import Rule
from trimtab.compiler.rules.composite import composite

BERNOULLI = (1 / 6, -1 / 30, 1 / 42, -1 / 30, 5 / 66, -691 / 2730, 7 / 6, -3617 / 510, 43867 / 798, -174611 / 330)
BERNOULLI += (854513 / 138, -236364091 / 2730)
"""Bernoulli numbers B2, B4, .. B24."""
EXPLICIT = 10
"""Number of terms of the zeta function's series that are added one by one before the Euler-Maclaurin remainder."""


def _zeta(s: Any, a: Any, **_: Any) -> Any:
    """Return Hurwitz's zeta function zeta(s, a), by the Euler-Maclaurin formula for s > 1 and a > 0."""
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
    # at integer a <= 0 a term is infinite, its sign known only for even s; for a < 0 terms are real only for integer s
    pole = jnp.where(s % 2 == 0, jnp.inf, jnp.nan)
    below = jnp.where(a == jnp.floor(a), pole, jnp.where(s == jnp.floor(s), total, jnp.nan))
    found = jnp.where(a <= 0, below, total)
    return jnp.where(s > 1, found, jnp.where(s == 1, jnp.inf, jnp.nan))


def _polygamma(n: Any, x: Any, **_: Any) -> Any:
    sign = jnp.where(n % 2 == 0, -1.0, 1.0).astype(x.dtype)
    higher = sign * jnp.exp(lax.lgamma(n + 1)) * _zeta(n + 1, x)
    return jnp.where(n == 0, lax.digamma(x), jnp.where((n < 0) | (n != jnp.floor(n)), jnp.nan, higher))


_NEAR = """\
0.12629359322181682 -0.17641651835783406 0.1026436586898471 -0.05294598120809499 0.024726449030626516
-0.010564084894626197 0.004156422944312888 -0.0015135724506312532 0.0005122859561685758 -0.00016176081582589674
4.781565107550054e-05 -1.3273163656039436e-05 3.4702513081376785e-06 -8.568720264695455e-07 2.0032947535521353e-07
-4.445059128796328e-08 9.381537386495773e-09 -1.8872497517228294e-09 3.625590281552117e-10 -6.663489723502027e-11
1.1736186298890901e-11 -1.9839743977649436e-12 3.223793365945575e-13 -5.042185504727912e-14 7.600684294735408e-15
-1.1055969477353862e-15 1.5536319577362005e-16 -2.111421214358166e-17 2.7779141127610464e-18 -3.541581772542136e-19"""
_FAR = """\
0.38928811750914005 -0.009761097491361469 -0.00011058893876262371 -3.882564808877691e-06 -2.512236237870209e-07
-2.6314688468895196e-08 -3.835380385964237e-09 -5.589743462196584e-10 -1.8974958123505413e-11 3.2526035830154884e-11
1.4125807436613782e-11 2.0356285441470896e-12 -7.198551776245908e-13 -4.0835511110921974e-13 -2.1015418427726643e-14
4.272440016711951e-14 1.0420276984128802e-14 -3.8144030724370075e-15 -1.8803547755107825e-15 3.3082023109209285e-16
2.96262899764595e-16 -3.209525921993424e-17 -4.6503053684893586e-17 4.414348323071708e-18 7.517296310842105e-18
-9.314178867326884e-19 -1.242193275194891e-18 2.4142767194548486e-19 2.0269443840532852e-19"""
I1E_NEAR = [float(x) for x in _NEAR.split()]
"""Chebyshev coefficients of exp(-x) I1(x) / x as a function of x / 4 - 1, for x up to 8; computed with 40 digits."""
I1E_FAR = [float(x) for x in _FAR.split()]
"""Chebyshev coefficients of exp(-x) I1(x) sqrt(x) as a function of 16 / x - 1, for x from 8 on."""


def _bessel_i1e(x: Any, **_: Any) -> Any:
    a = jnp.abs(x)
    near, far = jnp.minimum(a, 8.0), jnp.maximum(a, 8.0)
    small = _chebyshev(near / 4 - 1, I1E_NEAR) * near
    return jnp.sign(x) * jnp.where(a <= 8, small, _chebyshev(16 / far - 1, I1E_FAR) / jnp.sqrt(far))


def _chebyshev(t: Any, coefficients: Any) -> Any:
    """Return the sum of a Chebyshev series at t, by Clenshaw's algorithm."""
    one, two = jnp.zeros_like(t), jnp.zeros_like(t)
    for c in coefficients[:0:-1]:
        one, two = (2 * t) * one - two + c, one
    return t * one - two + coefficients[0]


def _own(name: str) -> Rule:
    """Return the rule that runs JAX's own program number by number, so that loops end separately for each number."""

    def program(*operands: Any, **_: Any) -> Any:
        function, together = jaxprs.special_function(name), jnp.broadcast_arrays(*operands)
        if together[0].size == 1:
            return function(*together)
        flat = tuple(x.ravel() for x in together)
        return lax.map(lambda some: function(*some), flat).reshape(together[0].shape)

    return composite(program)


RULES: dict[str, Rule] = {name: _own(name) for name in jaxprs.SPECIAL_FUNCTIONS}
RULES |= {
    "bessel_i1e": composite(_bessel_i1e),
    "polygamma": composite(_polygamma),
    "random_gamma": composite(jaxprs.draw_gamma),
    "zeta": composite(_zeta),
}

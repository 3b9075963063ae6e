"""Robust terms with adapted bounds, added to a state feedback v = yd^(r) + K e, in a published and a corrected form."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, quantity, record

SIGNS = ("minus", "published", "off")
FORMS = ("smooth", "sign", "off")
SIZES = (100.0, 20.0, 20.0, 0.01, 0.02, 0.2, 2.0, 0.2, 2.0)
"""Typical tracking errors (h, h', V, alpha, Q, eta1, eta1', eta2, eta2') in ft, s, rad and (slug ft)^1/2."""


@record
class AdaptationState:
    """State of the adaptation: estimated bounds of the uncertainty. Source: [1] eq. 18."""

    rho0: Scalar = quantity(
        "ft/s^2", "Estimated part of the uncertainty bound that does not depend on the tracking error."
    )
    rho1: Scalar = quantity("ft/s^2", "Estimated increase of the uncertainty bound per scaled tracking error.")


class RobustTerms(NamedTuple):
    """Terms u_h and u_s (ft/s^2, each (2,)), and s = B'P e (2,) from which both are computed."""

    u_h: Any
    u_s: Any
    s: Any


@record
class AdaptiveRobust:
    """Robust terms: damping u_h and smoothed switching u_s with adapted bounds, where s = B'P e.

        u_h = -+ R^-1 s / (2 (1 + kappa))                        minus; published: plus
        u_s = -(rho0 + rho1 |e|) / (1 + kappa) s/(|s| + eps)      published: sgn(s), element by element
        rho0' = q0 (|s| - sigma rho0)                             published: sigma = 0
        rho1' = q1 (|e| |s| - sigma rho1)

    e is the tracking error, and |e| is the length of the error divided by `sizes`. Without the division the altitude
    would dominate. With the gain K = -R^-1 B'P of a linear quadratic regulator the published u_h halves the gain,
    because the sign of u_h is wrong. With the minus sign the total gain is 1.5 K. The published bounds only grow, and
    sgn chatters. In this law sgn is smoothed. The bounds leak, and are limited to `cap`.

    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206, eqs. 16-18, corrected (docs page, Adaptive robust terms). [1]
             prints none of the constants.
    """

    BP: Any = quantity("1", "Matrix B'P of the Lyapunov function e'Pe.", shape=(2, 9))
    R: Any = quantity("1", "Diagonal of the weight R of the input v.", default=(0.01, 0.04), shape=(2,), above=0)
    sizes: Any = quantity(
        "1",
        "Typical sizes of the tracking errors. The adaptation divides the errors by these sizes.",
        default=SIZES,
        shape=(9,),
        above=0,
    )
    damping: str = option("Sign of the damping term u_h: minus, published (plus) or off.", default="off", choices=SIGNS)
    switching: str = option("Form of the switching term u_s: smooth, sign or off.", default="off", choices=FORMS)
    kappa: Scalar = quantity("1", "Bound kappa of the relative uncertainty of the input gain.", default=0.0, low=0)
    q0: Scalar = quantity(
        "1", "Adaptation rate of rho0, the bound that does not depend on the error.", default=10.0, low=0
    )
    q1: Scalar = quantity("1", "Adaptation rate of rho1, the increase of the bound per error.", default=0.01, low=0)
    eps: Scalar = quantity(
        "1", "Width eps of the smoothed sign function, in the unit of s = B'P e.", default=0.01, above=0
    )
    sigma: Scalar = quantity("1/s", "Leak rate sigma of the adapted bounds rho0 and rho1.", default=0.0, low=0)
    cap: Scalar = quantity("ft/s^2", "Upper limit of the adapted bounds rho0 and rho1.", default=20.0, above=0)

    def check(self) -> None:
        """Raise InputError if kappa is 1 or more, because the sign of the effect of v is then unknown."""
        if float(np.max(self.kappa)) >= 1:
            raise InputError(
                "AdaptiveRobust.kappa", f"kappa must be below 1, got {self.kappa}", fix="give a bound below 1"
            )

    def init(self) -> AdaptationState:
        """Return the initial bounds, before any adaptation."""
        return AdaptationState(jnp.asarray(0.0), jnp.asarray(0.0))

    def terms(self, state: AdaptationState, e: Any) -> RobustTerms:
        """Return u_h and u_s for the error e (9,)."""
        s = jnp.asarray(self.BP) @ e
        u_h = {"minus": -0.5, "published": 0.5, "off": 0.0}[self.damping] * s / jnp.asarray(self.R) / (1 + self.kappa)
        bound = (state.rho0 + state.rho1 * self._size(e)) / (1 + self.kappa)
        if self.switching == "sign":
            u_s = -bound * jnp.sign(s)
        elif self.switching == "smooth":
            u_s = -bound * s / (jnp.sqrt(jnp.sum(s * s)) + self.eps)
        else:
            u_s = jnp.zeros(2)
        return RobustTerms(u_h, u_s, s)

    def adapt(self, dt: Any, state: AdaptationState, e: Any, s: Any) -> AdaptationState:
        """Return the bounds after a step dt (s). The bounds stay constant while the switching term u_s is off."""
        if self.switching == "off":
            return state
        size = jnp.sqrt(jnp.sum(s * s))
        rho0 = state.rho0 + dt * self.q0 * (size - self.sigma * state.rho0)
        rho1 = state.rho1 + dt * self.q1 * (self._size(e) * size - self.sigma * state.rho1)
        return AdaptationState(jnp.clip(rho0, 0.0, self.cap), jnp.clip(rho1, 0.0, self.cap))

    def _size(self, e: Any) -> Any:
        sized = e / jnp.asarray(self.sizes)
        return jnp.sqrt(jnp.sum(sized * sized))

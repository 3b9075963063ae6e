"""Gain, filter and certificate of the hypersonic vehicle, from its own trim; and, over a grid of the envelope, whether
the inversion is well-posed and how wrong its gains can be.

Errors e = (h, h', V, alpha, Q, eta1, eta1', eta2, eta2') less the desired ones; v = (h'', V').

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, assumption 1 for the envelope. Its weights are not printed; those here are chosen.
"""

import itertools
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.core.rotation import DEG
from trimtab.design.certificate import METHODS, Certificate, RecordedNumber, build_certificate
from trimtab.design.linearise import LinearModel
from trimtab.design.lmi import LmiGain, lmi_gain
from trimtab.design.lqr import KalmanBucy, Lqr, augment_integrals, kalman_bucy, lqr
from trimtab.design.normal_form import linear_normal_form
from trimtab.design.trim import Trim
from trimtab.laws.adaptive_robust import SIZES
from trimtab.laws.path_inversion import InputLimits, invert_path
from trimtab.scenarios.hypersonic._internal import design_model, find_trim
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

H, V = 85000.0, 7702.0808
"""Altitude (ft) and speed (ft/s) of the linearisation, [1] table 1."""
INTERNAL = ("alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
MODES = INTERNAL[2:]
INTEGRALS = ("integral of h", "integral of V")
SCALE = np.array(SIZES)
"""Sizes of the errors in which equations are solved."""
ALLOWED = np.array([100.0, 20.0, 10.0, 0.05, 0.1, 1e3, 1e3, 1e3, 1e3])
"""Errors that weigh 1: Q_e = diag(1/ALLOWED^2)."""
ALLOWED_INPUT = np.array([10.0, 5.0])
"""Accelerations (ft/s^2) that weigh 1: R_e = diag(1/ALLOWED_INPUT^2)."""
ALLOWED_INTEGRALS = np.array([1000.0, 100.0])
"""Integrals of the errors of h (ft s) and V (ft) that weigh 1."""
STRICT_FACTOR = 1.01
"""The regulator's weight Q in parts of the Q_e that is certified for it, which makes (14) strict."""
FILTERS = {
    "tuned": ((1e-5, 100.0, 1e-5, 100.0), 5e-7),
    "accurate": ((1e-5, 1e-5, 1e-5, 1e-5), 5e-7),
    "printed": ((1e-5, 1e-5, 1e-5, 1e-5), 10.0),
}
"""Name -> diagonal of Q_eta, and R_eta (rad^2/s^3): as flown; for an exact model; as printed in [1]."""
NOMINAL = Hypersonic()
GRID = tuple(
    itertools.product(
        (80e3, 85e3, 90e3, 95e3),
        (7e3, 7.5e3, 8e3, 8.5e3, 9e3),
        tuple(a * DEG for a in (0.0, 1.0, 2.0, 3.0, 4.0)),
        (-DEG, 0.0, DEG),
        tuple(d * DEG for d in (-20.0, -10.0, 0.0, 10.0, 20.0, 25.8)),
    )
)
"""h (ft), V (ft/s), alpha, gamma, delta_e (rad)."""
GRID_DESCRIPTION = (
    f"{len(GRID)} points of the envelope: 80-95 kft, 7-9 kft/s, alpha 0-4, gamma +-1, elevator -20 to 25.8 deg"
)
WANTED_ACCELERATIONS = (2.0, -2.0)
"""Accelerations h'', V' (ft/s^2) that the inversion is asked for."""


def certificate(
    craft: Hypersonic = NOMINAL,
    *,
    method: str = "lqr",
    integral: bool = False,
    filter: str = "tuned",
    plant: Hypersonic | None = None,
    h: float = H,
    V: float = V,
) -> Certificate:
    """Gain, filter and all that proves them; prove it with `certificate_check.prove_certificate`.

    Args:
        craft: the vehicle the law believes in.
        method: "lqr" or "lmi".
        integral: with integral action.
        filter: "tuned", "accurate" or "printed".
        plant: the vehicle that flies, for kappa_G; the same where not given.
        h: altitude (ft).
        V: speed (ft/s).
    """
    linear, level = error_model(craft, h, V)
    gain = feedback_gain(linear, method=method, integral=integral)
    Qe, Re, scale = weights(integral=integral)
    Qe = Qe / STRICT_FACTOR if method == "lqr" else Qe
    about = {"method": method, "integral": str(integral).lower(), "filter": filter, "kmode": craft.modes.kmode}
    trimmed = dict(zip(("alpha_rad", "Phi", "delta_e_rad"), (level.x[2], *level.u), strict=True))
    return build_certificate(
        "hypersonic",
        error_matrices(linear, integral=integral),
        (gain.K, gain.P),
        (Qe, Re),
        states=(*linear.states, *INTEGRALS) if integral else linear.states,
        inputs=linear.inputs,
        method=method,
        Q=STRICT_FACTOR * Qe if method == "lqr" else None,
        scale=scale,
        observer=(MODES, *mode_filter(linear, filter)),
        recorded=recorded_numbers(craft, craft if plant is None else plant),
        about=about | {"h_ft": h, "V_ft_per_s": V} | {n: float(v) for n, v in trimmed.items()},
    )


def recompute_matrices(written: Certificate) -> tuple[Any, Any]:
    """A and B of the system that a certificate speaks of, computed anew for the vehicle as it is shipped."""
    place: list[float] = []
    for name in ("h_ft", "V_ft_per_s"):
        try:
            place.append(float(written.about[name]))
        except (KeyError, TypeError, ValueError):
            problem = f"about.{name} is {written.about.get(name)!r}, no number"
            fix = "trimtab design hypersonic --out FILE  makes it anew"
            raise InputError("certificate", problem, fix=fix) from None
    linear, _ = error_model(h=place[0], V=place[1])
    return error_matrices(linear, integral=written.about.get("integral") == "true")


@lru_cache(maxsize=8)
def error_model(craft: Hypersonic = NOMINAL, h: float = H, V: float = V) -> tuple[LinearModel, Trim]:
    """e' = A e + B v of the vehicle the law believes in, exactly linearised at level flight, and that flight's trim."""
    plant = design_model(craft, h, V)
    level = find_trim(plant, InputLimits(), "hypersonic trim")
    return linear_normal_form(plant, {"h": 2, "V": 1}, INTERNAL, level.x, level.u), level


def weights(*, integral: bool = False) -> tuple[Any, Any, Any]:
    """Q_e, R_e and the sizes of the errors; with the integrals of the errors of h and V after them, if wanted."""
    allowed = np.append(ALLOWED, ALLOWED_INTEGRALS) if integral else ALLOWED
    scale = np.append(SCALE, ALLOWED_INTEGRALS) if integral else SCALE
    return np.diag(allowed**-2.0), np.diag(ALLOWED_INPUT**-2.0), scale


def feedback_gain(
    linear: LinearModel, *, method: str = "lqr", integral: bool = False, strict: float = 1.0
) -> Lqr | LmiGain:
    """K (2, 9), or (2, 11) with integrals, of v = +K e; as it flies.

    Args:
        linear: of `error_model`.
        method: "lqr" or "lmi".
        integral: append the integrals of the errors of h and V.
        strict: the regulator's Q in parts of Q_e.
    """
    if method not in METHODS:
        raise InputError("method", f"{method!r}", choices=METHODS, fix="--method lqr")
    A, B = error_matrices(linear, integral=integral)
    Qe, Re, scale = weights(integral=integral)
    return lqr(A, B, strict * Qe, Re, scale=scale) if method == "lqr" else lmi_gain(A, B, Qe, Re, scale=scale)


def error_matrices(linear: LinearModel, *, integral: bool = False) -> tuple[Any, Any]:
    """A and B, with the integrals of the errors of h and V after the errors, if wanted."""
    return augment_integrals(linear.A, linear.B, [0, 2]) if integral else (linear.A, linear.B)


def mode_filter(linear: LinearModel, filter: str = "tuned") -> tuple[Any, Any, Any, Any, KalmanBucy]:
    """A_eta (4, 4), C (1, 4), Q_eta, R and the steady filter of the modes; what v does to them is known to it.

    A_eta and C are blocks of A: neither v nor its inversion depends on the modes.
    """
    if filter not in FILTERS:
        raise InputError("filter", f"{filter!r}", choices=FILTERS, fix="--filter tuned")
    diagonal, density = FILTERS[filter]
    A, C = linear.A[5:, 5:], linear.A[4:5, 5:]
    Q, R = np.diag(diagonal), np.array([[density]])
    return A, C, Q, R, kalman_bucy(A, C, Q, R)


def recorded_numbers(craft: Hypersonic, plant: Hypersonic) -> dict[str, RecordedNumber]:
    """kappa_G of the plant that flies, the least |det dv/du|, and the worst residual of the inversion the law flies."""
    kappa, determinant, residual = _worst_values(craft, plant)
    kappa_how = f"largest |(G_plant - G) G^-1|, {GRID_DESCRIPTION}" + ("; no parameter error" if plant == craft else "")
    residual_how = f"v = {WANTED_ACCELERATIONS} ft/s^2, {GRID_DESCRIPTION}"
    return {
        "kappa_G": RecordedNumber(kappa, 0.0, 1.0, kappa_how),
        "least |det dv/du|": RecordedNumber(determinant, 1.0, 1e9, GRID_DESCRIPTION),
        "residual of the inversion": RecordedNumber(residual, 0.0, 1e-9, residual_how),
    }


@lru_cache(maxsize=8)
def _worst_values(craft: Hypersonic, plant: Hypersonic) -> tuple[float, float, float]:
    v = jnp.array(WANTED_ACCELERATIONS)

    def at(point: Any) -> tuple[Any, Any, Any]:
        h, V, alpha, gamma, delta_e = point
        x = HypersonicState(h, V, alpha, alpha + gamma, 0.0, 0.0, 0.0, 0.0, 0.0)
        start = jnp.stack([0.3 * jnp.ones_like(h), delta_e])
        slope = jax.jacfwd(lambda w: accelerations(craft, x, w))
        G = slope(start)
        apart = jax.jacfwd(lambda w: accelerations(plant, x, w))(start) - G
        input = invert_path(craft, h, V * jnp.sin(gamma), V, alpha, v[0], v[1]).u
        u = jnp.stack([input.Phi, input.delta_e])
        inverse = jnp.array([[G[1, 1], -G[0, 1]], [-G[1, 0], G[0, 0]]]) / _determinant(G)
        return apart @ inverse, _determinant(G), accelerations(craft, x, u) - v

    errors, dets, left = jax.jit(jax.vmap(at), compiler_options=FAST_COMPILE_OPTIONS)(jnp.array(GRID))
    kappa = np.linalg.norm(np.asarray(errors), 2, axis=(1, 2)).max()
    return float(kappa), float(np.abs(dets).min()), float(np.abs(left).max())


def _determinant(G: Any) -> Any:
    return G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]


def accelerations(craft: Hypersonic, x: HypersonicState, u: Any) -> Any:
    """v = (h'', V') (ft/s^2) of the input u = (Phi, delta_e)."""
    along, normal = craft.path_accelerations(0.0, x, HypersonicInput(u[0], u[1]))
    gamma = x.theta - x.alpha
    return jnp.stack([along * jnp.sin(gamma) + normal * jnp.cos(gamma), along])

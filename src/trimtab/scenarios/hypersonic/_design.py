"""Gain, filter and certificate of the hypersonic vehicle, from its own trim; and, over a grid of the envelope, whether
the inversion is well-posed and how wrong its gains can be.

Errors e = (h, h', V, alpha, Q, eta1, eta1', eta2, eta2') less the desired ones; v = (h'', V').

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, assumption 1 for the envelope. Its weights are not printed; those here are chosen.
"""

import itertools
import math
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.core.rotation import DEG
from trimtab.design.certificate import METHODS, Certificate, design_certificate
from trimtab.design.certified_system import CertifiedSystem, LimitedNumber, system_settings
from trimtab.design.linearise import LinearModel
from trimtab.design.lmi import LmiGain, lmi_gain
from trimtab.design.lqr import Lqr, augment_integrals, lqr
from trimtab.design.normal_form import linear_normal_form
from trimtab.design.trim import Trim
from trimtab.estimators.flexible.discrete import EQUAL_Q, TUNED_Q
from trimtab.laws.adaptive_robust import SIZES, AdaptiveRobust
from trimtab.laws.path_inversion import InputLimits, invert_path
from trimtab.scenarios.hypersonic._certified_loop import UNCERTAINTY, prove_loop, uncertain_plant
from trimtab.scenarios.hypersonic._internal import LevelTrim, design_model, find_trim
from trimtab.scenarios.hypersonic._loop import INTEGRAL_SIZES, INTEGRALS
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState
from trimtab.vehicles.hypersonic_aerodynamics import KMODES

H, V = 85000.0, 7702.0808
"""Altitude (ft) and speed (ft/s) of the linearisation, [1] table 1."""
INTERNAL = ("alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
MODES = INTERNAL[2:]
SCALE = np.array(SIZES)
"""Sizes of the errors, for scaling the equations."""
ALLOWED = np.array([100.0, 20.0, 10.0, 0.05, 0.1, 1e3, 1e3, 1e3, 1e3])
"""Errors of weight 1: Q_e = diag(1/ALLOWED^2)."""
ALLOWED_INPUT = np.array([10.0, 5.0])
"""Accelerations (ft/s^2) of weight 1: R_e = diag(1/ALLOWED_INPUT^2)."""
ALLOWED_INTEGRALS = np.array(INTEGRAL_SIZES)
"""Integrals of the errors of h (ft s) and V (ft) of weight 1."""
STRICT_FACTOR = 1.01
"""The regulator's weight Q as a multiple of the certified Q_e, which makes (14) strict."""
FILTERS = {
    "tuned": (TUNED_Q, 5e-7),
    "equal": (EQUAL_Q, 5e-7),
    "accurate": ((1e-5, 1e-5, 1e-5, 1e-5), 5e-7),
    "printed": ((1e-5, 1e-5, 1e-5, 1e-5), 10.0),
}
"""Diagonals of Q_eta, R_eta (rad^2/s^3) by name: as flown; equal on both modes; for an exact model; printed in [1]."""
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
"""Envelope: h (ft), V (ft/s), alpha, gamma, delta_e (rad)."""
GRID_DESCRIPTION = (
    f"{len(GRID)} points of the envelope: 80-95 kft, 7-9 kft/s, alpha 0-4, gamma +-1, elevator -20 to 25.8 deg"
)
H_RANGE, V_RANGE = (80e3, 95e3), (7e3, 9e3)
"""Altitudes (ft) and speeds (ft/s) of GRID."""
WANTED_ACCELERATIONS = (2.0, -2.0)
"""Accelerations h'', V' (ft/s^2) demanded of the inversion."""


@lru_cache(maxsize=32)
def certified_system(
    method: str = "lqr",
    integral: str = "false",
    filter: str = "tuned",
    kmode: str = "parker",
    h_ft: float = H,
    V_ft_per_s: float = V,
    uncertainty: float = 1.0,
    mode_error: float = 0.03,
) -> CertifiedSystem:
    """Return the system to be certified: errors of the shipped vehicle in level flight, weights, filter, parameters.

    Args:
        method: "lqr" or "lmi".
        integral: "true": with integral action.
        filter: of FILTERS, or "none": the modes are measured.
        kmode: reading of k_i, as `FlexibleModes.kmode`.
        h_ft: altitude (ft), inside the envelope.
        V_ft_per_s: speed (ft/s), inside the envelope.
        uncertainty: of the plant that flies, in parts of UNCERTAINTY.
        mode_error: of both modes' frequencies in the plant that flies, either way, as a part of them.
    """
    _check_settings(integral, filter, kmode)
    for name, value, (low, high) in (("h_ft", h_ft, H_RANGE), ("V_ft_per_s", V_ft_per_s, V_RANGE)):
        if not low <= value <= high:
            raise InputError(
                name,
                f"must be within {low:g} to {high:g}, got {value:g}",
                fix="stay where the vehicle's curves were fitted",
            )
    if not 0 <= uncertainty < 10:  # at 10 there is no drag
        raise InputError("uncertainty", f"{uncertainty:g}", fix="give 0 (the plant is the model) to less than 10")
    if not 0 <= mode_error <= 0.2:
        raise InputError("mode_error", f"{mode_error:g}", fix="give 0 (the modes are the model's) to 0.2")
    craft = _believed_craft(kmode)
    linear, level = error_model(craft, h_ft, V_ft_per_s)
    trimmed = dict(zip(("alpha_rad", "Phi", "delta_e_rad"), map(float, (level.x[2], *level.u)), strict=True))
    A, B = error_matrices(linear, integral=integral == "true")
    Qe, Re, scale = weights(integral=integral == "true")
    Qe = Qe / STRICT_FACTOR if method == "lqr" else Qe
    about = {"method": method, "integral": integral, "filter": filter, "kmode": kmode, "h_ft": h_ft}
    system = CertifiedSystem(
        name="hypersonic",
        about=about | {"V_ft_per_s": V_ft_per_s, "uncertainty": uncertainty, "mode_error": mode_error} | trimmed,
        method=method,
        states=(*linear.states, *INTEGRALS) if integral == "true" else linear.states,
        inputs=linear.inputs,
        A=A,
        B=B,
        Qe=Qe,
        Re=Re,
        Q=STRICT_FACTOR * Qe if method == "lqr" else None,
        scale=scale,
    )
    system = system._replace(numbers=lambda K: envelope_numbers(craft, K, uncertainty))
    if filter == "none":
        return system
    diagonal, density = FILTERS[filter]
    C, Q_eta, R = linear.A[4:5, 5:], np.diag(diagonal), np.array([[density]])
    system = system._replace(estimated=MODES, C=C, Q_eta=Q_eta, R=R)
    at = LevelTrim(h_ft, V_ft_per_s, level.x[[2, 4, 5, 6, 7, 8]], HypersonicInput(*map(float, level.u)))
    return system._replace(loop_lines=prove_loop(craft, at, filter, uncertainty, mode_error))


@lru_cache(maxsize=len(KMODES))
def _believed_craft(kmode: str) -> Hypersonic:
    return NOMINAL if kmode == NOMINAL.modes.kmode else replace(NOMINAL, modes=replace(NOMINAL.modes, kmode=kmode))


def _check_settings(integral: str, filter: str, kmode: str) -> None:
    offered = {"integral": ("false", "true"), "filter": (*FILTERS, "none"), "kmode": KMODES}
    for name, value in {"integral": integral, "filter": filter, "kmode": kmode}.items():
        if value not in offered[name]:
            raise InputError(
                name,
                f"unknown choice {value!r}",
                choices=offered[name],
                fix=argument("settings", offered[name][0], name),
            )


def certificate(**settings: str | float) -> Certificate:
    """Return gain, filter and proofs of a `certified_system` with these settings."""
    return design_certificate(certified_system(**system_settings(certified_system, settings, "hypersonic")))


@lru_cache(maxsize=8)
def error_model(craft: Hypersonic = NOMINAL, h: float = H, V: float = V) -> tuple[LinearModel, Trim]:
    """Return e' = A e + B v of the law's vehicle model, exactly linearised at level flight, and that flight's trim."""
    plant = design_model(craft, h, V)
    level = find_trim(plant, InputLimits(), "hypersonic trim")
    return linear_normal_form(plant, {"h": 2, "V": 1}, INTERNAL, level.x, level.u), level


def weights(*, integral: bool = False) -> tuple[Any, Any, Any]:
    """Return Q_e, R_e and the sizes of the errors; followed by the integrals of the errors of h and V, if wanted."""
    allowed = np.append(ALLOWED, ALLOWED_INTEGRALS) if integral else ALLOWED
    scale = np.append(SCALE, ALLOWED_INTEGRALS) if integral else SCALE
    return np.diag(allowed**-2.0), np.diag(ALLOWED_INPUT**-2.0), scale


def feedback_gain(
    linear: LinearModel, *, method: str = "lqr", integral: bool = False, strict: float = 1.0
) -> Lqr | LmiGain:
    """Return K (2, 9), or (2, 11) with integrals, of v = +K e; as it flies.

    Args:
        linear: of `error_model`.
        method: "lqr" or "lmi".
        integral: append the integrals of the errors of h and V.
        strict: the regulator's Q in parts of Q_e.
    """
    if method not in METHODS:
        raise InputError("method", f"unknown method {method!r}", choices=METHODS, fix=argument("method", "lqr"))
    A, B = error_matrices(linear, integral=integral)
    Qe, Re, scale = weights(integral=integral)
    return lqr(A, B, strict * Qe, Re, scale=scale) if method == "lqr" else lmi_gain(A, B, Qe, Re, scale=scale)


def error_matrices(linear: LinearModel, *, integral: bool = False) -> tuple[Any, Any]:
    """Return A and B, with the integrals of the errors of h and V after the errors, if wanted."""
    return augment_integrals(linear.A, linear.B, [0, 2]) if integral else (linear.A, linear.B)


def envelope_numbers(craft: Hypersonic, K: Any, uncertainty: float) -> dict[str, LimitedNumber]:
    """Return the bounds of assumptions 1 and 2 of [1] for the plant and the inversion, over the envelope.

    kappa_G bounds |(G_plant - G) G^-1|; rho0 and rho1 bound what the inversion leaves, |M_F| <= rho0 + rho1 |e/scale|,
    with M_F = v_plant - v at v = y_d + K e; [1] prints none of the three. All are largest at a corner of the plant's
    uncertainty, for they are convex in v_plant, and that is affine in each of the uncertain coefficients (1/m too).

    Args:
        craft: the law's vehicle model.
        K: gain (2, 9), or more columns: of the integrals.
        uncertainty: in parts of UNCERTAINTY.
    """
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=len(UNCERTAINTY)))) * uncertainty
    values = jax.tree.map(np.asarray, _sweep_envelope(craft, K[:, :9] * SCALE, corners, np.array(GRID)))
    kappa, rho0, rho1 = (float(value.max()) for value in values[:3])
    determinant, residual = float(np.abs(values[3]).min()), float(values[4].max())
    errors = ", ".join(
        f"{path.rpartition('.')[2]} {100 * part * uncertainty:g} %" for path, part in UNCERTAINTY.items()
    )
    where = f"{len(corners)} plants, {errors}; {GRID_DESCRIPTION}"
    cap = float(AdaptiveRobust(BP=np.zeros((2, 9))).cap)
    return {
        "kappa_G": LimitedNumber(kappa, 0.0, 1.0, f"largest |(G_plant - G) G^-1|, {where}", 1e-9),
        "rho0 (ft/s^2)": LimitedNumber(rho0, 0.0, cap, f"|M_F| at y_d = corners of +-2 ft/s^2; {where}", 1e-8),
        "rho1 (ft/s^2)": LimitedNumber(rho1, 0.0, cap, f"largest |dM_F/dv K scale|; {where}", 1e-8),
        "least |det dv/du|": LimitedNumber(determinant, 1.0, math.inf, GRID_DESCRIPTION, 1e-6),
        "residual of the inversion": LimitedNumber(
            residual, 0.0, 1e-9, f"v = {WANTED_ACCELERATIONS} ft/s^2, {GRID_DESCRIPTION}", 1e-11
        ),
    }


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _sweep_envelope(craft: Hypersonic, sized: Any, corners: Any, grid: Any) -> Any:
    """At each point of a grid (p, 5): for the corners of the uncertainty (c, 5), |(G_plant - G) G^-1|, |M_F| and
    |dM_F/dv K scale| (p, c); and det dv/du and the inversion's residual (p,).  sized: K scale (2, 9)."""
    wanted = jnp.array(list(itertools.product((-2.0, 2.0), repeat=2)))

    def at(point: Any) -> Any:
        h, V, alpha, gamma, delta_e = point
        x = HypersonicState(h, V, alpha, alpha + gamma, 0.0, 0.0, 0.0, 0.0, 0.0)
        start = jnp.stack([0.3 * jnp.ones_like(h), delta_e])
        G = jax.jacfwd(lambda w: accelerations(craft, x, w))(start)
        inverse = jnp.array([[G[1, 1], -G[0, 1]], [-G[1, 0], G[0, 0]]]) / _determinant(G)

        def solve_input(v: Any) -> Any:
            input = invert_path(craft, h, V * jnp.sin(gamma), V, alpha, v[0], v[1]).u
            return jnp.stack([input.Phi, input.delta_e])

        def at_corner(parts: Any) -> Any:
            plant = uncertain_plant(craft, parts)
            E = (jax.jacfwd(lambda w: accelerations(plant, x, w))(start) - G) @ inverse
            left = jax.vmap(lambda v: accelerations(plant, x, solve_input(v)) - v)(wanted)
            return _norm(E), jnp.sqrt((left**2).sum(axis=1)).max(), _norm(E @ sized)

        asked = jnp.array(WANTED_ACCELERATIONS)
        residual = jnp.abs(accelerations(craft, x, solve_input(asked)) - asked).max()
        return *jax.vmap(at_corner)(corners), _determinant(G), residual

    return jax.vmap(at)(grid)


def _norm(M: Any) -> Any:
    """Return the largest singular value of a matrix of two rows (2, n)."""
    S = M @ M.T
    half, apart = (S[0, 0] + S[1, 1]) / 2, (S[0, 0] - S[1, 1]) / 2
    return jnp.sqrt(half + jnp.sqrt(apart**2 + S[0, 1] ** 2))


def _determinant(G: Any) -> Any:
    return G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]


def accelerations(craft: Hypersonic, x: HypersonicState, u: Any) -> Any:
    """Return v = (h'', V') (ft/s^2) of the input u = (Phi, delta_e)."""
    along, normal = craft.path_accelerations(0.0, x, HypersonicInput(u[0], u[1]))
    gamma = x.theta - x.alpha
    return jnp.stack([along * jnp.sin(gamma) + normal * jnp.cos(gamma), along])

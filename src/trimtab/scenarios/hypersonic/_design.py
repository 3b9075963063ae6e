"""Design of gain and filter of the hypersonic vehicle at its trim point, and certificate of the loop's stability.

On a grid over the flight envelope, the module also checks that the dynamic inversion is well-posed, and bounds the
error of the inversion for an uncertain plant. The tracking error e is (h, h', V, alpha, Q, eta1, eta1', eta2, eta2')
minus the desired values. The input of the error model is v = (h'', V').

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, assumption 1 for the envelope. The paper does not print the weights of its design,
so the weights are our choice.
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
"""Typical sizes of the tracking errors (h, h', V, alpha, Q, eta1, eta1', eta2, eta2'), used to scale the equations."""
ALLOWED = np.array([100.0, 20.0, 10.0, 0.05, 0.1, 1e3, 1e3, 1e3, 1e3])
"""Value of each tracking error for which the error's cost is 1. The cost matrix is Q_e = diag(1/ALLOWED^2)."""
ALLOWED_INPUT = np.array([10.0, 5.0])
"""Value of each acceleration h'', V' (ft/s^2) for which its cost is 1. The matrix is R_e = diag(1/ALLOWED_INPUT^2)."""
ALLOWED_INTEGRALS = np.array(INTEGRAL_SIZES)
"""Values of the integrals of the errors of h (ft s) and V (ft) for which the cost of each integral is 1."""
STRICT_FACTOR = 1.01
"""Ratio of the weight Q of the regulator's design to the weight Q_e in the certificate. A ratio above 1 makes
inequality (14) of [1] strict."""
FILTERS = {
    "tuned": (TUNED_Q, 5e-7),
    "equal": (EQUAL_Q, 5e-7),
    "accurate": ((1e-5, 1e-5, 1e-5, 1e-5), 5e-7),
    "printed": ((1e-5, 1e-5, 1e-5, 1e-5), 10.0),
}
"""Name of the filter settings -> diagonal of the process noise density Q_eta, and measurement noise density R_eta
(rad^2/s^3).

tuned: settings used in flight. equal: equal process noise for both modes. accurate: settings for an exact model.
printed: settings of [1].
"""
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
"""Grid points of the flight envelope: altitude h (ft), speed V (ft/s), angle of attack alpha, flight path angle gamma,
elevator delta_e (rad)."""
GRID_DESCRIPTION = (
    f"{len(GRID)} points of the envelope: 80-95 kft, 7-9 kft/s, alpha 0-4, gamma +-1, elevator -20 to 25.8 deg"
)
H_RANGE, V_RANGE = (80e3, 95e3), (7e3, 9e3)
"""Ranges of altitude (ft) and speed (ft/s) in GRID."""
WANTED_ACCELERATIONS = (2.0, -2.0)
"""Accelerations h'', V' (ft/s^2) for which the residual of the inversion is computed."""


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
    """Return the system to certify: error model in level flight, weights, filter and parameters of the default vehicle.

    Args:
        method: design method of the gain, "lqr" or "lmi".
        integral: "true" adds integral action to the law.
        filter: name of filter settings in FILTERS, or "none" if the modes are measured.
        kmode: interpretation of the paper's coefficients k_i, see `FlexibleModes.kmode`.
        h_ft: altitude (ft), inside the envelope.
        V_ft_per_s: speed (ft/s), inside the envelope.
        uncertainty: uncertainty of the simulated plant, as a multiple of UNCERTAINTY.
        mode_error: relative error of both modal frequencies of the simulated plant, in either direction.
    """
    _check_settings(integral, filter, kmode)
    for name, value, (low, high) in (("h_ft", h_ft, H_RANGE), ("V_ft_per_s", V_ft_per_s, V_RANGE)):
        if not low <= value <= high:
            raise InputError(
                name,
                f"must be within {low:g} to {high:g}, got {value:g}",
                fix="choose a value in the range for which the vehicle's curves were fitted",
            )
    if not 0 <= uncertainty < 10:  # for 10, the drag of the plant could be zero
        raise InputError(
            "uncertainty", f"must be at least 0 and below 10, got {uncertainty:g}", fix="choose 0 for an exact model"
        )
    if not 0 <= mode_error <= 0.2:
        raise InputError(
            "mode_error", f"must be within 0 to 0.2, got {mode_error:g}", fix="choose 0 for exact modal frequencies"
        )
    craft = _assumed_craft(kmode)
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
def _assumed_craft(kmode: str) -> Hypersonic:
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
    """Return the certificate, with gain, filter and proofs, of a `certified_system` with the given settings."""
    return design_certificate(certified_system(**system_settings(certified_system, settings, "hypersonic")))


@lru_cache(maxsize=8)
def error_model(craft: Hypersonic = NOMINAL, h: float = H, V: float = V) -> tuple[LinearModel, Trim]:
    """Return the error model e' = A e + B v, and the trim point of its linearisation: level flight at h (ft), V
    (ft/s)."""
    plant = design_model(craft, h, V)
    level = find_trim(plant, InputLimits(), "hypersonic trim")
    return linear_normal_form(plant, {"h": 2, "V": 1}, INTERNAL, level.x, level.u), level


def weights(*, integral: bool = False) -> tuple[Any, Any, Any]:
    """Return the weights Q_e and R_e, and the typical sizes of the tracking errors.

    integral: True to include the integrals of the errors of h and V.
    """
    allowed = np.append(ALLOWED, ALLOWED_INTEGRALS) if integral else ALLOWED
    scale = np.append(SCALE, ALLOWED_INTEGRALS) if integral else SCALE
    return np.diag(allowed**-2.0), np.diag(ALLOWED_INPUT**-2.0), scale


def feedback_gain(
    linear: LinearModel, *, method: str = "lqr", integral: bool = False, strict: float = 1.0
) -> Lqr | LmiGain:
    """Return the feedback gain K in v = +K e that is used in flight, (2, 9), or (2, 11) with integrals.

    Args:
        linear: error model from `error_model`.
        method: design method, "lqr" or "lmi".
        integral: True to append the integrals of the errors of h and V.
        strict: ratio of the weight Q of the regulator's design to Q_e, used only by method "lqr".
    """
    if method not in METHODS:
        raise InputError("method", f"unknown method {method!r}", choices=METHODS, fix=argument("method", "lqr"))
    A, B = error_matrices(linear, integral=integral)
    Qe, Re, scale = weights(integral=integral)
    return lqr(A, B, strict * Qe, Re, scale=scale) if method == "lqr" else lmi_gain(A, B, Qe, Re, scale=scale)


def error_matrices(linear: LinearModel, *, integral: bool = False) -> tuple[Any, Any]:
    """Return A and B of the error model. integral: True to append the integrals of the errors of h and V as states."""
    return augment_integrals(linear.A, linear.B, [0, 2]) if integral else (linear.A, linear.B)


def envelope_numbers(craft: Hypersonic, K: Any, uncertainty: float) -> dict[str, LimitedNumber]:
    """Return the bounds on plant and inversion in assumptions 1 and 2 of [1], over the flight envelope.

    kappa_G bounds |(G_plant - G) G^-1|, where G is the derivative of v by the inputs. rho0 and rho1 bound the error
    M_F = v_plant - v of the inversion at v = y_d + K e: |M_F| <= rho0 + rho1 |e/scale|. The paper prints none of these
    three numbers. Each bound is largest at a corner of the plant's uncertainty, because it is convex in v_plant, and
    v_plant is affine in each uncertain coefficient and in 1/m.

    Args:
        craft: vehicle model of the law.
        K: gain (2, 9). The additional columns of a gain with integrals are ignored.
        uncertainty: uncertainty of the plant, as a multiple of UNCERTAINTY.
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
    """Return the quantities from which `envelope_numbers` computes its bounds, at each point of a grid (p, 5).

    |(G_plant - G) G^-1|, |M_F| and |dM_F/dv K scale| have shape (p, c), for c corners of the uncertainty. det dv/du
    and the residual of the inversion have shape (p,).

    sized: gain K, with each column multiplied by the typical size of its error (2, 9).  corners: (c, 5).
    """
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
    """Return the largest singular value of a matrix with two rows (2, n)."""
    S = M @ M.T
    half, apart = (S[0, 0] + S[1, 1]) / 2, (S[0, 0] - S[1, 1]) / 2
    return jnp.sqrt(half + jnp.sqrt(apart**2 + S[0, 1] ** 2))


def _determinant(G: Any) -> Any:
    return G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]


def accelerations(craft: Hypersonic, x: HypersonicState, u: Any) -> Any:
    """Return the accelerations v = (h'', V') (ft/s^2) of the vehicle in state x with input u = (Phi, delta_e)."""
    along, normal = craft.path_accelerations(0.0, x, HypersonicInput(u[0], u[1]))
    gamma = x.theta - x.alpha
    return jnp.stack([along * jnp.sin(gamma) + normal * jnp.cos(gamma), along])

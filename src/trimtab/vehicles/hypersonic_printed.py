"""Published linearisation and gain of the hypersonic vehicle, and a reconstruction of how they were computed.

Order of the errors: (h, h', V, alpha, Q, eta1, eta1', eta2, eta2'); virtual inputs (h'', V'); slug, foot, second.

**Do not control a vehicle with these matrices.** Signs are lost, one coefficient is used twice, one division by an
inertia is too many, and neither sign of the gain stabilises the vehicle. `emulate_linearisation` repeats the errors and
reproduces the magnitudes of 32 of the 34 numbers in rows 4, 5, 7 and 9. Row 9 of B agrees with none of the variants
that were tried.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, parameters of its simulation.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.vehicles.hypersonic import Hypersonic

ORDER = ("h", "h_rate", "V", "alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
"""Order of the errors in the printed matrices. It differs from the order of the vehicle's state."""
QUOTED_H, QUOTED_V = 85000.0, 7702.0808
QUOTED_ALPHA, QUOTED_ELEVATOR = math.radians(1.5153), math.radians(11.4635)
"""Flight condition of the published linearisation. It is a trim of the original model, to which the curves were fitted,
but not a trim of the fitted curves."""
A_PRINTED = np.array(
    [
        [0, 1, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [7.073e-8, 1.388e-8, 7.186e-7, 0.0696, 1, 0, 0, 0, 0],
        [-2.29e-5, 2.23e-5, 1.27e-4, 11.63, 0, 0.0745, -1.80e-4, 0.263, -5.26e-4],
        [0, 0, 0, 0, 0, 0, 1, 0, 0],
        [0, 0, 0, 4647.82, 0, -272.25, 0.66, 7.207e-5, 1.44e-7],
        [0, 0, 0, 0, 0, 0, 0, 0, 1],
        [0.021, -1.555e-3, 0.1176, -5100.67, 0, 4.90e-5, 1.189e-7, -400, 0.8],
    ]
)
"""Matrix A of the linearisation as printed, with the printed signs. Source: [1]."""
B_PRINTED = np.array(
    [
        [0, 0],
        [1, 0],
        [0, 1],
        [1.7e-6, -3.39e-6],
        [-0.0161, -0.0054],
        [0, 0],
        [-3.35e-5, 1.8304e-4],
        [0, 0],
        [18.0596, -1.24],
    ]
)
"""Matrix B of the linearisation as printed, with the printed signs. Source: [1]."""
K_PRINTED = np.array(
    [
        [-2.919, -4.14, 2.65, -2771.93, -822.22, 0.0153, 0.0017, 0.5, 0.0526],
        [0.848, 0.9295, 4.629, 386.93, 114.79, -0.0033, -0.00027, -0.05, 0.00013],
    ]
)
"""Gain K as printed, for v = -K e, although [1] writes v = +K e. Source: [1]."""


class EmulatedLinearisation(NamedTuple):
    """Matrices A (9, 9) and B (9, 2) with the errors of the publication repeated, in the order of the constant
    ORDER."""

    A: Any
    B: Any


def emulate_linearisation(vehicle: Hypersonic | None = None) -> EmulatedLinearisation:
    """Return the linearisation with rows 4, 5, 7, 9 as the publication's program seems to have computed them.

    The other rows are exact. Each row is differentiated at the quoted point, including the inversion u = G^-1 (v - F),
    which varies with the state. f and b are terms of the equations in [1]. In row 4, b31 replaces b32. Row 5 takes the
    columns of the modes from f7 and f9 alone. Row 7 of B is not multiplied by G^-1. In rows 7 and 9, psi_i/Iyy replaces
    psi_i, and each f is substituted once.

    Source: reconstructed from the printed numbers of [1].
    """
    craft = Hypersonic() if vehicle is None else vehicle
    N1, N2 = craft.modes.static_displacements(QUOTED_ALPHA, 0.0)
    e = jnp.array([QUOTED_H, 0.0, QUOTED_V, QUOTED_ALPHA, 0.0, float(N1), 0.0, float(N2), 0.0])

    @jax.jit
    def derivatives(e: Any, v: Any) -> Any:
        rows = jax.jacfwd(lambda e, v: _rows(craft, e, v), (0, 1))(e, v)
        return rows, jax.jacfwd(lambda e: _bending(craft, e)[4])(e), _bending(craft, e)[2]

    (A, B), flexible, inputs = jax.tree.map(np.array, derivatives(e, jnp.zeros(2)))
    A[4] = np.where(np.arange(9) < 5, A[4], flexible)
    B[6] = inputs
    return EmulatedLinearisation(A, B)


def _inversion(craft: Hypersonic, e: Any, v: Any) -> tuple[Any, Any, Any]:
    """Return the input u, and the terms f3 and b31 of the equation for alpha' in [1]."""
    h, h_rate, V, alpha, Q = (e[i] for i in range(5))
    air, m, g = craft.forces.aerodynamics, craft.m, craft.g
    qbar = craft.forces.dynamic_pressure(h, V)
    T0, TP = craft.forces.propulsion.thrust_without_fuel(alpha), craft.forces.propulsion.thrust_per_fuel_ratio(alpha)
    L0, D0 = air.lift(qbar, alpha, 0.0), air.drag(qbar, alpha, 0.0)
    sine = h_rate / V
    gamma = jnp.arcsin(sine)
    secant = qbar * air.S / m * (air.CD_d2 * QUOTED_ELEVATOR + air.CD_d)
    f2 = (T0 * jnp.cos(alpha) - D0) / m - g * sine
    f3 = -(T0 * jnp.sin(alpha) + L0) / (m * V) + Q + g / V * jnp.cos(gamma)
    b21, b31, b32 = TP * jnp.cos(alpha) / m, -TP * jnp.sin(alpha) / (m * V), -qbar * air.S * air.CL_d / (m * V)
    F1 = sine * f2 - V * jnp.cos(gamma) * (f3 - Q)
    G11, G12 = sine * b21 - V * jnp.cos(gamma) * b31, -sine * secant - V * jnp.cos(gamma) * b32
    w1, w2 = v[0] - F1, v[1] - f2
    determinant = -G11 * secant - G12 * b21
    u = jnp.stack([(-secant * w1 - G12 * w2) / determinant, (G11 * w2 - b21 * w1) / determinant])
    return u, f3, b31


def _bending(craft: Hypersonic, e: Any) -> tuple[Any, ...]:
    """Return terms of the equations of [1]: f7, f9, [b71 b72], [b91 b92], the term that the modes add to row 5, and m0
    and [mP md] of row 5."""
    alpha, modes, air, engine = e[3], craft.modes, craft.forces.aerodynamics, craft.forces.propulsion
    qbar = craft.forces.dynamic_pressure(e[0], e[2])
    t1, t2 = modes.psi1 / craft.Iyy, modes.psi2 / craft.Iyy
    k = t1 * t2
    m0 = (engine.zT * engine.thrust_without_fuel(alpha) + air.moment(qbar, alpha, 0.0)) / craft.Iyy
    mP, md = engine.zT * engine.thrust_per_fuel_ratio(alpha) / craft.Iyy, qbar * air.S * air.c * air.ce / craft.Iyy
    N1, N2 = modes.forcing(alpha, 0.0)
    back1, back2 = modes.restoring_forces(e[5], e[6], e[7], e[8])
    r1, r2 = N1 + back1, N2 + back2
    f7, f9 = r1 - k * r2 - t1 * m0, r2 - k * r1 - t2 * m0
    b7 = jnp.stack([-t1 * mP, -t1 * md - k * modes.N2_d])
    b9 = jnp.stack([-t2 * mP, -t2 * md + modes.N2_d])
    return f7, f9, b7, b9, t1 * f7 + t2 * f9, m0, jnp.stack([mP, md])


def _rows(craft: Hypersonic, e: Any, v: Any) -> Any:
    """Return e' as the publication's program seems to have computed it, before row 5 and row 7 of B are replaced."""
    u, f3, b31 = _inversion(craft, e, v)
    f7, f9, b7, b9, _, m0, mu = _bending(craft, e)
    rigid = [e[1], v[0], v[1], f3 + b31 * (u[0] + u[1]), m0 + mu @ u]
    return jnp.stack([*rigid, e[6], f7 + b7 @ u, e[8], f9 + b9 @ u])

"""The bending modes with frequencies that are not known: coordinates in which rest says nothing about them.

The first thought, eta and the frequencies in one state, has a trap. At rest eta_i = N_i/w_i^2: the accelerometer feels
w_i^2 eta_i alone, so that a pair (eta_i, w_i) along a curve explains it equally well. A linearised filter whose
estimate moves with the noise sees that curve from several tangents, and believes that it learns where on it the truth
is. In stretched displacements

    s_i = (w_i/w_i0)^2 eta_i        s_i' = (w_i/w_i0)^2 eta_i'        lam_i = ln(w_i/w_i0)

the curve is the axis of lam_i, the same everywhere, and lam_i acts through vibration alone:

    r_i = N_i - w_i0^2 s_i - 2 zeta_i w_i0 exp(-lam_i) s_i'      s_i'' = exp(2 lam_i) eta_i''(r_1, r_2)

For constant lam_i this is exact, and linear in s. w_i0 are the nominal frequencies, those of the vehicle given.

Source: derived from [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for
hypersonic flight vehicle", Aerospace 2022, 9(4), 206, eq. 1, in the reading of the coupling that the vehicle has.
"""

from typing import Any

import numpy as np

from trimtab.core.float64 import jax, jnp
from trimtab.vehicles.hypersonic import Hypersonic

TERMS = 6
"""Of the exponential's series over a step; what is left out is (w dt)^7/5040, 4e-11 at 22 rad/s and 5 ms."""
OF_MODE = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1]])
"""Which mode each of s1, s1', s2, s2' belongs to."""


def stretch(x: Any) -> Any:
    """(w_i/w_i0)^2 for each of s1, s1', s2, s2', (4,), of x = (s1, s1', s2, s2', lam1, lam2)."""
    return OF_MODE @ jnp.exp(2 * x[4:])


def bending(craft: Hypersonic, x: Any) -> tuple[Any, Any, Any]:
    """Q' (rad/s^2), eta1'', eta2'' of the modes' own motion x (6,)."""
    back1, back2 = craft.modes.restoring(x[0], x[1] * jnp.exp(-x[4]), x[2], x[3] * jnp.exp(-x[5]))
    return craft.modes.coupled(craft.Iyy, 0.0, back1, back2)


def moved(craft: Hypersonic, x: Any, b: Any, dt: Any) -> Any:
    """x (6,) after dt (s) under a held forcing b (4,) of eta: the exponential's series on what is linear in s."""
    by, still = stretch(x), jnp.zeros(2)

    def rate(s: Any) -> Any:
        _, first, second = bending(craft, jnp.concatenate([s, x[4:]]))
        return jnp.stack([s[1], by[1] * first, s[3], by[3] * second])

    start = rate(x[:4]) + by * b
    total = start
    for k in range(TERMS, 1, -1):
        total = start + dt / k * rate(total)
    return x + dt * jnp.concatenate([total, still])


def vibration(craft: Hypersonic, x: Any, P: Any, b: Any) -> tuple[Any, Any]:
    """How much each mode moves, eta_i''^2 + w_i^2 eta_i'^2 (2,), and how much of that P (6, 6) leaves in doubt (2,)."""
    _, first, second = bending(craft, x)
    by, w0 = stretch(x), jnp.stack([craft.modes.w1, craft.modes.w2])
    w = w0 * jnp.exp(x[4:])
    rate = jnp.stack([x[1] / by[1], x[3] / by[3]])
    moves = jnp.stack([first + b[1], second + b[3]]) ** 2 + (w * rate) ** 2
    displacement, velocity = jnp.stack([P[0, 0], P[2, 2]]), jnp.stack([P[1, 1], P[3, 3]])
    return moves, (w0 / w) ** 4 * w**2 * (w**2 * displacement + velocity)


def jolt(craft: Hypersonic, x: Any) -> Any:
    """x' (6,) that comes with an unknown moment, by the pitch acceleration (rad/s^2) that it makes."""
    q_rate, first, second = craft.modes.coupled(craft.Iyy, craft.Iyy, 0.0, 0.0)
    by, still = stretch(x), jnp.zeros_like(q_rate)
    return jnp.stack([still, by[1] * first / q_rate, still, by[3] * second / q_rate, still, still])


def unstretched(x: Any, P: Any) -> tuple[Any, Any]:
    """(eta1, eta1', eta2, eta2', lam1, lam2) and its covariance (6, 6), to first order."""
    soft = 1 / stretch(x)
    eta = soft * x[:4]
    top = jnp.concatenate([jnp.eye(4) * soft, -2 * eta[:, None] * OF_MODE], axis=1)
    G = jnp.concatenate([top, jnp.eye(6)[4:]])
    return jnp.concatenate([eta, x[4:]]), G @ P @ G.T


def mixture(x: Any, P: Any, p: Any) -> tuple[Any, Any]:
    """Mean (6,) and covariance (6, 6), unstretched, of hypotheses x (m, 6), P (m, 6, 6) of probabilities p (m,)."""
    y, V = jax.vmap(unstretched)(x, P)
    mean = p @ y
    off = y - mean
    spread = V + off[:, :, None] * off[:, None, :]
    return mean, (p @ spread.reshape(-1, 36)).reshape(6, 6)

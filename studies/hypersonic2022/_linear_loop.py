"""The closed loop of the hypersonic vehicle as one matrix: what noise does in the long run, and how fast it calms down.

One control period at level flight, by automatic differentiation through the filter, the law and the plant that fly, the
filter's gain at its steady value. Noise of the accelerometer enters as the filter's innovation does.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from trimtab.core.integrate import rk4
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.core.time import to_seconds
from trimtab.estimators.flexible.discrete import TUNED_Q, FlexibleModeFilter
from trimtab.estimators.flexible.model import RigidFlight
from trimtab.laws.path_command import PathPoint
from trimtab.laws.path_inversion import invert_path
from trimtab.laws.stable_inversion import K_FLOWN
from trimtab.scenarios.hypersonic._design import H, V
from trimtab.scenarios.hypersonic._flight import TICK
from trimtab.scenarios.hypersonic._internal import LevelTrim, level_trim
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

NOISE = 0.01
"""Of the accelerometer (rad/s^2 a sample)."""
DETUNED = tuple((a, b) for a in (0.9, 1.0, 1.1) for b in (0.9, 1.0, 1.1) if (a, b) != (1.0, 1.0))
"""Factors of both modal frequencies: together, crossed, and one alone, 10 % off."""
X, ETA, CHI, U = slice(0, 9), slice(9, 13), slice(13, 18), slice(18, 20)
"""Of the loop's state: the plant's, the estimate of the modes, and the measured flight and input of one period ago."""


class Quality(NamedTuple):
    """Of one setting.

    elevator: rms of the elevator from noise (rad).  h, V: rms of the errors from noise (ft, ft/s).
    growth: of the slowest motion with an exact model (1/s).  worst: the same over DETUNED, and `at` which of them.
    """

    elevator: float
    h: float
    V: float
    growth: float
    worst: float
    at: tuple[float, float]


def loop_quality(Q: Any = TUNED_Q, R: float = 1e-4, K: Any = K_FLOWN) -> Quality:
    """What the filter's Q (4,) and R, and the gain K (2, 9), give."""
    F, N = loop_matrices(Q, R, K)
    sigma = np.sqrt(np.diag(solve_discrete_lyapunov(F, NOISE**2 * np.outer(N, N))))
    found = {at: growth_rate(Q, R, K, at) for at in DETUNED}
    worst = max(found, key=lambda at: found[at])
    return Quality(sigma[19], sigma[0], sigma[1], growth_rate(Q, R, K), found[worst], worst)


def growth_rate(Q: Any, R: float, K: Any = K_FLOWN, detuned: tuple[float, float] = (1.0, 1.0)) -> float:
    """Of the slowest motion (1/s), the plant's modal frequencies times `detuned`; above 0 the vehicle is lost."""
    F, _ = loop_matrices(Q, R, K, detuned)
    return float(np.log(np.abs(np.linalg.eigvals(F)).max()) / to_seconds(TICK))


def widest_error(Q: Any, R: float, K: Any = K_FLOWN, most: float = 0.4) -> float:
    """Up to which error of the frequencies, as a part of them and in any of the eight directions, all stays stable."""
    low, high = 0.0, most
    while high - low > 1e-3:
        x = (low + high) / 2
        stable = all(growth_rate(Q, R, K, (1 + 10 * x * (a - 1), 1 + 10 * x * (b - 1))) < 0 for a, b in DETUNED)
        low, high = (x, high) if stable else (low, x)
    return low


def loop_matrices(Q: Any, R: float, K: Any, detuned: tuple[float, float] = (1.0, 1.0)) -> tuple[Any, Any]:
    """F (20, 20) and N (20,): z = F z + N w over one period, w the accelerometer's noise."""
    believed = Hypersonic()
    modes = believed.modes
    plant = replace(believed, modes=replace(modes, w1=modes.w1 * detuned[0], w2=modes.w2 * detuned[1]))
    kept = FlexibleModeFilter(craft=believed, Q=tuple(map(float, Q)), R=float(R), period=TICK)
    model = kept.model()
    P = solve_discrete_are(np.asarray(model.Ad).T, np.asarray(model.C)[:, None], np.asarray(model.Qd), [[kept.R]])
    at = level_trim(believed, H, V)
    z = rest_state(plant, believed, at)
    F, N = _differentiate_period(plant, kept, np.asarray(K, float), P, at.zeta, z, 0.0)
    return np.asarray(F), np.asarray(N)


def rest_state(plant: Hypersonic, believed: Hypersonic, at: LevelTrim) -> Any:
    """The loop's state (20,) in level flight: the plant bent as its own modes have it, the filter as it believes."""
    x = plant.level_state(at.h, at.V, at.zeta[0], at.u.delta_e)
    e1, e2 = believed.modes.static_displacements(at.zeta[0], at.u.delta_e)
    chi = [at.h, 0.0, at.V, at.zeta[0], 0.0]
    values = [*jax.tree.leaves(x), e1, 0.0, e2, 0.0, *chi, at.u.Phi, at.u.delta_e]
    return np.array([float(value) for value in values])


def step_period(plant: Any, kept: Any, K: Any, P: Any, zeta: Any, z: Any, w: Any) -> Any:
    """The loop's state (20,) one period on, in the order in which it flies.

    Args:
        plant: the vehicle that flies.
        kept: the filter.
        K: gain (2, 9).
        P: the filter's steady covariance before an update (4, 4).
        zeta: wanted internal state (6,).
        z: the loop's state.
        w: noise of the accelerometer (rad/s^2).
    """
    x, believed = HypersonicState(*z[X]), kept.craft
    before, held = RigidFlight(*z[CHI]), HypersonicInput(*z[U])
    chi = RigidFlight(x.h, x.V * jnp.sin(x.theta - x.alpha), x.V, x.alpha, x.q)
    model = kept.model()
    eta, _ = kept.predict(model, z[ETA], P, before, held)
    felt = plant.coupled_accelerations(0.0, x, held)[0] + w
    eta = kept.update(model, eta, P, chi, held, felt).x
    want = PathPoint(H, 0.0, 0.0, 0.0, V, 0.0, 0.0)
    have = jnp.stack([chi.h, chi.h_rate, chi.V, chi.alpha, chi.q, *eta])
    v = K @ (have - jnp.stack([jnp.asarray(a) for a in (want.h, want.h_rate, want.V, *zeta)]))
    u = invert_path(believed, chi.h, chi.h_rate, chi.V, chi.alpha, v[0], v[1]).u
    moved = rk4(lambda t, x: plant.dynamics(t, x, u), 0.0, x, to_seconds(TICK))
    return jnp.stack([*jax.tree.leaves(moved), *eta, *jax.tree.leaves(chi), u.Phi, u.delta_e])


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_period(*arguments: Any) -> Any:
    return jax.jacfwd(step_period, (5, 6))(*arguments)

"""Matrix of the hypersonic vehicle's whole loop (plant, filter, law, inversion), in continuous time and sampled.

The matrix is computed by automatic differentiation of the flight code, at level flight of the law's vehicle model.
The plant may differ from this model.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 6-13: the loop. The sampled loop computes in the same order as in flight.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_discrete_are

from trimtab.core.integrate import rk4
from trimtab.core.record import FAST_COMPILE_OPTIONS
from trimtab.core.time import to_seconds
from trimtab.estimators.flexible.discrete import FlexibleModeFilter
from trimtab.estimators.flexible.model import RigidFlight, forcing, modal_dynamics
from trimtab.laws.path_inversion import invert_path
from trimtab.scenarios.hypersonic._internal import LevelTrim
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

PLANT = ("h", "V", "alpha", "theta", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
ESTIMATE = ("eta1 estimated", "eta1_rate estimated", "eta2 estimated", "eta2_rate estimated")
SAMPLED = (*PLANT, *ESTIMATE, "h before", "h' before", "V before", "alpha before", "q before", "Phi", "delta_e")
"""States of the sampled loop: plant, estimated modes, and the measured values and the input of the previous period."""
INTEGRALS = ("integral of h", "integral of V")
"""States that are appended to the loop, continuous or sampled, if the gain has eleven columns."""
INTEGRAL_SIZES = (1000.0, 100.0)
X, ETA, CHI, U = slice(0, 9), slice(9, 13), slice(13, 18), slice(18, 20)
PLANT_SIZES = (100.0, 20.0, 0.01, 0.01, 0.02, 0.2, 2.0, 0.2, 2.0)
SAMPLED_SIZES = np.array([*PLANT_SIZES, 0.2, 2.0, 0.2, 2.0, 100.0, 20.0, 20.0, 0.01, 0.02, 0.1, 0.05])


def sampled_loop(plant: Hypersonic, kept: FlexibleModeFilter, K: Any, at: LevelTrim) -> tuple[Any, Any]:
    """Return F (n, n) and N (n,) of the sampled loop z' = F z + N w over one period of the filter.

    The filter uses its steady-state gain, and w is the noise of the accelerometer. n is 20, or 22 with integrals.

    Args:
        plant: the simulated vehicle.
        kept: the filter; its vehicle model is also that of the law.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        at: level flight of the vehicle model.
    """
    model = _model_of_filter(kept)
    P = solve_discrete_are(np.asarray(model.Ad).T, np.asarray(model.C)[:, None], np.asarray(model.Qd), [[kept.R]])
    start = np.append(rest_state(plant, kept.craft, at), np.zeros(np.shape(K)[1] - 9))
    F, N = _differentiate_period(plant, kept, np.asarray(K, float), P, at, start, 0.0)
    return np.asarray(F), np.asarray(N)


@jax.jit
def _model_of_filter(kept: FlexibleModeFilter) -> Any:
    """Return the filter's model. It is compiled once for all settings, because a search evaluates hundreds of them."""
    return kept.model()


def rest_state(plant: Hypersonic, assumed: Hypersonic, at: LevelTrim) -> Any:
    """Return the loop's state (20,) in level flight: plant at its static bending, filter at that of its model."""
    x = plant.level_state(at.h, at.V, at.zeta[0], at.u.delta_e)
    e1, e2 = assumed.modes.static_displacements(at.zeta[0], at.u.delta_e)
    chi = [at.h, 0.0, at.V, at.zeta[0], 0.0]
    values = [*jax.tree.leaves(x), e1, 0.0, e2, 0.0, *chi, at.u.Phi, at.u.delta_e]
    return np.array([float(value) for value in values])


def step_period(plant: Any, kept: Any, K: Any, P: Any, at: Any, z: Any, w: Any) -> Any:
    """Return the loop's state (20,), or (22,) with integrals, after one period. Compute in the same order as in flight.

    Args:
        plant: the simulated vehicle.
        kept: the filter.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        P: steady covariance of the filter before an update (4, 4).
        at: desired level flight.
        z: state of the loop at the start of the period.
        w: noise of the accelerometer (rad/s^2).
    """
    x, assumed = HypersonicState(*z[X]), kept.craft
    before, held = RigidFlight(*z[CHI]), HypersonicInput(*z[U])
    chi = _measured_flight(x)
    model = kept.model()
    still = jnp.append(z[ETA], 0.0)  # the accelerometer's offset is zero, and the filter uses this value
    P = jnp.zeros((5, 5)).at[:4, :4].set(P)
    ahead, _ = kept.predict(model, still, P, before, held)
    felt = plant.coupled_accelerations(0.0, x, held)[0] + w
    eta = kept.update(model, ahead, P, chi, held, felt).x[:4]
    u = _demand_input(assumed, K, chi, eta, at, z[U.stop :])
    integrals = z[U.stop :] + to_seconds(kept.period) * _integral_rates(K, chi, at)
    after = rk4(lambda t, x: plant.dynamics(t, x, u), 0.0, x, to_seconds(kept.period))
    return jnp.stack([*jax.tree.leaves(after), *eta, *jax.tree.leaves(chi), u.Phi, u.delta_e, *integrals])


def continuous_loop(plant: Hypersonic, assumed: Hypersonic, K: Any, L: Any, at: LevelTrim) -> Any:
    """Return A (13, 13), or (15, 15) with integrals: z' = A z of plant, estimate and integrals, in level flight.

    For every plant, the loop is linearised at the level flight of the model. There, each entry of A is affine in
    1/m, in each coefficient of lift, drag, moment and thrust, and in w^2 and 2 zeta w of each mode, if all other
    parameters are constant.

    Args:
        plant: the simulated vehicle.
        assumed: the vehicle model of filter and law.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        L: gain of the filter (4, 1).
        at: level flight of the model.
    """
    start = np.append(rest_state(assumed, assumed, at)[: ETA.stop], np.zeros(np.shape(K)[1] - 9))
    return np.asarray(_differentiate_rates(plant, assumed, np.asarray(K), np.asarray(L), at, start))


def input_slope(assumed: Hypersonic, K: Any, at: LevelTrim) -> Any:
    """Return the derivative of (Phi, delta_e) by the tracking errors and the estimation errors (2, 13 or 15).

    There is one tracking error per column of K, followed by the four estimation errors of the modes.
    """
    return np.asarray(_differentiate_input(assumed, np.asarray(K), at, np.zeros(np.shape(K)[1] + 4)))


def input_at_errors(assumed: Any, K: Any, at: Any, z: Any) -> Any:
    """Return (Phi, delta_e) that the law demands. z: tracking errors, then eta - eta estimated (4,)."""
    chi = RigidFlight(at.h + z[0], z[1], at.V + z[2], at.zeta[0] + z[3], at.zeta[1] + z[4])
    u = _demand_input(assumed, K, chi, at.zeta[2:] + z[5:9] - z[-4:], at, z[9:-4])
    return jnp.stack([u.Phi, u.delta_e])


def _loop_rates(plant: Any, assumed: Any, K: Any, L: Any, at: Any, z: Any) -> Any:
    x, eta = HypersonicState(*z[X]), z[ETA]
    chi = _measured_flight(x)
    u = _demand_input(assumed, K, chi, eta, at, z[ETA.stop :])
    A, C = modal_dynamics(assumed)
    b, d, rigid = forcing(assumed, chi, u)
    felt = plant.coupled_accelerations(0.0, x, u)[0]
    rates = A @ eta + b + L[:, 0] * (felt - rigid - C @ eta - d)
    return jnp.stack([*jax.tree.leaves(plant.dynamics(0.0, x, u)), *rates, *_integral_rates(K, chi, at)])


def _measured_flight(x: HypersonicState) -> RigidFlight:
    return RigidFlight(x.h, x.V * jnp.sin(x.theta - x.alpha), x.V, x.alpha, x.q)


def _integral_rates(K: Any, chi: RigidFlight, at: Any) -> Any:
    """Return the rates of the integrals of the errors of h and V, or an empty array if the gain has no such columns."""
    return jnp.stack([chi.h - at.h, chi.V - at.V])[: K.shape[1] - 9]


def _demand_input(assumed: Any, K: Any, chi: RigidFlight, eta: Any, at: Any, integrals: Any) -> HypersonicInput:
    """Return the input that the law demands to stay in level flight."""
    have = jnp.stack([chi.h, chi.h_rate, chi.V, chi.alpha, chi.q, *eta])
    want = jnp.stack([jnp.asarray(a) for a in (at.h, 0.0, at.V, *at.zeta)])
    v = K @ jnp.concatenate([have - want, integrals])
    return invert_path(assumed, chi.h, chi.h_rate, chi.V, chi.alpha, v[0], v[1]).u


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_input(*arguments: Any) -> Any:
    return jax.jacfwd(input_at_errors, 3)(*arguments)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_period(*arguments: Any) -> Any:
    return jax.jacfwd(step_period, (5, 6))(*arguments)


@partial(jax.jit, compiler_options=FAST_COMPILE_OPTIONS)
def _differentiate_rates(*arguments: Any) -> Any:
    return jax.jacfwd(_loop_rates, 5)(*arguments)

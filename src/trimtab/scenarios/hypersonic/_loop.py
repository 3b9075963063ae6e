"""Matrix of the hypersonic vehicle's complete loop (plant, filter, law, inversion), in continuous time and sampled.

The matrix is computed by automatic differentiation of the flight code, at level flight of the law's vehicle model. The
plant, i.e. the simulated vehicle, may differ from this model.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 6-13, for the loop. The sampled loop is computed in the same order as in
flight.
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
"""Names of the sampled loop's states: states of the plant, estimated modes, and the measured values and the input of
the previous period."""
INTEGRALS = ("integral of h", "integral of V")
"""Names of the states that are appended to the continuous or sampled loop if the gain has eleven columns."""
INTEGRAL_SIZES = (1000.0, 100.0)
X, ETA, CHI, U = slice(0, 9), slice(9, 13), slice(13, 18), slice(18, 20)
PLANT_SIZES = (100.0, 20.0, 0.01, 0.01, 0.02, 0.2, 2.0, 0.2, 2.0)
SAMPLED_SIZES = np.array([*PLANT_SIZES, 0.2, 2.0, 0.2, 2.0, 100.0, 20.0, 20.0, 0.01, 0.02, 0.1, 0.05])


def sampled_loop(plant: Hypersonic, kept: FlexibleModeFilter, K: Any, at: LevelTrim) -> tuple[Any, Any]:
    """Return F (n, n) and N (n,) of the sampled loop z[k+1] = F z[k] + N w[k], where k counts periods of the filter.

    The filter uses its steady-state gain. w is the noise of the accelerometer. n is 20, or 22 with integrals.

    Args:
        plant: simulated vehicle.
        kept: filter. Its vehicle model is also that of the law.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        at: level flight of the vehicle model, about which the loop is linearised.
    """
    model = _model_of_filter(kept)
    P = solve_discrete_are(np.asarray(model.Ad).T, np.asarray(model.C)[:, None], np.asarray(model.Qd), [[kept.R]])
    start = np.append(rest_state(plant, kept.craft, at), np.zeros(np.shape(K)[1] - 9))
    F, N = _differentiate_period(plant, kept, np.asarray(K, float), P, at, start, 0.0)
    return np.asarray(F), np.asarray(N)


@jax.jit
def _model_of_filter(kept: FlexibleModeFilter) -> Any:
    """Return the filter's model. The function is compiled only once, because a search calls it with many settings."""
    return kept.model()


def rest_state(plant: Hypersonic, assumed: Hypersonic, at: LevelTrim) -> Any:
    """Return the loop's state (20,) in level flight.

    The plant has its own static bending. The filter has estimated the static bending of the model `assumed`.
    """
    x = plant.level_state(at.h, at.V, at.zeta[0], at.u.delta_e)
    e1, e2 = assumed.modes.static_displacements(at.zeta[0], at.u.delta_e)
    chi = [at.h, 0.0, at.V, at.zeta[0], 0.0]
    values = [*jax.tree.leaves(x), e1, 0.0, e2, 0.0, *chi, at.u.Phi, at.u.delta_e]
    return np.array([float(value) for value in values])


def step_period(plant: Any, kept: Any, K: Any, P: Any, at: Any, z: Any, w: Any) -> Any:
    """Return the loop's state after one period, (20,), or (22,) with integrals, computed in the same order as in
    flight.

    Args:
        plant: simulated vehicle.
        kept: filter.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        P: steady-state covariance of the filter before an update (4, 4).
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
    """Return the matrix A of the continuous loop z' = A z in level flight, (13, 13), or (15, 15) with integrals.

    z contains the states of plant, filter and integrals. The loop is linearised at the level flight of the model,
    also if the plant differs from the model. Each element of A is affine in 1/m, in each coefficient of lift, drag,
    moment and thrust, and in w^2 and 2 zeta w of each mode, if all other parameters are constant.

    Args:
        plant: simulated vehicle.
        assumed: vehicle model of filter and law.
        K: gain (2, 9), or (2, 11) with the integrals of the errors of h and V.
        L: gain of the filter (4, 1).
        at: level flight of the model.
    """
    start = np.append(rest_state(assumed, assumed, at)[: ETA.stop], np.zeros(np.shape(K)[1] - 9))
    return np.asarray(_differentiate_rates(plant, assumed, np.asarray(K), np.asarray(L), at, start))


def input_slope(assumed: Hypersonic, K: Any, at: LevelTrim) -> Any:
    """Return the derivative of the inputs (Phi, delta_e) by tracking errors and estimation errors, as a matrix.

    The shape is (2, 13), or (2, 15) if the gain matrix K has columns for the integrals of the errors of h and V. The
    first 9 or 11 columns belong to the tracking errors, in the order of the columns of K. The last four columns belong
    to the estimation errors of the modal states.
    """
    return np.asarray(_differentiate_input(assumed, np.asarray(K), at, np.zeros(np.shape(K)[1] + 4)))


def input_at_errors(assumed: Any, K: Any, at: Any, z: Any) -> Any:
    """Return the inputs (Phi, delta_e) that the law demands.

    z: tracking errors, then the estimation errors of the modes, i.e. true eta minus estimated eta (4,).
    """
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
    """Return the rates of the integrals of the errors of h and V, or an empty array for a gain K without integrals."""
    return jnp.stack([chi.h - at.h, chi.V - at.V])[: K.shape[1] - 9]


def _demand_input(assumed: Any, K: Any, chi: RigidFlight, eta: Any, at: Any, integrals: Any) -> HypersonicInput:
    """Return the input that the law demands to hold level flight.

    chi: measured flight state.  eta: estimated modes.  at: desired level flight.
    """
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

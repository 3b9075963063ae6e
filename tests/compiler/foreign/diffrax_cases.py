"""Functions of diffrax: whole solutions, single steps, and gradients through them."""

from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from compiler.foreign.case import Case, normal


def _pendulum(_t: Any, y: Any, damping: Any) -> Any:
    return jnp.array([y[1], -9.81 * jnp.sin(y[0]) - damping * y[1]])


def _van_der_pol(_t: Any, y: Any, mu: Any) -> Any:
    return jnp.array([y[1], mu * (1 - y[0] ** 2) * y[1] - y[0]])


def _solve(field: Any, solver: Any, controller: Any, **how: Any) -> Any:
    """The state after 1 s, from a state and a parameter."""

    def solution(y: Any, parameter: Any) -> Any:
        found = dfx.diffeqsolve(
            dfx.ODETerm(field), solver, 0.0, 1.0, 0.05, y, args=parameter, stepsize_controller=controller, **how
        )
        return found.ys

    return solution


FIXED, ADAPTIVE = dfx.ConstantStepSize(), dfx.PIDController(rtol=1e-6, atol=1e-8)
SAVED = dfx.SaveAt(ts=np.linspace(0, 1, 11))


def _state(rng: np.random.Generator) -> tuple[Any, ...]:
    return rng.normal(size=2), np.float64(rng.uniform(0.1, 1.0))


def _one_step(y: Any, parameter: Any) -> Any:
    """Tsit5's step alone, as an integrator inside of somebody else's loop."""
    solver, term = dfx.Tsit5(), dfx.ODETerm(_pendulum)
    state = solver.init(term, 0.0, 0.01, y, parameter)
    after, error, *_ = solver.step(term, 0.0, 0.01, y, parameter, state, False)
    return after, error


def _gradient(adjoint: Any) -> Any:
    solution = _solve(_pendulum, dfx.Tsit5(), FIXED, adjoint=adjoint)
    return jax.grad(lambda y, p: jnp.sum(solution(y, p) ** 2), argnums=(0, 1))


def _brownian(seed: Any, y: Any) -> Any:
    """Euler and Maruyama on an Ornstein-Uhlenbeck process."""
    path = dfx.VirtualBrownianTree(0.0, 1.0, tol=1e-3, shape=(2,), key=jax.random.key(seed))
    noise = dfx.ControlTerm(lambda t, y, _: 0.2 * jnp.eye(2), path)
    terms = dfx.MultiTerm(dfx.ODETerm(lambda t, y, _: -y), noise)
    return dfx.diffeqsolve(terms, dfx.Euler(), 0.0, 1.0, 0.05, y).ys


def _interpolate(ys: Any, t: Any) -> Any:
    ts = jnp.linspace(0.0, 1.0, 12)
    return dfx.CubicInterpolation(ts, dfx.backward_hermite_coefficients(ts, ys)).evaluate(t)


CASES = [
    Case("Euler, 20 steps", _solve(_pendulum, dfx.Euler(), FIXED), _state),
    Case("Tsit5, one step with error estimate", _one_step, _state, sensitive=True),
    Case("Tsit5, 20 steps", _solve(_pendulum, dfx.Tsit5(), FIXED), _state),
    Case("Tsit5, adaptive", _solve(_pendulum, dfx.Tsit5(), ADAPTIVE), _state),
    Case(
        "Dopri8, saved at 11 instants", _solve(_pendulum, dfx.Dopri8(), ADAPTIVE, saveat=SAVED), _state, sensitive=True
    ),
    Case("Kvaerno5, implicit and adaptive", _solve(_van_der_pol, dfx.Kvaerno5(), ADAPTIVE), _state),
    Case(
        "implicit Euler",
        _solve(_van_der_pol, dfx.ImplicitEuler(root_finder=optimistix.Newton(1e-8, 1e-8)), FIXED),
        _state,
    ),
    Case(
        "semi-implicit Euler",
        lambda q, p: (
            dfx.diffeqsolve(
                (dfx.ODETerm(lambda t, p, _: p), dfx.ODETerm(lambda t, q, _: -jnp.sin(q))),
                dfx.SemiImplicitEuler(),
                0.0,
                1.0,
                0.05,
                (q, p),
            ).ys
        ),
        normal((2,), (2,)),
    ),
    Case("gradient through Tsit5", _gradient(dfx.RecursiveCheckpointAdjoint()), _state),
    Case("gradient by the adjoint equation", _gradient(dfx.BacksolveAdjoint()), _state),
    Case(
        "forward derivative through Tsit5",
        jax.jacfwd(_solve(_pendulum, dfx.Tsit5(), FIXED, adjoint=dfx.ForwardMode())),
        _state,
    ),
    Case("stochastic Euler", _brownian, lambda rng: (np.uint32(rng.integers(1 << 30)), rng.normal(size=2))),
    Case("cubic interpolation", _interpolate, lambda rng: (rng.normal(size=(12, 3)), np.float64(rng.uniform(0, 1)))),
]

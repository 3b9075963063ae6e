"""Functions of optimistix, with lineax below it and optax beside it."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optax
import optimistix as optx

from compiler.foreign.case import Case, normal


def _equations(y: Any, a: Any) -> Any:
    """Kinematics of two links of length 1, minus where the hand shall be."""
    hand = jnp.array([jnp.cos(y[0]) + jnp.cos(y[0] + y[1]), jnp.sin(y[0]) + jnp.sin(y[0] + y[1])])
    return hand - a


def _reachable(rng: np.random.Generator) -> tuple[Any, ...]:
    radius, angle = rng.uniform(0.6, 1.6), rng.uniform(-0.4, 0.8)
    return (np.array([radius * np.cos(angle), radius * np.sin(angle)]),)


def _root(solver: Any) -> Any:
    return lambda a: optx.root_find(_equations, solver, jnp.array([0.1, 0.8]), a, throw=False).value


def _kepler(mean: Any, eccentricity: Any) -> Any:
    """Kepler's equation."""
    solver = optx.Newton(rtol=1e-10, atol=1e-10)
    return optx.root_find(lambda e, m: e - eccentricity * jnp.sin(e) - m, solver, mean, mean, throw=False).value


def _orbit(rng: np.random.Generator) -> tuple[Any, ...]:
    return np.float64(rng.uniform(0, 6)), np.float64(rng.uniform(0, 0.6))


def _ranges(y: Any, args: Any) -> Any:
    beacons, measured = args
    return jnp.sqrt(jnp.sum((beacons - y) ** 2, axis=1)) - measured


def _locate(solver: Any) -> Any:
    return lambda b, r: optx.least_squares(_ranges, solver, jnp.zeros(2), (b, r), throw=False).value


def _beacons(rng: np.random.Generator) -> tuple[Any, ...]:
    beacons, here = 5 * rng.normal(size=(6, 2)), rng.normal(size=2)
    return beacons, np.sqrt(((beacons - here) ** 2).sum(1)) + 0.01 * rng.normal(size=6)


def _bowl(y: Any, a: Any) -> Any:
    return jnp.sum((y - a) ** 2) + jnp.sum(jnp.cosh(0.5 * y)) + 0.3 * y[0] * y[1]


def _minimise(solver: Any, steps: int = 64) -> Any:
    return lambda a: optx.minimise(_bowl, solver, jnp.zeros(3), a, max_steps=steps, throw=False).value


def _adam(x: Any, a: Any) -> Any:
    method = optax.adam(0.1)

    def step(carried: Any, _: Any) -> Any:
        x, state = carried
        change, state = method.update(jax.grad(_bowl)(x, a), state)
        return (optax.apply_updates(x, change), state), None

    return jax.lax.scan(step, (x, method.init(x)), length=30)[0][0]


def _implicit(a: Any) -> Any:
    """Derivative of a root by what it was found for."""
    return jax.jacfwd(_root(optx.Newton(rtol=1e-10, atol=1e-10)))(a)


TIGHT: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-8}
CASES = [
    Case("Newton on two links", _root(optx.Newton(**TIGHT)), _reachable),
    Case("Newton on Kepler's equation", _kepler, _orbit),
    Case("Dogleg on two links", _root(optx.Dogleg(**TIGHT)), _reachable),
    Case(
        "bisection",
        lambda a: (
            optx.root_find(
                lambda y, a: y**3 + y - a,
                optx.Bisection(**TIGHT),
                0.0,
                a,
                options={"lower": -5, "upper": 5},
                throw=False,
            ).value
        ),
        normal(()),
    ),
    Case(
        "fixed point",
        lambda a: (
            optx.fixed_point(
                lambda y, a: jnp.tanh(0.5 * y + a), optx.FixedPointIteration(**TIGHT), jnp.zeros(3), a, throw=False
            ).value
        ),
        normal((3,)),
    ),
    Case("derivative of a root", _implicit, _reachable),
    Case("position from ranges, Gauss-Newton", _locate(optx.GaussNewton(**TIGHT)), _beacons),
    Case(
        "position from ranges, Levenberg-Marquardt", _locate(optx.LevenbergMarquardt(**TIGHT)), _beacons, sensitive=True
    ),
    Case("BFGS", _minimise(optx.BFGS(**TIGHT)), normal((3,)), sensitive=True),
    Case("nonlinear conjugate gradients", _minimise(optx.NonlinearCG(**TIGHT)), normal((3,)), sensitive=True),
    Case("Nelder-Mead", _minimise(optx.NelderMead(1e-4, 1e-4), 40), normal((3,))),
    Case(
        "lineax: least squares",
        lambda a, b: lx.linear_solve(lx.MatrixLinearOperator(a), b, lx.QR(), throw=False).value,
        normal((8, 3), (8,)),
    ),
    Case(
        "lineax: tridiagonal equations",
        lambda d, l, u, b: lx.linear_solve(lx.TridiagonalLinearOperator(d + 4, l, u), b, throw=False).value,
        normal((20,), (19,), (19,), (20,)),
    ),
    Case(
        "lineax: automatic choice of the solver",
        lambda a, b: lx.linear_solve(lx.MatrixLinearOperator(a), b).value,
        normal((5, 5), (5,)),
    ),
    Case("optax: 30 steps of Adam", _adam, normal((3,), (3,))),
]

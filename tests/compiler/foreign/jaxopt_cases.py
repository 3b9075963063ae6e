"""Functions of jaxopt: solvers in loops, and projections."""

from typing import Any

import jax
import jax.numpy as jnp
import jaxopt
import numpy as np

from compiler.foreign.case import Case, normal


def _cost(x: Any, a: Any) -> Any:
    """Smooth and convex."""
    return jnp.sum(jnp.logaddexp(a @ x, -(a @ x))) + 0.5 * jnp.sum((x - 1) ** 2)


def _residual(x: Any, t: Any, y: Any) -> Any:
    """Of an exponential fitted to samples."""
    return x[0] * jnp.exp(-x[1] * t) + x[2] - y


def _decay(rng: np.random.Generator) -> tuple[Any, ...]:
    t = np.linspace(0, 4, 20)
    return np.array([1.0, 0.5, 0.0]), t, 2 * np.exp(-0.8 * t) + 0.3 + 0.02 * rng.normal(size=20)


def _quadratic_program(rng: np.random.Generator) -> tuple[Any, ...]:
    """Of model predictive control's size: 6 unknowns, 2 equations, 8 inequalities."""
    q = rng.normal(size=(6, 6))
    return q @ q.T + np.eye(6), rng.normal(size=6), rng.normal(size=(2, 6)), rng.normal(size=2), rng.normal(size=(8, 6))


def _osqp(q: Any, c: Any, a: Any, b: Any, g: Any) -> Any:
    solver = jaxopt.OSQP(maxiter=200, tol=1e-4)
    return solver.run(params_obj=(q, c), params_eq=(a, b), params_ineq=(g, 2.0 * jnp.ones(8))).params.primal


def _equality(q: Any, c: Any, a: Any, b: Any, _: Any) -> Any:
    return jaxopt.EqualityConstrainedQP().run(params_obj=(q, c), params_eq=(a, b)).params.primal


def _box(q: Any, c: Any, _a: Any, _b: Any, _g: Any) -> Any:
    return (
        jaxopt.BoxCDQP(maxiter=30).run(jnp.zeros(6), params_obj=(q, c), params_ineq=(-jnp.ones(6), jnp.ones(6))).params
    )


def _implicit(a: Any) -> Any:
    """Gradient through a solver, by the implicit function theorem."""

    def cost(a: Any) -> Any:
        solver = jaxopt.GradientDescent(_cost, maxiter=100, tol=1e-10, implicit_diff=True)
        return jnp.sum(solver.run(jnp.zeros(3), a).params ** 2)

    return jax.grad(cost)(a)


def _minimise(solver: Any) -> Any:
    return lambda x, a: solver.run(x, a).params


CASES = [
    Case("gradient descent", _minimise(jaxopt.GradientDescent(_cost, maxiter=50)), normal((4,), (6, 4))),
    Case("BFGS", _minimise(jaxopt.BFGS(_cost, maxiter=20)), normal((4,), (6, 4))),
    Case("L-BFGS", _minimise(jaxopt.LBFGS(_cost, maxiter=20)), normal((4,), (6, 4))),
    Case(
        "nonlinear conjugate gradients",
        _minimise(jaxopt.NonlinearCG(_cost, maxiter=20)),
        normal((4,), (6, 4)),
        sensitive=True,
    ),
    Case("Gauss-Newton", lambda x, t, y: jaxopt.GaussNewton(_residual, maxiter=10).run(x, t=t, y=y).params, _decay),
    Case(
        "Levenberg-Marquardt",
        lambda x, t, y: jaxopt.LevenbergMarquardt(_residual, maxiter=20).run(x, t=t, y=y).params,
        _decay,
    ),
    Case(
        "projected gradient on a box",
        lambda x, a: (
            jaxopt.ProjectedGradient(_cost, jaxopt.projection.projection_box, maxiter=30)
            .run(x, (-jnp.ones(4), jnp.ones(4)), a)
            .params
        ),
        normal((4,), (6, 4)),
    ),
    Case("OSQP", _osqp, _quadratic_program),
    Case("equality-constrained QP", _equality, _quadratic_program),
    Case("box-constrained QP", _box, _quadratic_program),
    Case(
        "bisection",
        lambda a: (
            jaxopt.Bisection(lambda x, a: x**3 + x - a, -10.0, 10.0, maxiter=50, check_bracket=False)
            .run(None, a)
            .params
        ),
        normal(()),
    ),
    Case(
        "fixed point with Anderson acceleration",
        lambda a: (
            jaxopt.AndersonAcceleration(lambda x, a: jnp.cos(x) + 0.1 * a, maxiter=20).run(jnp.zeros(3), a).params
        ),
        normal((3,)),
    ),
    Case("projection to the simplex", jaxopt.projection.projection_simplex, normal((10,))),
    Case("gradient through a solver", _implicit, normal((5, 3)), sensitive=True),
]

"""Functions of jaxlie: rotations and poses."""

from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
from jaxlie import SE2, SE3, SO2, SO3

from compiler.foreign.case import Case, normal


def _pose_error(log_a: Any, log_b: Any) -> Any:
    """What a pose graph sums the squares of."""
    return (SE3.exp(log_a).inverse() @ SE3.exp(log_b)).log()


def _register_points(log_start: Any, points: Any, seen: Any) -> Any:
    """Gauss and Newton's step on a pose, from points and where they were seen."""
    start = SE3.exp(log_start)

    def residual(step: Any) -> Any:
        return (jax.vmap((start @ SE3.exp(step)).apply)(points) - seen).ravel()

    r, jacobian = residual(jnp.zeros(6)), jax.jacfwd(residual)(jnp.zeros(6))
    return (start @ SE3.exp(-jnp.linalg.solve(jacobian.T @ jacobian, jacobian.T @ r))).wxyz_xyz


def _attitude_gradient(log_a: Any, log_b: Any) -> Any:
    """On the manifold, of the squared angle between two attitudes."""
    return jaxlie.manifold.grad(lambda a: jnp.sum((a.inverse() @ SO3.exp(log_b)).log() ** 2))(SO3.exp(log_a))


def _interpolate(log_a: Any, log_b: Any, at: Any) -> Any:
    return jaxlie.manifold.rplus(SE3.exp(log_a), at * jaxlie.manifold.rminus(SE3.exp(log_a), SE3.exp(log_b))).wxyz_xyz


CASES = [
    Case(
        "SO2 angle of a product", lambda a, b: (SO2.from_radians(a) @ SO2.from_radians(b)).as_radians(), normal((), ())
    ),
    Case("SE2 exp and log", lambda x, y: (SE2.exp(x) @ SE2.exp(y)).log(), normal((3,), (3,))),
    Case("SO3 exp to matrix", lambda w: SO3.exp(w).as_matrix(), normal((3,))),
    Case("SO3 log of a matrix", lambda w: SO3.from_matrix(SO3.exp(w).as_matrix()).log(), normal((3,))),
    Case("SO3 roll, pitch, yaw", lambda w: tuple(SO3.exp(w).as_rpy_radians()), normal((3,))),
    Case("SO3 applied to 20 points", lambda w, p: jax.vmap(SO3.exp(w).apply)(p), normal((3,), (20, 3))),
    Case("SE3 exp", lambda x: SE3.exp(x).wxyz_xyz, normal((6,))),
    Case("SE3 adjoint", lambda x: SE3.exp(x).adjoint(), normal((6,))),
    Case("SE3 error between two poses", _pose_error, normal((6,), (6,))),
    Case("Jacobians of the SE3 error", jax.jacfwd(_pose_error, argnums=(0, 1)), normal((6,), (6,))),
    Case("SE3 interpolation", _interpolate, normal((6,), (6,), ())),
    Case("SE3 fitted to 10 points", _register_points, normal((6,), (10, 3), (10, 3))),
    Case("gradient of a function on SO3", _attitude_gradient, normal((3,), (3,))),
]

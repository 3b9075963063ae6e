"""What people of control and estimation write themselves in plain jax.numpy."""

from typing import Any

import interpax
import jax
import jax.numpy as jnp
import numpy as np

from compiler.foreign.case import Case, normal


def _kalman(x: Any, p: Any, z: Any) -> Any:
    """Constant velocity in the plane, seen in range and bearing: Joseph's form."""
    f = jnp.eye(4) + 0.1 * jnp.eye(4, k=2)

    def seen(x: Any) -> Any:
        return jnp.array([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])

    x, p = f @ x, f @ p @ f.T + 0.01 * jnp.eye(4)
    h, r = jax.jacfwd(seen)(x), jnp.diag(jnp.array([0.1, 0.01]))
    gain = jnp.linalg.solve(h @ p @ h.T + r, h @ p).T
    keep = jnp.eye(4) - gain @ h
    return x + gain @ (z - seen(x)), keep @ p @ keep.T + gain @ r @ gain.T


def _covariance(rng: np.random.Generator) -> tuple[Any, ...]:
    a = rng.normal(size=(4, 4))
    return 3 + rng.normal(size=4), a @ a.T + np.eye(4), np.array([4.0, 0.7]) + 0.1 * rng.normal(size=2)


def _unscented(x: Any, p: Any, _z: Any) -> Any:
    """Mean and covariance through polar coordinates."""
    n, spread = 4, 1.0
    root = jnp.linalg.cholesky((n + spread) * p)
    points = jnp.concatenate([x[None], x + root.T, x - root.T])
    weights = jnp.full(2 * n + 1, 0.5 / (n + spread)).at[0].set(spread / (n + spread))
    seen = jax.vmap(lambda x: jnp.array([jnp.sqrt(x[0] ** 2 + x[1] ** 2), jnp.arctan2(x[1], x[0])]))(points)
    mean = weights @ seen
    return mean, (weights[:, None] * (seen - mean)).T @ (seen - mean)


def _quadrotor(x: Any, u: Any) -> Any:
    """Position, velocity, attitude (quaternion), rates; thrust and torques."""
    v, q, w = x[3:6], x[6:10], x[10:13]
    a, b, c, d = q / jnp.linalg.norm(q)
    up = jnp.array([2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c)])
    inertia = jnp.array([0.01, 0.012, 0.02])
    turn = 0.5 * jnp.array(
        [
            -b * w[0] - c * w[1] - d * w[2],
            a * w[0] + c * w[2] - d * w[1],
            a * w[1] - b * w[2] + d * w[0],
            a * w[2] + b * w[1] - c * w[0],
        ]
    )
    return jnp.concatenate(
        [v, u[0] * up - jnp.array([0, 0, 9.81]) - 0.1 * v, turn, (u[1:] - jnp.cross(w, inertia * w)) / inertia]
    )


def _runge_kutta(x: Any, u: Any, dt: float = 0.01) -> Any:
    k1 = _quadrotor(x, u)
    k2 = _quadrotor(x + dt / 2 * k1, u)
    k3 = _quadrotor(x + dt / 2 * k2, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + _quadrotor(x + dt * k3, u))


def _flight(rng: np.random.Generator) -> tuple[Any, ...]:
    return rng.normal(size=13), np.array([9.81, 0.0, 0.0, 0.0]) + 0.01 * rng.normal(size=4)


def _regulator(a: Any, b: Any) -> Any:
    """Gain of the linear-quadratic regulator: 50 steps of Riccati's recursion."""

    def step(p: Any, _: Any) -> Any:
        k = jnp.linalg.solve(jnp.eye(2) + b.T @ p @ b, b.T @ p @ a)
        return jnp.eye(4) + a.T @ p @ (a - b @ k), None

    p, _ = jax.lax.scan(step, jnp.eye(4), length=50)
    return jnp.linalg.solve(jnp.eye(2) + b.T @ p @ b, b.T @ p @ a)


def _double_integrator(rng: np.random.Generator) -> tuple[Any, ...]:
    a = np.eye(4) + 0.1 * np.eye(4, k=2) + 0.02 * rng.normal(size=(4, 4))
    return a, np.vstack([0.005 * np.eye(2), 0.1 * np.eye(2)])


def _predictive(x: Any) -> Any:
    """Gradient of a pendulum's cost over 20 steps in its torques."""

    def cost(torques: Any) -> Any:
        def step(x: Any, u: Any) -> Any:
            x = x + 0.05 * jnp.array([x[1], 9.81 * jnp.sin(x[0]) + u])
            return x, jnp.sum(x**2) + 0.1 * u**2

        return jnp.sum(jax.lax.scan(step, x, torques)[1])

    def descend(torques: Any, _: Any) -> Any:
        return torques - 0.01 * jax.grad(cost)(torques), None

    return jax.lax.scan(descend, jnp.zeros(20), length=10)[0]


def _pid_loop(x: Any, gains: Any) -> Any:
    """A mass on a spring held by a PID law with anti-windup, 200 steps."""

    def step(carried: Any, _: Any) -> Any:
        x, v, total = carried
        wanted = gains[0] * (1 - x) + gains[1] * total - gains[2] * v
        u = jnp.clip(wanted, -5.0, 5.0)
        total = total + jnp.where(wanted == u, 0.01 * (1 - x), 0.0)
        v = v + 0.01 * (u - x)
        return (x + 0.01 * v, v, total), x

    return jax.lax.scan(step, (x[0], x[1], 0.0), length=200)[1]


def _align(p: Any, q: Any) -> Any:
    """Kabsch: the rotation from one cloud of points to another."""
    u, _, vt = jnp.linalg.svd((p - p.mean(0)).T @ (q - q.mean(0)))
    sign = jnp.linalg.det(u @ vt)
    return u @ jnp.diag(jnp.array([1.0, 1.0, 1.0]).at[2].set(sign)) @ vt


def _gaussian_process(x: Any, y: Any, at: Any) -> Any:
    def kernel(a: Any, b: Any) -> Any:
        return jnp.exp(-0.5 * (a[:, None] - b) ** 2)

    root = jnp.linalg.cholesky(kernel(x, x) + 0.1 * jnp.eye(15))
    v = jax.scipy.linalg.solve_triangular(root, kernel(x, at), lower=True)
    return v.T @ jax.scipy.linalg.solve_triangular(root, y, lower=True), 1 - jnp.sum(v * v, axis=0)


def _resample(seed: Any, weights: Any, particles: Any) -> Any:
    at = (jax.random.uniform(jax.random.key(seed)) + jnp.arange(100)) / 100
    chosen = jnp.searchsorted(jnp.cumsum(weights) / jnp.sum(weights), at)
    return particles[jnp.clip(chosen, 0, 99)]


def _frequency_response(omega: Any, a: Any) -> Any:
    """Decibels and phase of c (i omega - A)^-1 b."""
    s = 1j * omega[:, None, None] * jnp.eye(2)
    h = jnp.linalg.solve(s - a, jnp.ones((omega.shape[0], 2, 1)))[:, 0, 0]
    return 20 * jnp.log10(jnp.abs(h)), jnp.angle(h)


def _particles(rng: np.random.Generator) -> tuple[Any, ...]:
    return np.uint32(rng.integers(1 << 30)), rng.uniform(size=100), rng.normal(size=(100, 3))


CASES = [
    Case("extended Kalman filter", _kalman, _covariance),
    Case("unscented transform", _unscented, _covariance),
    Case("quadrotor, Runge-Kutta step", _runge_kutta, _flight),
    Case("quadrotor, linearisation", jax.jacfwd(_runge_kutta, argnums=(0, 1)), _flight),
    Case("linear-quadratic regulator", _regulator, _double_integrator),
    Case("predictive control by gradients", _predictive, normal((2,))),
    Case("PID loop of 200 steps", _pid_loop, lambda rng: (rng.normal(size=2), np.array([4.0, 1.0, 2.0]))),
    Case("rotation between two point sets (Kabsch)", _align, normal((10, 3), (10, 3))),
    Case("Gaussian process of 15 points", _gaussian_process, normal((15,), (15,), (5,))),
    Case("resampling of 100 particles", _resample, _particles),
    Case(
        "frequency response",
        _frequency_response,
        lambda rng: (np.logspace(-1, 1, 10), rng.normal(size=(2, 2)) - 2 * np.eye(2)),
        refused="complex128",
    ),
    Case(
        "interpax: cubic spline",
        lambda x, f: interpax.interp1d(x, jnp.linspace(0, 1, 12), f, method="cubic2"),
        lambda rng: (rng.uniform(0, 1, 20), rng.normal(size=12)),
    ),
    Case(
        "interpax: bilinear table",
        lambda x, y, f: interpax.interp2d(x, y, jnp.linspace(0, 1, 8), jnp.linspace(0, 1, 9), f, method="linear"),
        lambda rng: (rng.uniform(0, 1, 20), rng.uniform(0, 1, 20), rng.normal(size=(8, 9))),
    ),
    Case(
        "running median of 5 samples",
        lambda x: jnp.median(jnp.stack([jnp.roll(x, k) for k in range(5)]), axis=0),
        normal((60,)),
    ),
    Case("polynomial fit", lambda x, y: jnp.polyfit(x, y, 3), normal((20,), (20,))),
    Case(
        "roots of a polynomial",
        lambda c: jnp.sort(jnp.abs(jnp.roots(c, strip_zeros=False))),
        normal((5,)),
        refused="eig",
    ),
    Case("histogram", lambda x: jnp.histogram(x, bins=10, range=(-3, 3))[0], normal((200,))),
]

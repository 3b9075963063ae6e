"""Functions of tests/compiler/foreign, written by hand in CasADi as its users would: with SX, and with folds of SX.

CasADi generates C for each function. It is compiled with gcc -O3 -march=native and called through FunctionBuffer.
"""

import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import jax
import numpy as np


def _skew(w: Any) -> Any:
    return ca.skew(w)


def _flat(*results: Any) -> Any:
    """Return all results in one column, row by row."""
    return ca.vertcat(*(ca.vec(r.T) if r.shape[1] > 1 else r for r in map(ca.SX, results)))


def _quaternion(w: Any) -> Any:
    angle = ca.sqrt(ca.dot(w, w))
    return ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * w)


def _rotation(q: Any) -> Any:
    w, x, y, z = ca.vertsplit(q)
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _product(p: Any, q: Any) -> Any:
    a, v, b, w = p[0], p[1:], q[0], q[1:]
    return ca.vertcat(a * b - ca.dot(v, w), a * w + b * v + ca.cross(v, w))


def _pose(x: Any) -> tuple[Any, Any]:
    """Return attitude and position of the exponential map on SE(3)."""
    w = x[3:]
    n2 = ca.dot(w, w)
    n = ca.sqrt(n2)
    K = _skew(w)
    V = ca.SX.eye(3) + (1 - ca.cos(n)) / n2 * K + (n - ca.sin(n)) / (n2 * n) * K @ K
    return _quaternion(w), V @ x[:3]


def _log_pose(q: Any, p: Any) -> Any:
    n = ca.sqrt(ca.dot(q[1:], q[1:]))
    # the shorter rotation
    angle = 2 * ca.if_else(q[0] < 0, ca.atan2(-n, -q[0]), ca.atan2(n, q[0]))
    w = angle / n * q[1:]
    K = _skew(w)
    n2 = ca.dot(w, w)
    size = ca.sqrt(n2)
    half = size / 2
    inverse = ca.SX.eye(3) - K / 2 + (1 - half * ca.cos(half) / ca.sin(half)) / n2 * K @ K
    return ca.vertcat(inverse @ p, w)


def _pose_error(a: Any, b: Any) -> Any:
    (qa, pa), (qb, pb) = _pose(a), _pose(b)
    back = ca.vertcat(qa[0], -qa[1:])
    return _log_pose(_product(back, qb), _rotation(qa).T @ (pb - pa))


def _pose_error_jacobians(a: Any, b: Any) -> Any:
    error = _pose_error(a, b)
    return _flat(ca.jacobian(error, a), ca.jacobian(error, b))


def _unit(q: Any) -> Any:
    return q / ca.sqrt(ca.dot(q, q))


def _kalman(x: Any, p: Any, z: Any) -> Any:
    f = np.eye(4) + 0.1 * np.eye(4, k=2)
    x, p = f @ x, f @ p @ f.T + 0.01 * np.eye(4)
    s = ca.SX.sym("s", 4)
    seen = ca.Function("seen", [s], [ca.vertcat(ca.sqrt(s[0] ** 2 + s[1] ** 2), ca.atan2(s[1], s[0]))])
    H = ca.Function("H", [s], [ca.jacobian(seen(s), s)])(x)
    R = np.diag([0.1, 0.01])
    gain = ca.solve(H @ p @ H.T + R, H @ p).T
    keep = ca.SX.eye(4) - gain @ H
    return _flat(x + gain @ (z - seen(x)), keep @ p @ keep.T + gain @ R @ gain.T)


def _quadrotor(x: Any, u: Any) -> Any:
    v, w = x[3:6], x[10:13]
    q = _unit(x[6:10])
    a, b, c, d = ca.vertsplit(q)
    up = ca.vertcat(2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c))
    inertia = ca.DM([0.01, 0.012, 0.02])
    turn = 0.5 * _product(q, ca.vertcat(0, w))
    spin = (u[1:] - ca.cross(w, inertia * w)) / inertia
    return ca.vertcat(v, u[0] * up - ca.DM([0, 0, 9.81]) - 0.1 * v, turn, spin)


def _runge_kutta(x: Any, u: Any) -> Any:
    dt = 0.01
    k1 = _quadrotor(x, u)
    k2 = _quadrotor(x + dt / 2 * k1, u)
    k3 = _quadrotor(x + dt / 2 * k2, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + _quadrotor(x + dt * k3, u))


def _linearisation(x: Any, u: Any) -> Any:
    y = _runge_kutta(x, u)
    return _flat(ca.jacobian(y, x), ca.jacobian(y, u))


def _fold(step: Callable[..., Any], size: int, others: list[Any], count: int) -> Any:
    """Return a function of the state and other arguments that repeats a step."""
    state, symbols = ca.SX.sym("state", size), [ca.SX.sym(f"o{i}", *o.shape) for i, o in enumerate(others)]
    return ca.Function("step", [state, *symbols], [step(state, *symbols)]).fold(count)


def _regulator(a: Any, b: Any) -> Any:
    def gain(p: Any, a: Any, b: Any) -> Any:
        return ca.solve(ca.SX.eye(2) + b.T @ p @ b, b.T @ p @ a)

    def step(p: Any, a: Any, b: Any) -> Any:
        p = ca.reshape(p, 4, 4)
        return ca.vec(ca.SX.eye(4) + a.T @ p @ (a - b @ gain(p, a, b)))

    a_, b_, p = ca.SX.sym("a", 4, 4), ca.SX.sym("b", 4, 2), ca.SX.sym("p", 16)
    last = ca.Function("gain", [p, a_, b_], [_flat(gain(ca.reshape(p, 4, 4), a_, b_))])
    repeated = _fold(step, 16, [a_, b_], 50)
    return last(repeated(ca.vec(ca.DM.eye(4)), ca.repmat(a, 1, 50), ca.repmat(b, 1, 50)), a, b)


def _pid_loop(x: Any, gains: Any) -> Any:
    state, g = ca.SX.sym("state", 3), ca.SX.sym("g", 3)
    place, v, total = ca.vertsplit(state)
    wanted = g[0] * (1 - place) + g[1] * total - g[2] * v
    u = ca.fmin(ca.fmax(wanted, -5.0), 5.0)
    total = total + ca.if_else(wanted == u, 0.01 * (1 - place), 0.0)
    v = v + 0.01 * (u - place)
    step = ca.Function("step", [state, g], [ca.vertcat(place + 0.01 * v, v, total), place])
    path = step.mapaccum("path", 200)(ca.vertcat(x, 0.0), ca.repmat(gains, 1, 200))[1]
    return path.T


def _pendulum(y: Any, damping: Any) -> Any:
    return ca.vertcat(y[1], -9.81 * ca.sin(y[0]) - damping * y[1])


def _euler(y: Any, damping: Any) -> Any:
    return _fold(lambda y, c: y + 0.05 * _pendulum(y, c), 2, [damping], 20)(y, ca.repmat(damping, 1, 20))


def _tsit5(y: Any, damping: Any) -> Any:
    from diffrax import Tsit5

    tableau = Tsit5.tableau

    def step(y: Any, c: Any) -> Any:
        slopes = [_pendulum(y, c)]
        for row in tableau.a_lower[: len(tableau.b_sol) - 2]:
            inner = y + 0.05 * sum(float(a) * k for a, k in zip(row, slopes, strict=True))
            slopes.append(_pendulum(inner, c))
        return y + 0.05 * sum(float(b) * k for b, k in zip(tableau.b_sol, slopes, strict=False))

    return _fold(step, 2, [damping], 20)(y, ca.repmat(damping, 1, 20))


def _network(name: str, activation: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def evaluate(x: Any) -> Any:
        from compiler.foreign import equinox_cases

        layers = getattr(equinox_cases, name).layers
        for i, layer in enumerate(layers):
            x = ca.DM(np.asarray(layer.weight)) @ x + ca.DM(np.asarray(layer.bias))
            x = activation(x) if i + 1 < len(layers) else x
        return x

    return evaluate


def _network_jacobian(x: Any) -> Any:
    return _flat(ca.jacobian(_network("SMALL", lambda x: ca.fmax(x, 0))(x), x))


TWINS: dict[tuple[str, str], tuple[Callable[..., Any], Any]] = {
    ("jaxlie", "SO3 exp to matrix"): (lambda w: _flat(_rotation(_quaternion(w))), ca.SX),
    ("jaxlie", "SE3 exp"): (lambda x: _flat(*_pose(x)), ca.SX),
    ("jaxlie", "SE3 error between two poses"): (_pose_error, ca.SX),
    ("jaxlie", "Jacobians of the SE3 error"): (_pose_error_jacobians, ca.SX),
    ("brax", "vector rotated by a quaternion"): (lambda v, q: _rotation(_unit(q)) @ v, ca.SX),
    ("brax", "product of quaternions"): (_product, ca.SX),
    ("equinox", "MLP 12-64-64-4"): (_network("POLICY", ca.tanh), ca.MX),
    ("equinox", "Jacobian of an MLP"): (_network_jacobian, ca.SX),
    ("diffrax", "Euler, 20 steps"): (_euler, ca.MX),
    ("diffrax", "Tsit5, 20 steps"): (_tsit5, ca.MX),
    ("jax_scipy", "linear equations, 6 by 6"): (lambda a, b: ca.solve(a, b), ca.SX),
    ("jax_scipy", "inverse of a 5 by 5 matrix"): (lambda a: _flat(ca.inv(a)), ca.SX),
    ("own", "extended Kalman filter"): (_kalman, ca.SX),
    ("own", "quadrotor, Runge-Kutta step"): (_runge_kutta, ca.SX),
    ("own", "quadrotor, linearisation"): (_linearisation, ca.SX),
    ("own", "linear-quadratic regulator"): (_regulator, ca.MX),
    ("own", "PID loop of 200 steps"): (_pid_loop, ca.MX),
}
"""(Library, name) -> function, and CasADi's kind of symbols in which it is written."""


def twin(library: str, name: str, runs: list[tuple[Any, ...]]) -> Callable[[int], Any] | None:
    """Return CasADi's function of the number of a run, with results in one array, or None if it is not in TWINS."""
    if (library, name) not in TWINS:
        return None
    function, kind = TWINS[library, name]
    arrays = [[np.asarray(x, float) for x in jax.tree.leaves(r)] for r in runs]
    symbols = [kind.sym(f"x{i}", *(x.shape or (1,))) for i, x in enumerate(arrays[0])]
    compiled = _compile(ca.Function("twin", symbols, [ca.densify(function(*symbols))]))
    buffer, trigger = compiled.buffer()
    found = np.zeros(compiled.size1_out(0))
    buffer.set_res(0, memoryview(found))
    given = [[memoryview(np.ravel(x, "F").copy()) for x in row] for row in arrays]

    def call(k: int) -> Any:
        for i, x in enumerate(given[k]):
            buffer.set_arg(i, x)
        trigger()
        return found

    call.kept = compiled, given  # pyright: ignore[reportFunctionMemberAccess]
    return call


def _compile(function: Any) -> Any:
    folder = Path(tempfile.mkdtemp())
    here = Path.cwd()
    os.chdir(folder)  # CasADi writes files to the current folder
    try:
        function.generate("twin.c")
        subprocess.run(["gcc", "-O3", "-march=native", "-shared", "-fPIC", "twin.c", "-o", "twin.so"], check=True)
    finally:
        os.chdir(here)
    return ca.external("twin", str(folder / "twin.so"))

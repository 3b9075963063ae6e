"""Time programs whose arrays are larger than those of a flight, and compare them with `jax.jit`.

The programs are a neural network in a loop (also compared with C written by hand), filters of 24 and 64 states (run one
by one, and in lanes), and ring buffers of two sizes, which must take the same time.

    python benchmarks/arrays.py
"""

import argparse
import ctypes
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from paired import Ratio, load, machine, row

import trimtab

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "reference"))
from references import CC, sh

jax.config.update("jax_enable_x64", True)

COMMAND = "python benchmarks/arrays.py"
ROUNDS, LEAST = 15, 5e-3
STATES, MEASURED, RUNS = (24, 64), 8, 64
SLOTS, TURNS = (64, 2048), 20_000
INERTIA = np.array([0.011, 0.012, 0.021])
MASS, G, ARM, DRAG, DT = 1.2, 9.81, 0.18, 0.02, 0.002


def quadrotor(x, w1, b1, w2, b2, w3, b3):
    """Return the result of 500 steps of reference/quadrotor.c. Weights have the shape (out, in)."""

    def step(x, _):
        p, v, q, w = x[:3], x[3:6], x[6:10], x[10:]
        h = jnp.tanh(w1 @ jnp.concatenate([p, v, q[1:], w]) + b1)
        f = MASS * G / 4 * (1 + 0.5 * jnp.tanh(w3 @ jnp.tanh(w2 @ h + b2) + b3))
        torque = jnp.array([ARM * (f[1] - f[3]), ARM * (f[2] - f[0]), DRAG * (f[0] - f[1] + f[2] - f[3])])
        up = [2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]), 1 - 2 * (q[1] ** 2 + q[2] ** 2)]
        v = v + DT * (jnp.sum(f) / MASS * jnp.array(up) - jnp.array([0, 0, G]))
        p = p + DT * v
        w = w + DT * (torque - jnp.cross(w, INERTIA * w)) / INERTIA
        spin = jnp.concatenate([-(q[1:] @ w)[None], q[0] * w + jnp.cross(q[1:], w)])
        q = q + 0.5 * DT * spin
        return jnp.concatenate([p, v, q / jnp.sqrt(q @ q), w]), None

    return lax.scan(step, x, None, length=500)[0]


def kalman(P, F, H, R):
    """Return a filter's covariance after a prediction and a measurement update."""
    P = F @ P @ F.T + 0.01 * jnp.eye(len(P))
    S = H @ P @ H.T + R @ R.T + jnp.eye(len(R))
    K = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(S), True), H @ P).T
    return P - K @ S @ K.T


def ring(slots, numbers):
    """Write each positive number to a ring buffer and read another one. The write is a select of two whole buffers."""

    def turn(carried, x):
        slots, i = carried
        n = slots.shape[0]
        slots = jnp.where(x > 0, slots.at[i].set(x), slots)
        return (slots, (i + 1) % n), slots[(i + 3) % n]

    return jnp.sum(lax.scan(turn, (slots, jnp.int32(0)), numbers)[1])


def hand_written(folder):
    """Return the quadrotor in C as a function of numpy arrays. Weights have the shape (in, out)."""
    library = f"{folder}/quadrotor.so"
    source = str(HERE / "reference" / "quadrotor.c")
    sh(CC, "-O3", "-march=native", "-shared", "-fPIC", "-o", library, source, "-lm")
    function = ctypes.CDLL(library).quadrotor

    def call(*arrays):
        out = np.empty(13)
        function(*(ctypes.c_void_p(a.ctypes.data) for a in (*arrays, out)))
        return out

    return call


def times(calls):
    """Return name -> times of one call (s), one per round. In a round, each function is called for LEAST seconds."""
    turns = {}
    for name, call in calls.items():
        call()
        began = time.perf_counter()
        call()
        turns[name] = max(1, int(LEAST / (time.perf_counter() - began)))
    took = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            began = time.perf_counter()
            for _ in range(turns[name]):
                call()
            took[name].append((time.perf_counter() - began) / turns[name])
    return took


def compare(over, under):
    """Return the ratio of two programs' times, computed round by round."""
    ratios = np.divide(over, under)
    return Ratio(float(np.median(ratios)), float(ratios.min()), float(ratios.max()))


def jitted(function, *arguments):
    """Return a function that calls jax.jit on arrays that are already on its device."""
    call, given = jax.jit(function), [jax.device_put(a) for a in arguments]
    return lambda: call(*given).block_until_ready()


def check(name, result, wanted):
    """Exit with an error if numbers differ by more than rounding."""
    apart = float(np.max(np.abs(np.asarray(result) - np.asarray(wanted))))
    if not apart <= 1e-11 * max(1.0, float(np.max(np.abs(wanted)))):
        sys.exit(f"{name}: differs by {apart:.1e}")


def fly_quadrotor(folder):
    rng = np.random.default_rng(0)
    shapes = [(64, 12), (64,), (64, 64), (64,), (4, 64), (4,)]
    weights = [0.3 * rng.normal(size=s) / s[-1] ** 0.5 for s in shapes]
    x = np.array([0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0.1, -0.2, 0.3])
    turned = [np.ascontiguousarray(w.T) for w in weights]
    hand, compiled = hand_written(folder), trimtab.compile(lambda x: quadrotor(x, *weights), x)
    given = trimtab.compile(quadrotor, x, *weights)
    for name, result in (("weights known", compiled(x)), ("weights given", given(x, *weights))):
        check(f"quadrotor, {name}", result, hand(x, *turned))
    took = times(
        {
            "hand-written C": lambda: hand(x, *turned),
            "trimtab": lambda: compiled(x),
            "weights given": lambda: given(x, *weights),
            "jax.jit": jitted(lambda x: quadrotor(x, *weights), x),
        }
    )
    named = "quadrotor with a 64-64 neural network, 500 steps"
    return took, [
        (
            f"{named}: time of trimtab C / time of hand-written C",
            compare(took["trimtab"], took["hand-written C"]),
            "≤ 1.2",
        ),
        (f"{named}: time of jax.jit / time of trimtab C", compare(took["jax.jit"], took["trimtab"]), "≥ 1"),
        (
            f"{named}, weights as arguments: time of trimtab C / time of hand-written C",
            compare(took["weights given"], took["hand-written C"]),
            "",
        ),
    ]


def filter_states(n):
    rng = np.random.default_rng(n)
    P, F, H, R = (rng.normal(size=s) / s[1] ** 0.5 for s in ((n, n), (n, n), (MEASURED, n), (MEASURED, MEASURED)))
    P = P @ P.T
    alone, side_by_side = (trimtab.compile(kalman, P, F, H, R, lanes=k) for k in (1, None))
    check(f"filter of {n}", alone(P, F, H, R), jax.jit(kalman)(P, F, H, R))
    many = [np.stack([P * (1 + 0.01 * k) for k in range(RUNS)]), F, H, R]
    assert np.array_equal(alone.lanes(*many), side_by_side.lanes(*many))
    took = times(
        {
            "trimtab": lambda: alone(P, F, H, R),
            "jax.jit": jitted(kalman, P, F, H, R),
            f"{RUNS} one by one": lambda: alone.lanes(*many),
            f"{RUNS} in lanes": lambda: side_by_side.lanes(*many),
        }
    )
    gain = compare(took[f"{RUNS} one by one"], took[f"{RUNS} in lanes"])
    return took, [
        (f"{n}-state filter: time of jax.jit / time of trimtab C", compare(took["jax.jit"], took["trimtab"]), "≥ 1"),
        (f"{n}-state filter, {RUNS} runs: time one by one / time in lanes", gain, "≥ 1"),
    ]


def turn_rings():
    numbers, calls = np.random.default_rng(0).normal(size=TURNS), {}
    for n in SLOTS:
        compiled = trimtab.compile(ring, np.zeros(n), numbers)
        check(f"ring of {n}", compiled(np.zeros(n), numbers), jax.jit(ring)(np.zeros(n), numbers))
        calls[f"ring of {n}"] = lambda compiled=compiled, n=n: compiled(np.zeros(n), numbers)
        calls[f"ring of {n}, jax.jit"] = jitted(ring, np.zeros(n), numbers)
    took = times(calls)
    few, many = (took[f"ring of {n}"] for n in SLOTS)
    what = f"ring buffer: time with {SLOTS[1]} slots / time with {SLOTS[0]} slots"
    return took, [(what, compare(many, few), "≤ 1.2")]


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    print(f"{machine('jax')}\n{load()}\n\n{'':34}{'median us':>12}{'min':>12}{'max':>12}")
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        for measure in (lambda: fly_quadrotor(folder), *(lambda n=n: filter_states(n) for n in STATES), turn_rings):
            took, more = measure()
            for name, t in took.items():
                print(f"{name:34}{1e6 * np.median(t):12.2f}{1e6 * min(t):12.2f}{1e6 * max(t):12.2f}", flush=True)
            figures += more
    print()
    for what, x, target in figures:
        print(f"{what:94} {x!s:22} {target}")
    print(load())
    if a.markdown:
        for what, x, target in figures:
            print(row(what, x, target, COMMAND))

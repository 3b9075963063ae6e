"""Measure filter updates per second of an aided INS and of a plain Kalman filter: trimtab's C, numpy and filterpy.

    python benchmarks/filters.py            times, ratios, and the largest difference of the results
    python benchmarks/filters.py --quick    seconds: only checks the results

The INS is that of the thesis [1]: a dual filter (2 and 6 states) with the printed matrices, a heading at each tick of
6.5536 ms, a position at each 15th tick. The plain filter has 8 states and a measurement of 2 numbers at each tick. All
programs compute the same equations on the same numbers. Each call from Python computes a whole flight. An update is a
prediction and a measurement update. filterpy is optional: pip install "trimtab[bench]".

Exits with 1 if a result is wrong, with --strict also if a target is missed.
"""

import argparse
import importlib.util
import sys
from functools import partial
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "reference")]
import filters_np
import jax
import jax.numpy as jnp
from paired import Program, load, machine, ratio, rounds, row, show

from trimtab.compiler.compiled_function import compile
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.kalman import predict, update

TRIMTAB, NUMPY, TOLERANCE, TARGET = "trimtab C", "numpy", 1e-9, 50
COMMAND = "python benchmarks/filters.py"
EVERY, STATES, REPEATS = 15, 8, 50
NOISE = InertialNoise(covariance="literal")
DT = to_seconds(NOISE.tick)
OPEN = 1e300
"""NIS gate that accepts every measurement, because the other programs have no gate."""
START = InertialStart(sigma_heading=np.sqrt(1.6e-4), sigma_position=np.sqrt(5.6e-4))


def setting():
    """Return the parameters of the INS in the form that filters_np.py reads."""
    start = to_arrays(START)
    return {
        "dt": DT,
        "every": EVERY,
        "P1": np.asarray(start.heading_variances()),
        "P2": np.asarray(start.motion_variances()),
        "Q1": np.array([NOISE.gyro, NOISE.gyro_walk]),
        "Q2": np.array([NOISE.forward, NOISE.starboard, NOISE.force_walk, NOISE.force_walk]),
        "R1": NOISE.heading,
        "R2": NOISE.position,
    }


def flight(n, seed):
    """Return IMU samples with biases and noise (n, 3), headings (n,) and positions (n, 2) of a weaving vehicle."""
    g, t = np.random.default_rng(seed), np.arange(n) * DT
    heading, rate = 0.7 * np.sin(0.4 * t), 0.28 * np.cos(0.4 * t)
    position = np.stack([2 * np.sin(0.9 * t), 1.5 * np.cos(0.7 * t) - 1.5], axis=1)
    force = np.stack([-1.62 * np.sin(0.9 * t), -0.735 * np.cos(0.7 * t)], axis=1)
    c, s = np.cos(heading), np.sin(heading)
    felt = np.stack([rate, c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]], axis=1)
    felt = felt + [0.01, 0.1, -0.1] + np.array([0.0126, 0.082, 0.082]) * g.standard_normal((n, 3))
    noisy = heading + 0.0126 * g.standard_normal(n), position + 0.0237 * g.standard_normal((n, 2))
    return felt, *noisy


def inertial(n):
    """Return trimtab's feed-forward INS for a whole flight, compiled, without the history for delayed fixes."""
    intake = Intake(gate_heading=OPEN, gate_position=OPEN, patience_position=0)
    form = to_arrays(AidedInertialFeedforward(intake=intake, noise=NOISE, start=START))

    def fly(form, felt, headings, positions):
        def tick(node, given):
            k, felt, z, r = given
            node = form.correct_heading(form.propagate(node, DT, felt, jnp.zeros(2)), z)
            node = jax.lax.cond(k % EVERY == 0, lambda: form.correct_position(node, r), lambda: node)
            return node, form.belief(node).x

        first = jax.tree.map(jnp.asarray, replace(form.first(), imu_reading=felt[0]))
        last, told = jax.lax.scan(tick, first, (jnp.arange(n), felt, headings, positions))
        return jnp.concatenate([told.ravel(), last.P1.ravel(), last.P2.ravel()])

    compiled = compile(fly, form, *flight(n, 0))
    return partial(compiled, form)


def plain(seed=0):
    """Return F, Q, H, R, P of a filter of 8 states: four coupled oscillators, two of which are measured."""
    g = np.random.default_rng(seed)
    blocks = np.kron(np.eye(4), [[0.0, 1.0], [-1.0, -0.1]]) + 0.1 * g.standard_normal((STATES, STATES))
    F = np.eye(STATES) + DT * blocks + DT * DT / 2 * blocks @ blocks
    H = np.eye(STATES)[[0, 4]]
    return F, 1e-4 * np.eye(STATES), H, 0.01 * np.eye(2), np.eye(STATES)


def tracked(n):
    """Return trimtab's Kalman filter for a series of measurements, compiled."""

    def fly(F, Q, H, R, P, measured):
        def tick(carry, z):
            x, P = predict(*carry, F, Q)
            done = update(x, P, z - H @ x, H, R)
            return (done.x, done.P), done.x

        (_, P), told = jax.lax.scan(tick, (jnp.zeros(STATES), P), measured)
        return jnp.concatenate([told.ravel(), P.ravel()])

    matrices = plain()
    compiled = compile(fly, *matrices, np.zeros((n, 2)))
    return partial(compiled, *matrices)


def again(call):
    """Return a program that repeats a short flight, so that its measurement lasts as long as the others'."""

    def calls(*given):
        for _ in range(REPEATS):
            found = call(*given)
        return found

    return Program(calls, REPEATS)


def makers():
    """Return program name -> function that creates a filter, for the programs in Python."""
    found = {NUMPY: filters_np.Kalman}
    if importlib.util.find_spec("filterpy") is None:
        print('filterpy is not installed: pip install "trimtab[bench]"', file=sys.stderr)
        return found
    import filters_filterpy

    return found | {filters_filterpy.NAME: filters_filterpy.Filter}


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=11, help="rounds of flights (%(default)s)")
    p.add_argument("--ticks", type=int, default=3000, help="ticks of a flight (%(default)s)")
    p.add_argument("--quick", action="store_true", help="2 rounds of 150 ticks: checks results, not times")
    p.add_argument("--strict", action="store_true", help="exit with 1 also if a target is missed")
    p.add_argument("--markdown", action="store_true", help="print rows for the documentation's table at the end")
    a = p.parse_args()
    if a.quick:
        a.rounds, a.ticks = 2, 150
    n, python = a.ticks, makers()
    print(f"{machine('jax')}\n{load()}")
    g = np.random.default_rng(1)
    jobs = {
        "aided INS": (
            inertial(n),
            lambda make: partial(filters_np.navigate, make, setting()),
            [flight(n, i) for i in range(a.rounds + 1)],
            n + -(-n // EVERY),
        ),
        "8-state Kalman filter": (
            tracked(n),
            lambda make: partial(filters_np.track, make, *plain()),
            [(g.standard_normal((n, 2)),) for _ in range(a.rounds + 1)],
            n,
        ),
    }
    lines, good, met = [], True, True
    for name, (compiled, written, inputs, updates) in jobs.items():
        programs = {TRIMTAB: again(compiled)} | {who: Program(written(make)) for who, make in python.items()}
        timed = rounds(programs, inputs, NUMPY)
        show(f"{name}: {updates} updates in {n} ticks, {a.rounds} rounds", timed, TRIMTAB, n)
        wrong = [who for who, worst in timed.worst.items() if not worst <= TOLERANCE]
        good = good and not wrong
        print(
            f"WRONG by more than {TOLERANCE:g}: {', '.join(wrong)}" if wrong else f"all results agree to {TOLERANCE:g}"
        )
        for who in programs:
            per_s = updates / np.array(timed.times[who])
            speed = f"{np.median(per_s):.3g} updates/s ({per_s.min():.3g}..{per_s.max():.3g})"
            print(f"{who:20} {speed}")
            lines += [row(f"{name}: update rate of {who}", speed, "", COMMAND)] if who == TRIMTAB else []
        for who in python:
            x = ratio(timed, who, TRIMTAB)
            met = met and x.median >= TARGET
            print(f"{who} / {TRIMTAB}: {x}   target ≥ {TARGET}  {'met' if x.median >= TARGET else 'MISSED'}")
            lines.append(row(f"{name}: time of {who} / time of {TRIMTAB}", x, f"≥ {TARGET}", COMMAND))
    if a.quick:
        print("these ratios mean nothing: --quick takes too few rounds")
    print(load())
    if a.markdown:
        print("\n" + "\n".join(lines))
    return int(not good or (a.strict and not met))


if __name__ == "__main__":
    sys.exit(main())

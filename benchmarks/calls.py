"""Measure the CPU time of a call for several kinds of arguments: a compiled function and `jax.jit`, alternately.

    python benchmarks/calls.py              a minute

Each round measures both, and the smallest CPU time of all rounds is reported. CPU time excludes other programs. The
call of `jax.jit` does not wait for the results. The function does almost nothing, so the time is that of passing
arguments and results.
"""

import argparse
import collections
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from paired import machine

import trimtab

ROUNDS, LEAST = 40, 2e-3
"""Number of rounds of each kind, and minimum CPU time (s) of one measurement."""
RUNS = 4
"""Number of runs in the comparisons of `CompiledFunction.lanes`."""
Pair = collections.namedtuple("Pair", ["x", "k"])


class Kind(NamedTuple):
    """Function and arguments of one comparison. lanes: compare `CompiledFunction.lanes` with `jax.vmap`."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    lanes: bool = False


def scaled(x: Any, k: Any) -> Any:
    """Return a scaled vector."""
    return x * k


def total(tree: Any) -> Any:
    """Return the sum of all leaves."""
    return sum(jax.tree.leaves(tree))


def kinds() -> dict[str, Kind]:
    """Return the comparisons by name."""
    a, j, many = np.arange(3.0), jnp.arange(3.0), np.ones((RUNS, 3))
    return {
        "number of Python": Kind(jnp.square, (0.5,)),
        "numpy array": Kind(jnp.square, (a,)),
        "two numpy arrays": Kind(scaled, (a, a)),
        "jax.Array": Kind(jnp.square, (j,)),
        "two jax.Arrays": Kind(scaled, (j, j)),
        "jax.Array and number": Kind(scaled, (j, 2.0)),
        "named tuple of numpy arrays": Kind(total, (Pair(a, a),)),
        "named tuple of jax.Arrays": Kind(total, (Pair(j, j),)),
        "named tuple in and out": Kind(lambda p: Pair(p.k, p.x), (Pair(a, a),)),
        "dict of numpy arrays": Kind(total, ({"x": a, "k": a},)),
        "dict of jax.Arrays": Kind(total, ({"x": j, "k": j},)),
        "list of 40 numpy arrays": Kind(total, ([a] * 40,)),
        "list of 40 jax.Arrays": Kind(total, ([j] * 40,)),
        "lanes: numpy array": Kind(jnp.square, (many,), True),
        "lanes: jax.Array": Kind(jnp.square, (jnp.asarray(many),), True),
        "lanes: dict of two arrays": Kind(total, ({"x": many, "k": many},), True),
        "lanes: named tuple of jax.Arrays": Kind(total, (Pair(jnp.asarray(many), jnp.asarray(many)),), True),
        "lanes: list of 40 arrays": Kind(total, ([many] * 40,), True),
        "lanes: one array for all runs": Kind(scaled, (many, np.ones(RUNS)), True),
    }


def cpu_time(call: Callable[[], Any]) -> float:
    """Return the CPU time (s) of a call, averaged over calls that take LEAST in total."""
    count = 1
    while True:
        start = time.process_time()
        for _ in range(count):
            call()
        took = time.process_time() - start
        if took >= LEAST:
            return took / count
        count *= 2


def least_times(kind: Kind, rounds: int) -> tuple[float, float]:
    """Return the smallest CPU time of a call of the compiled function, and of `jax.jit`."""
    first = jax.tree.map(lambda v: v[0], kind.arguments) if kind.lanes else kind.arguments
    compiled = trimtab.compile(kind.function, *first)
    jitted = jax.jit(jax.vmap(kind.function) if kind.lanes else kind.function)
    ours: Callable[..., Any] = compiled.lanes if kind.lanes else compiled
    for got, wanted in zip(
        jax.tree.leaves(ours(*kind.arguments)), jax.tree.leaves(jitted(*kind.arguments)), strict=True
    ):
        np.testing.assert_array_equal(got, wanted)
    times = [
        (cpu_time(lambda: ours(*kind.arguments)), cpu_time(lambda: jitted(*kind.arguments))) for _ in range(rounds)
    ]
    mine, theirs = zip(*times, strict=True)
    return min(mine), min(theirs)


def main() -> int:
    """Print the table. Return 1 if the compiled function is slower than `jax.jit` for any kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="number of measurements of each kind")
    rounds = parser.parse_args().rounds
    jax.config.update("jax_enable_x64", True)
    print(machine("jax"))
    print(f"\n{'arguments':36}{'trimtab (µs)':>14}{'jax.jit (µs)':>14}{'ratio':>8}")
    slower = []
    for name, kind in kinds().items():
        mine, theirs = least_times(kind, rounds)
        print(f"{name:36}{mine * 1e6:14.2f}{theirs * 1e6:14.2f}{mine / theirs:8.2f}", flush=True)
        slower += [name] if mine > theirs else []
    print(f"\nslower than jax.jit: {', '.join(slower) or 'none'}")
    return int(bool(slower))


if __name__ == "__main__":
    sys.exit(main())

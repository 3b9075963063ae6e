"""Random functions through `trimtab.compile`: JAX's numbers, the same bits in lanes and threads, no death of Python.

10 000 functions take about 100 minutes: `pytest -n 0 -m thorough --random-examples 10000` and this file.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import trimtab
from contracts.random_calls import RandomCall, random_call
from trimtab.compiler import text
from trimtab.core.errors import InputError

BATCH = 10
"""Functions that are compiled as one."""
SETS = 3
"""Arguments with which JAX is asked; lanes are given RUNS."""
RUNS = 11
STACK = 256 * 1024
"""Size of the stack (bytes) on which compiled functions are called."""
PRECISION = {"float64": 1e-13, "float32": 5e-6}


def batch_of(first: int) -> tuple[list[RandomCall], dict[str, int]]:
    """The functions of the numbers from `first` on, and how they are compiled; every fourth batch of narrow types."""
    k = first // BATCH
    narrow = k % 4 == 3
    calls = [random_call(seed, narrow) for seed in range(first, first + BATCH)]
    return calls, {} if narrow else {"lanes": (4, 8)[k % 2], "threads": (1, 3)[k // 2 % 2]}


def differences(calls: list[RandomCall], options: dict[str, int]) -> list[str]:
    """A line for each result that is not JAX's, or not the same in lanes."""
    functions = [c.function() for c in calls]

    def together(trees: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(f(t) for f, t in zip(functions, trees, strict=True))

    sets = [tuple(c.arguments(k, tiny=k >= SETS) for c in calls) for k in range(RUNS)]
    found = []
    compiled = trimtab.compile(together, sets[0], **options)  # pyright: ignore[reportArgumentType]
    alone = on_a_small_stack(lambda: [compiled(s) for s in sets])
    jitted = jax.jit(together)
    for k in range(SETS):
        for call, arguments, got, want in zip(calls, sets[k], alone[k], jitted(sets[k]), strict=True):
            assert jax.tree.structure(got) == jax.tree.structure(want)
            problems = problems_of(call, got, want)
            if problems:  # XLA may contradict itself: a scatter into a dynamic slice (seed 1078) is another jitted
                problems = problems_of(call, got, call.function()(jax.tree.map(jax.numpy.asarray, arguments)))
            found += [f"seed {call.seed}, set {k}, {problem}" for problem in problems]
    if options:
        stacked = jax.tree.map(lambda *v: np.stack(v), *sets)
        many = on_a_small_stack(lambda: compiled.lanes(stacked))
        for k, one in enumerate(alone):
            for call, got, want in zip(calls, many, one, strict=True):
                for v, g, w in zip(call.outputs, jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
                    if g[k].dtype != w.dtype or not np.array_equal(g[k], w, equal_nan=w.dtype.kind == "f"):
                        found.append(f"seed {call.seed}, run {k}, {v.name}, lanes {options}: {g[k]!r} not {w!r}")
    return found


def on_a_small_stack(call: Callable[[], Any]) -> Any:
    """Return the result of a call in a thread with a small stack."""
    before, found = threading.stack_size(STACK), list[Any]()
    thread = threading.Thread(target=lambda: found.append(call()))
    try:
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    return found[0]


def problems_of(call: RandomCall, got: Any, wanted: Any) -> list[str]:
    """A line for each of a function's results that is not JAX's."""
    results = zip(call.outputs, jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True)
    lines = [(v.name, difference(g, np.asarray(w), v.rough, call)) for v, g, w in results]
    return [f"{name}: {problem}" for name, problem in lines if problem]


def difference(got: Any, wanted: Any, rough: bool, call: RandomCall) -> str:
    """What is wrong with a result, or nothing."""
    if (got.shape, got.dtype) != (wanted.shape, wanted.dtype):
        return f"{got.shape} {got.dtype} not {wanted.shape} {wanted.dtype}"
    if wanted.dtype.kind != "f":
        wrong = got != wanted
    else:
        with np.errstate(all="ignore"):
            finite = np.isfinite(wanted)
            count = max(np.prod(v.shape, dtype=int) for v in call.inputs)
            scale = max(np.abs(wanted[finite]).max(initial=0.0), 64.0, float(count)) if rough else 0.0
            near = finite & (np.abs(got - wanted) <= PRECISION[wanted.dtype.name] * scale)
        wrong = ~((got == wanted) | (np.isnan(got) & np.isnan(wanted)) | near)
    if not wrong.any():
        return ""
    place = tuple(int(a[0]) for a in np.nonzero(np.atleast_1d(wrong)))[: wrong.ndim]
    return f"{got[place]!r} not {wanted[place]!r} at {place}; {int(wrong.sum())} of {wrong.size}"


def check(first: int) -> list[str]:
    """Differences of a batch; where it is refused or raises, of its functions one by one."""
    calls, options = batch_of(first)
    try:
        return differences(calls, options)
    except Exception:
        found = []
        for call in calls:
            try:
                found += differences([call], options)
            except InputError as refusal:
                found.append(f"seed {call.seed} is refused: {refusal}")
            except Exception as reason:
                found.append(f"seed {call.seed}: {type(reason).__name__}: {str(reason)[:300]}")
        return found


@pytest.mark.thorough("25")
@pytest.mark.parametrize("seed", [4, 25])
def test_random_function_agrees_in_lanes_on_a_small_stack(seed: int) -> None:
    assert not differences([random_call(seed)], {"lanes": 4, "threads": 3})


@pytest.mark.thorough
@pytest.mark.parametrize("first", [0, 30])
def test_some_random_functions_agree_with_jax(first: int) -> None:
    assert not check(first)


@pytest.mark.thorough
def test_comparison_detects_a_deliberate_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(text.INFIX, "xor", "|")
    call = next(
        c for c in map(random_call, range(1000)) if any(v.dtype.kind == "i" for v in c.outputs) and " ^ " in c.text()
    )
    assert any(f"seed {call.seed}" in line for line in differences([call], {}))


@pytest.mark.thorough
def test_functions_of_random_seeds_agree_with_jax(random_examples: range) -> None:
    assert not check_in_processes(random_examples)


def check_in_processes(seeds: range, chunk: int = 10) -> list[str]:
    """Return the differences of all batches. A crash ends only its own process, and is one line of the result."""
    firsts = list(range(seeds.start // BATCH * BATCH, seeds.stop, BATCH))
    found = []
    for k in range(0, len(firsts), chunk):
        some = ",".join(map(str, firsts[k : k + chunk]))
        start = time.perf_counter()
        command = [sys.executable, __file__, "--batches", some]
        paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        environment = os.environ | {"PYTHONPATH": paths}
        ran = subprocess.run(
            command, capture_output=True, text=True, check=False, env=environment, start_new_session=True
        )
        lines = [line for line in ran.stdout.splitlines() if line.startswith("seed")]
        if ran.returncode:
            lines.append(f"dead with {ran.returncode}: {ran.stdout[-200:]} {ran.stderr[-2000:]}")
        print(f"{some}: {len(lines)} found, {time.perf_counter() - start:.0f} s", *lines, sep="\n", flush=True)
        found += lines
    return found


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    chosen = parser.add_mutually_exclusive_group(required=True)
    chosen.add_argument("--batches", help="first seeds of the batches to check in this process, separated by commas")
    chosen.add_argument("--show", type=int, help="seed of the function to print")
    given = parser.parse_args()
    if given.show is not None:
        calls, options = batch_of(given.show // BATCH * BATCH)
        print(calls[given.show % BATCH].text(), options)
        return 0
    for first in map(int, given.batches.split(",")):
        print("batch", first, flush=True)
        for line in check(first):
            print(line.replace("\n", " "), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Random programs: the same numbers from JAX, scalar C and C++ over lanes. A failure prints the smallest program.

10 000 programs take about 30 minutes: `pytest -n 0 -m thorough --random-examples 10000` and this file.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from contracts.compiled import LANES, compiled, reference, together
from contracts.programs import TOLERANCE, Program, Writer, random_program
from contracts.variables import Var
from trimtab import compile as compile_function
from trimtab.compiler import text

BATCH = 50
FEW = 40


def wrong(programs: list[Program], shapes: tuple[int, ...] = (0, LANES)) -> list[tuple[Program, str]]:
    """Programs that differ from JAX, with what differs."""
    cases = [p.case() for p in programs]
    with ThreadPoolExecutor() as pool:
        wanted = pool.submit(reference, *together(cases))
        tries = [(lanes, pool.submit(compiled, cases, lanes, "-O0")) for lanes in shapes]
        results = [(lanes, got.result()) for lanes, got in tries]
    found = {}
    for lanes, got in results:
        owners = [(p, v) for p in programs for v in p.outputs]
        for k, (p, v) in enumerate(owners):
            for i, (w, g) in enumerate(zip(wanted.result(), got, strict=True)):
                if not _agree(w[k], g[k], v.exact) and not _is_computed_alike_step_by_step(p, v, i, g[k]):
                    problem = f"{v.name}, set {i}, lanes {lanes}:\n{g[k]!r}\nnot\n{w[k]!r}"
                    found.setdefault(p.seed, (p._replace(outputs=[v]), problem))
    return list(found.values())


def _is_computed_alike_step_by_step(p: Program, v: Var, i: int, got: Any) -> bool:
    """Whether JAX agrees where it compiles nothing: XLA takes x * x of integers for never negative, though it wraps."""
    case = p._replace(outputs=[v]).case()
    with jax.disable_jit():
        (wanted,) = jax.tree.leaves(case.function(*map(jnp.asarray, case.sets[i])))
    return v.kind != "f" and _agree(np.asarray(wanted), got, exact=True)


def test_c_matches_unjitted_jax_for_wrapped_squares() -> None:
    def add(i: Any, a: Any) -> Any:
        return a.at[i * i].add(i * i, mode="drop")

    i, a = np.int32(46341), np.arange(7, dtype=np.int32)
    with jax.disable_jit():
        wanted = np.asarray(add(jnp.asarray(i), jnp.asarray(a)))
    np.testing.assert_array_equal(wanted, a)  # the square wraps, far below the array: it is dropped
    np.testing.assert_array_equal(compile_function(add, i, a)(i, a), wanted)


def _agree(wanted: Any, got: Any, exact: bool) -> bool:
    if wanted.dtype.kind != "f" or exact:
        return np.array_equal(wanted, got, equal_nan=wanted.dtype.kind == "f")
    return np.allclose(got, wanted, rtol=0, atol=TOLERANCE, equal_nan=True)


def _fails(program: Program, shapes: tuple[int, ...]) -> bool:
    try:
        return bool(wrong([program], shapes))
    except Exception:
        return False  # it no longer runs, or no longer is the same program


def shrunk(program: Program, shapes: tuple[int, ...] = (0, LANES)) -> Program:
    """The program without statements that it can spare and still fail."""
    k = len(program.statements) - 1
    while k >= 0:
        fewer = [*program.statements[:k], *program.statements[k + 1 :]]
        if _fails(program._replace(statements=fewer), shapes):
            program = program._replace(statements=fewer)
        k -= 1
    return program


def check(seeds: range) -> None:
    for first in range(seeds.start, seeds.stop, BATCH):
        found = wrong([random_program(s) for s in seeds[first - seeds.start :][:BATCH]])
        if found:
            program, problem = found[0]
            seeds_wrong = ", ".join(str(p.seed) for p, _ in found)
            pytest.fail(f"seeds {seeds_wrong} differ; seed {program.seed}: {problem}\n{shrunk(program).text()}")


@pytest.mark.thorough
def test_some_random_programs_agree() -> None:
    check(range(FEW))


@pytest.mark.thorough
def test_programs_of_random_seeds_agree(random_examples: range) -> None:
    check(random_examples)


def test_wrong_program_is_detected_and_reduced(monkeypatch: pytest.MonkeyPatch) -> None:
    # a generator that confuses two operations, on a program where that shows
    monkeypatch.setitem(text.INFIX, "xor", "|")
    made = Writer(0)
    statements = [("v1", "a4 + 3"), ("v2", "v1 ^ a4"), ("v3", "jnp.sin(a0)"), ("v4", "v2 * 2")]
    program = Program(0, made.inputs, statements, [Var("v3", "f", (), exact=False), Var("v4", "i32", ())])
    [(found, problem)] = wrong([program], (0,))
    assert problem.startswith("v4")
    assert [name for name, _ in shrunk(found, (0,)).statements] == ["v1", "v2", "v4"]

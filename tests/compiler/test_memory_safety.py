"""Generated C at every size: no byte outside the arrays, no stack that grows with them, whole numbers at their ends."""

import os
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab
from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.compiler.function import Function, lower_function
from trimtab.compiler.ir import TYPES
from trimtab.compiler.native.compiler import find_compiler
from trimtab.compiler.workspace import CALL_STACK, STACK

pytestmark = pytest.mark.sanitizer

FLAGS = ("-O2", "-g", "-ffp-contract=off", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-w")


def long_sum(x):
    return jnp.cumsum(jnp.sin(x)).sum() + x[::-1][0]


@pytest.mark.thorough("1000", "100000", "1000000")
@pytest.mark.parametrize("n", [1, 10**3, 10**5, 10**6])
def test_large_arrays_do_not_lie_on_the_stack(n: int) -> None:
    x = np.linspace(0.0, 1.0, n)
    compiled = trimtab.compile(long_sum, x)
    assert compiled(x) == pytest.approx(float(long_sum(x)), rel=1e-11)
    assert (compiled.workspace > 0) == (n >= 10**5)


@pytest.mark.thorough
def test_array_of_ten_million_is_summed() -> None:
    x = np.linspace(0.0, 1.0, 10**7)
    assert trimtab.compile(long_sum, x)(x) == pytest.approx(float(long_sum(x)), rel=1e-10)


@pytest.mark.thorough
def test_large_arrays_agree_in_lanes_and_threads() -> None:
    x = np.linspace(0.0, 1.0, 60_000)
    compiled = trimtab.compile(long_sum, x, lanes=8, threads=3)
    got = compiled.lanes(np.stack([k * x for k in range(20)]))
    assert all(got[k] == compiled(k * x) for k in range(20))


@pytest.mark.thorough
def test_workspace_of_dead_arrays_is_reused() -> None:
    x = np.linspace(0.0, 1.0, 50_000)

    def chain(x):
        for _ in range(10):
            x = jnp.cumsum(x)[::-1]
        return x.sum()

    assert trimtab.compile(chain, x).workspace <= 2 * x.nbytes + 128
    want = np.asarray(jax.jit(chain)(x))
    assert trimtab.compile(chain, x)(x) == pytest.approx(float(want), rel=1e-11)


def test_small_programs_need_no_workspace() -> None:
    small = CALL_STACK // 8 // 4
    assert trimtab.compile(lambda x: jnp.cumsum(x)[::-1].sum(), np.zeros(small)).workspace == 0
    for carried in (np.zeros(3), np.zeros(STACK)):
        block = BlockDefinition("b", "B.", lambda p, s, u: (s.at[0].add(u), u), lambda p, c=carried: c + 0.0, (), 0.0)
        assert block_text(block).workspace == 0  # states lie where the caller keeps them


def test_blocks_get_their_workspace_from_python() -> None:
    def step(p, s, u):
        return s + 1, (jnp.cumsum(jnp.sin(jnp.arange(30_000.0) * u))[::-1]).sum() + s

    text = block_text(BlockDefinition("wide", "Wide.", step, lambda p: jnp.float64(0.0), (), 0.0))
    assert text.workspace > 0
    assert f"enum {{ WIDE_WORKSPACE = {text.workspace} }};" in text.header
    block = CompiledBlock(text)
    block.inputs[0] = 0.001
    for k in range(3):
        block.step()
        assert block.outputs[0] == pytest.approx(float(step((), float(k), 0.001)[1]), rel=1e-11)


@pytest.mark.thorough
def test_range_update_with_28_beacons_matches_jax() -> None:
    """gcc 12 vectorised the remainder of a loop with an alignment that its stack did not have."""
    from trimtab.core.record import to_arrays
    from trimtab.estimators.ranging.tightly_coupled import TightlyCoupled

    rng = np.random.default_rng(0)
    beacons = np.column_stack([rng.uniform(-3, 3, (28, 2)), np.full(28, -2.5)])
    form = to_arrays(TightlyCoupled(beacons=beacons, begins="given"))
    node, value = jax.tree.map(np.asarray, form.first()), np.append(np.full(28, 3.5), 0.0)

    def correct(form, node, value):
        return form.correct_ranges(node, value)

    got = trimtab.compile(correct, form, node, value)(form, node, value)
    for g, w in zip(jax.tree.leaves(got), jax.tree.leaves(jax.jit(correct)(form, node, value)), strict=True):
        np.testing.assert_allclose(g, w, rtol=1e-9, atol=1e-9)


@pytest.mark.thorough("int32", "int64")
@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32, np.int64])
def test_integers_at_their_limits_match_jax(dtype: Any) -> None:
    low = np.iinfo(dtype).min
    x = np.array([low, low, low, -1, 1, 0, low + 1, 5, low // 2], dtype)
    y = np.array([-1, 0, low, low, low, low, -1, 0, 2], dtype)
    compiled = trimtab.compile(ends, x, y)
    got, wanted = jax.tree.leaves(compiled(x, y)), jax.tree.leaves(jax.jit(ends)(x, y))
    assert all(np.array_equal(g, w) for g, w in zip(got, wanted, strict=True))
    many = jax.tree.leaves(compiled.lanes(np.stack([x] * 5), y))
    assert all(np.array_equal(g[3], w) for g, w in zip(many, wanted, strict=True))


def ends(x, y):
    t = x.dtype.type
    low = t(np.iinfo(t).min)
    divided = x // y, x % y, lax.div(x, y), lax.rem(x, y), x // t(-1), x % t(-1), lax.div(low, y), lax.rem(low, y)
    known = abs(jnp.asarray(low)), -jnp.asarray(low), lax.div(low, t(-1)), lax.rem(low, t(-1))
    return divided, abs(x), -x, jnp.sign(x), x * y, x - y, x + y, jnp.abs(x).sum(), x**2, known


def moves(x, i):
    ring = x.at[i].set(1.0).at[i + 900].add(2.0)
    window = lax.dynamic_slice(ring, (i - 10,), (64,))
    return ring, window, ring[jnp.clip(jnp.arange(100) * i, 0, 999)], lax.dynamic_update_slice(x, window, (i,))


def matrices(A, x):
    L = jnp.linalg.cholesky(A @ A.T + 60 * jnp.eye(60))
    return jax.scipy.linalg.solve_triangular(L, x, lower=True), jnp.concatenate([A, A[::-1]]).T, jnp.pad(A, 3)


def loops(x, n):
    def body(c):
        return c[0] + 1, jnp.roll(c[1], 1) * 0.5 + c[1]

    return lax.while_loop(lambda c: c[0] < n, body, (0, x)), lax.scan(lambda c, v: (c + v, c * v), 0.0, x)


def programs() -> dict[str, tuple[Any, tuple[Any, ...]]]:
    rng = np.random.default_rng(3)
    low = np.iinfo(np.int64).min
    return {
        "ends": (ends, (np.array([low, low, low, -1, 5]), np.array([-1, 0, low, low, 0]))),
        "moves": (moves, (rng.normal(size=1000), -7)),
        "moves_high": (moves, (rng.normal(size=1000), 2**40)),
        "matrices": (matrices, (rng.normal(size=(60, 60)), rng.normal(size=60))),
        "loops": (loops, (rng.normal(size=333), 17)),
        "long": (long_sum, (np.linspace(0, 1, 30_000),)),
        "edges": (lambda x: (x.astype(jnp.int32), x.astype(jnp.uint8)), (np.array([np.nan, 1e300, -1e300, -0.5]),)),
        "empty": (lambda x: (x.sum(), x + 1), (np.zeros((0, 3)),)),
    }


MAIN = """
#include <stdio.h>
#include <stdlib.h>
static int failures;
static void *work(void *unused)
{
    const void *in[N_IN + 1];
    void *out[N_OUT + 1];
    for (int round = 0; round < 3; round++) {
        FILE *file = fopen("in.bin", "rb"), *wanted = fopen("out.bin", "rb");
        void *space = NULL;
        if (posix_memalign(&space, 64, WORKSPACE + 1)) abort();
        for (int i = 0; i < N_IN; i++) {  /* arrays of just their bytes, aligned as malloc does */
            in[i] = malloc(in_bytes[i]);
            if (fread((void *)in[i], 1, in_bytes[i], file) != in_bytes[i]) abort();
        }
        for (int i = 0; i < N_OUT; i++) out[i] = malloc(out_bytes[i]);
        program(in, out, space, RUNS);
        for (int i = 0; i < N_OUT; i++) {
            char *expected = (char *)malloc(out_bytes[i] + 1);
            if (fread(expected, 1, out_bytes[i], wanted) != out_bytes[i]) abort();
            if (memcmp(expected, out[i], out_bytes[i])) __atomic_fetch_add(&failures, 1, __ATOMIC_RELAXED);
            free(expected);
            free(out[i]);
        }
        for (int i = 0; i < N_IN; i++) free((void *)in[i]);
        free(space);
        fclose(file);
        fclose(wanted);
    }
    return unused;
}

int main(void)
{
    pthread_t threads[3];
    for (int i = 0; i < 3; i++) pthread_create(&threads[i], NULL, work, NULL);
    for (int i = 0; i < 3; i++) pthread_join(threads[i], NULL);
    return failures ? 3 : 0;
}
"""


SLOWEST = ("ends", 4)
"""As slow as all others together."""
CASES = [
    pytest.param(name, lanes, marks=pytest.mark.thorough if (name, lanes) == SLOWEST else ())
    for name in programs()
    for lanes in (0, 4)
]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "lanes"), CASES)
def test_clean_under_sanitizers_from_three_threads(name: str, lanes: int, tmp_path: Path) -> None:
    function, arguments = programs()[name]
    compiler = find_compiler("c++" if lanes else "c")
    assert compiler is not None
    made: Function = lower_function(function, arguments)
    try:
        text = made.program_text("program", lanes)
    except trimtab.InputError:
        assert name == "edges"  # uint8 is not carried in lanes
        return
    runs = lanes or 1
    results = jax.tree.leaves(trimtab.compile(function, *arguments)(*arguments))
    ins = [np.asarray(v, TYPES[a.dtype]) for v, a in zip(jax.tree.leaves(arguments), made.inputs, strict=True)]
    (tmp_path / "in.bin").write_bytes(b"".join(v.tobytes() * runs for v in ins))
    (tmp_path / "out.bin").write_bytes(b"".join(v.tobytes() * runs for v in results))
    known = {"N_IN": len(ins), "N_OUT": len(results), "RUNS": runs, "WORKSPACE": text.workspace}
    sizes = [f"#define {name} {value}" for name, value in known.items()]
    for kind, arrays in (("in", ins), ("out", results)):
        sizes.append(f"static const size_t {kind}_bytes[] = {{{', '.join(str(v.nbytes * runs) for v in arrays)}}};")
    source = tmp_path / ("program.cpp" if lanes else "program.c")
    source.write_text("\n".join(["#include <pthread.h>", "#include <stddef.h>", text.text, *sizes, MAIN]))
    flags = (*FLAGS, "-std=c++17" if lanes else "-std=gnu99", "-fwrapv")
    command = [
        compiler.path,
        *compiler.options,
        *flags,
        str(source),
        "-o",
        str(tmp_path / "program"),
        "-pthread",
        "-lm",
    ]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[:2000]
    limits = {"ASAN_OPTIONS": "detect_stack_use_after_return=0", "PATH": os.environ["PATH"]}
    ran = subprocess.run([tmp_path / "program"], cwd=tmp_path, capture_output=True, text=True, env=limits, check=False)
    assert ran.returncode == 0, ran.stderr[:3000]

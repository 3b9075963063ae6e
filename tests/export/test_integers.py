"""Exported integers of every type: exact test vectors, and no signed overflow where a compiler is not told of it."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from export.conftest import require
from jax import lax

from trimtab.compiler.compiled_function import export_callable
from trimtab.compiler.native.compiler import find_compiler
from trimtab.export.verify import verify_folder

jax.config.update("jax_enable_x64", True)

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
TYPES = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
CHECKS = ("-fno-wrapv", "-fsanitize=undefined", "-fno-sanitize-recover=all", "-ffp-contract=off", "-O1")


def arithmetic(x: Any, y: Any) -> Any:
    """Operations whose results leave the type at its extremes. x: a few numbers; y: more than are unrolled."""
    bits = np.iinfo(x.dtype).bits
    a, b = x, x[::-1]
    shifts = [a << x.dtype.type(n) for n in (1, bits // 2, bits - 1)]
    shifts += [lax.shift_left(a, b), lax.shift_right_arithmetic(a, b), lax.shift_right_logical(a, b)]
    results = [a + b, a - b, a * b, -a, a * a * a, jnp.abs(a), lax.div(a, b), lax.rem(a, b), a // b, ~a]
    return results, shifts, [jnp.sum(y * y, dtype=y.dtype), jnp.cumprod(y, dtype=y.dtype), y @ y[::-1], jnp.diff(y)]


def extremes(dtype: str) -> Any:
    limits = np.iinfo(dtype)
    x = np.array([limits.min, limits.max, limits.max - 1, 7, 0, limits.max // 2 + 1], dtype)
    return x, np.tile(x, 10)


@pytest.mark.thorough("int8", "int16", "int64", "uint8", "uint32", "uint64")
@pytest.mark.parametrize("dtype", TYPES)
def test_integer_arithmetic_has_no_undefined_overflow(dtype: str, tmp_path: Path) -> None:
    given = extremes(dtype)
    export_callable(arithmetic, given, tmp_path, name="numbers")
    command = ["gcc", "-std=c99", *CHECKS, "numbers.c", "vectors.c", "replay.c", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "vectors.csv"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    leaves = jax.tree.leaves(jax.jit(arithmetic)(*given))
    wanted = [int(n) for leaf in leaves for n in np.asarray(leaf).ravel()]
    assert {tuple(map(int, line.split(","))) for line in done.stdout.splitlines()} == {tuple(wanted)}


@pytest.mark.thorough
@pytest.mark.parametrize("dtype", TYPES)
def test_test_vectors_hold_integers_exactly(dtype: str, tmp_path: Path) -> None:
    export_callable(lambda x, y: (x + x.dtype.type(1), x[1] - x[0], y), extremes(dtype), tmp_path, name="numbers")
    verdict = verify_folder(tmp_path)
    assert verdict.good, verdict.first


@pytest.mark.thorough
def test_detects_difference_of_one_beyond_double_precision(tmp_path: Path) -> None:
    export_callable(lambda a: a + 1, (np.int64(2**53 + 1),), tmp_path, name="next_number")
    assert verify_folder(tmp_path).good
    source = tmp_path / "next_number.c"
    source.write_text(source.read_text().replace("1LL", "2LL"))
    assert verify_folder(tmp_path).first == (0, "value", 2**53 + 3, 2**53 + 2)


def without_arguments() -> Any:
    return jnp.arange(3), jnp.sin(jnp.float32(2.0))


def without_results(x: Any) -> Any:
    return ()


@pytest.mark.thorough
@pytest.mark.parametrize(("f", "example"), [(without_arguments, ()), (without_results, (1.5,))])
def test_verifies_functions_without_arguments_or_results(f: Any, example: tuple[Any, ...], tmp_path: Path) -> None:
    export_callable(f, example, tmp_path)
    assert verify_folder(tmp_path).good


@pytest.mark.thorough
def test_verifies_float32_results_at_float32_tolerance(tmp_path: Path) -> None:
    exported = export_callable(lambda x: (jnp.cumsum(jnp.sin(x)), x.sum()), (np.ones(300, np.float32),), tmp_path)
    verdict = verify_folder(tmp_path)
    assert verdict.good
    assert {member.dtype for member in exported.block.outputs} == {"f32"}
    assert min(tolerance for _, tolerance in verdict.worst.values()) > 1e-5


@pytest.mark.thorough
def test_clang_accepts_elementary_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require(lambda: [] if shutil.which("clang") else ["clang"])
    functions = (jnp.sin, jnp.exp, jnp.log1p, jnp.tan, jnp.arctan2, jnp.power, lax.erf, jnp.tanh, jnp.cbrt)
    two = (jnp.arctan2, jnp.power)
    export_callable(lambda x: [f(x, x) if f in two else f(x) for f in functions], (0.5,), tmp_path, name="many")
    monkeypatch.setenv("CC", "clang")
    assert verify_folder(tmp_path).good


def test_verifies_function_with_a_capitalised_name(tmp_path: Path) -> None:
    export_callable(lambda x: x * 2, (1.0,), tmp_path, name="NAN")
    assert verify_folder(tmp_path).good

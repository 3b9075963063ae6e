"""Results that are computed while a program is compiled, and faults of the compiler on the way."""

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab
from trimtab.compiler.lower import CompilerFaultError, Lowering
from trimtab.core.errors import InputError

COUNT = 60
NUMBERS = np.arange(COUNT)[::-1].copy()
KEY = np.array([1, 2], np.uint32)


def table() -> Any:
    return jnp.asarray(NUMBERS)


CASES = {
    "sort": lambda x: jnp.sort(table()) * x,
    "sort of two": lambda x: lax.sort((table() % 7, table()), num_keys=1)[1] * x,
    "sort with floats": lambda x: lax.sort((table(), table() * 0.5), num_keys=1)[1] * x,
    "sort of truth values": lambda x: jnp.sort(table() % 2 == 0) * x,
    "sort of bytes": lambda x: jnp.sort(table().astype(jnp.int8)) * x,
    "long sort": lambda x: jnp.sort(jnp.arange(5000)[::-1]) * x,
    "split into one": lambda x: jnp.split(table(), 1)[0] * x,
    "split into three": lambda x: [part * x for part in jnp.split(table(), 3)],
    "split into uneven parts": lambda x: [part * x for part in jnp.split(table(), [50])],
    "unstack": lambda x: jnp.unstack(table().reshape(2, 30))[1] * x,
    "barrier": lambda x: lax.optimization_barrier(table()) * x,
    "barrier of two": lambda x: lax.optimization_barrier((table(), table() + 1))[1] * x,
    "top_k": lambda x: lax.top_k(table(), COUNT)[1] * x,
    "checkpoint": lambda x: jax.checkpoint(jnp.sort)(table()) * x,
    "searchsorted": lambda x: jnp.searchsorted(jnp.sort(table()), table()) * x,
    "unique": lambda x: jnp.unique(table() // 2, size=COUNT) * x,
    "nonzero": lambda x: jnp.nonzero(table() % 2, size=COUNT)[0] * x,
    "permutation": lambda x: jax.random.permutation(jax.random.wrap_key_data(KEY), COUNT) * x,
    "random bits": lambda x: jax.random.bits(jax.random.wrap_key_data(jnp.asarray(KEY)), (COUNT,)) * x,
}


def check(f: Any) -> None:
    for got, wanted in zip(jax.tree.leaves(trimtab.compile(f, 1.5)(1.5)), jax.tree.leaves(f(1.5)), strict=True):
        np.testing.assert_array_equal(got, wanted)


LONG_CASES = ("unique", "permutation", "long sort", "random bits")


def test_constant_results_are_computed_at_compile_time() -> None:
    """All quick cases in one program: one call of the compiler."""
    quick = [case for name, case in CASES.items() if name not in LONG_CASES]
    check(lambda x: [case(x) for case in quick])


@pytest.mark.thorough
@pytest.mark.parametrize("name", CASES)
def test_each_constant_result_is_computed_at_compile_time(name: str) -> None:
    check(CASES[name])


def test_constant_tables_are_folded_inside_a_jax_trace() -> None:
    made = []
    jax.jit(lambda y: (made.append(trimtab.compile(lambda x: (jnp.arange(COUNT) * 2)[::-1] * x, 1.5)), y)[1])(0.0)
    np.testing.assert_array_equal(made[0](1.5), NUMBERS * 3.0)


def test_callbacks_do_not_run_at_compile_time() -> None:
    ran: list[Any] = []

    def called(numbers: Any) -> Any:
        ran.append(numbers)
        return numbers

    shape = jax.ShapeDtypeStruct((COUNT,), table().dtype)
    with pytest.raises(InputError, match="pure_callback"):
        trimtab.compile(lambda x: jax.pure_callback(called, shape, table()) * x, 1.5)
    assert not ran


@pytest.mark.parametrize("export", [False, True])
def test_compiler_fault_is_reported_once(export: bool, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise KeyError("lost")

    compiled = trimtab.compile(lambda x: x + 1, 1.5) if export else None
    monkeypatch.setattr(Lowering, "_store_operands", fail)
    with pytest.raises(CompilerFaultError) as fault:
        compiled.export(tmp_path) if compiled else trimtab.compile(lambda x: lax.cond(x > 1, jnp.sin, jnp.cos, x), 1.5)
    assert str(fault.value).count("trimtab failed on") == 1
    assert "KeyError: 'lost'" in fault.value.problem
    assert f"test_known_results.py:{fail.__code__.co_firstlineno + 6}" in fault.value.problem or export
    assert jax.__version__ in fault.value.problem
    assert "with this message" in fault.value.fix
    assert isinstance(pickle.loads(pickle.dumps(fault.value)), CompilerFaultError)


def test_faults_in_text_and_lane_generation_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError

    compiled = trimtab.compile(lambda x: x + 1, np.ones(3))
    monkeypatch.setattr("trimtab.compiler.function.plan_workspace", fail)
    for call in (lambda: trimtab.compile(jnp.sin, 1.5), lambda: compiled.lanes(np.ones((9, 3)))):
        with pytest.raises(CompilerFaultError, match="ZeroDivisionError"):
            call()


def test_errors_of_the_user_function_pass_unchanged() -> None:
    def f(x: Any) -> Any:
        raise LookupError("of the user")

    with pytest.raises(LookupError, match="of the user"):
        trimtab.compile(f, 1.5)

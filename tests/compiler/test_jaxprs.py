"""The reader of jaxprs: versions of JAX, and the forms of programs that differ between them.

`.ci/run` runs this file on the newest supported version too.
"""

import tomllib
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import trimtab
from contracts.control_cases import closed_call
from trimtab.compiler import jaxprs
from trimtab.compiler.function import Function
from trimtab.core.errors import InputError

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


def test_supported_jax_versions_match_pyproject() -> None:
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    assert jaxprs.SUPPORTED in project["dependencies"]


@pytest.mark.parametrize("version", [(0, 10, 0), (0, 10, 1), (0, 11, 0), (0, 11, 2), (0, 12, 0), (0, 12, 9)])
def test_accepts_supported_jax_versions(version: tuple[int, ...]) -> None:
    jaxprs.check_version(version)


@pytest.mark.parametrize("version", [(0, 4, 38), (0, 9, 2), (0, 10, 2), (0, 13, 0), (1, 0, 0)])
def test_rejects_unsupported_jax_versions(version: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "__version__", ".".join(map(str, version)))
    with pytest.raises(InputError) as refused:
        jaxprs.check_version(version)
    assert str(refused.value).startswith(f"JAX {jax.__version__}: ")
    assert f'pip install "{jaxprs.SUPPORTED}"' in str(refused.value)


def _scan(x: Any) -> Any:
    return lax.scan(lambda c, u: ((c[0] + u * x, c[1] + 1), c[0]), (0.0, 0), jnp.arange(5.0), reverse=True)


def _while(x: Any) -> Any:
    return lax.while_loop(lambda c: c < 2 * x, lambda c: c + x, 1.0)


def _cond(x: Any) -> Any:
    return lax.cond(x > 0, jnp.sin, jnp.cos, x)


def _call(x: Any) -> Any:
    return jax.jit(jnp.sin)(x)


def _key(x: Any) -> Any:
    return jax.random.uniform(jax.random.key(0)) * x


PROGRAMS = {"scan": _scan, "while": _while, "cond": _cond, "jit": _call, "random_seed": _key}


def _scan_of_keys(x: Any) -> Any:
    def step(c: Any, u: Any) -> Any:
        key, total = c
        key, now = jax.random.split(key)
        return (key, total + u * jax.random.normal(now)), total

    (_, total), path = lax.scan(step, (jax.random.key(3), 0.0), jnp.arange(6.0) * x)
    return total, path


def _large_scan(x: Any) -> Any:
    return lax.scan(lambda a, u: (a.at[3].add(u[0] * x), u[1:] + a[:2]), jnp.ones(60), jnp.arange(12.0).reshape(4, 3))


def _nested_loops(x: Any) -> Any:
    inner = lambda i, s: lax.cond(s > i, lambda: s * 0.5, lambda: s + x)  # noqa: E731
    return lax.fori_loop(0, 5, lambda i, s: lax.while_loop(lambda c: c < x + i, lambda c: c + 0.75, inner(i, s)), x)


def _ends_one_by_one(x: Any) -> Any:
    ends = jnp.arange(3.0) + x
    return jax.vmap(lambda m: lax.while_loop(lambda c: c[0] < m, lambda c: (c[0] + 1, c[1] * 0.5), (0.0, x)))(ends)


def _doubled() -> Any:
    doubled = jax.custom_vjp(lambda a: a * 2)
    doubled.defvjp(lambda a: (a * 2, None), lambda _, g: (g * 2,))
    return doubled


def _random_numbers(x: Any) -> Any:
    keys = jax.random.split(jax.random.key(7), 4)
    kept = jax.random.fold_in(keys[2], 5), keys[jnp.int32(x)], jnp.where(x > 0, keys[0], keys[1])
    draws = [jax.random.uniform(k, (2,)) for k in kept]
    return draws, jax.random.randint(kept[0], (3,), -5, 90), jax.random.bits(kept[1], (3,), "uint64")


COMPARED = PROGRAMS | {
    "scan of keys": _scan_of_keys,
    "scan of large arrays": _large_scan,
    "scan without slices": lambda x: lax.scan(lambda c, _: (c * 1.5, c), x, None, length=3),
    "scan of no slices": lambda x: lax.scan(lambda c, u: (c + 1, u), x, jnp.zeros((0, 3))),
    "gradient of a scan": jax.grad(lambda x: _scan(x)[0][0] ** 2),
    "loops in loops": _nested_loops,
    "while over lanes": _ends_one_by_one,
    "derivative of a while loop": lambda x: jax.jvp(_while, (x,), (1.0,)),
    "switch": lambda x: lax.switch(jnp.int32(x), [jnp.sin, jnp.cos, lambda a: a * a], x),
    "gradient of a branch": jax.grad(_cond),
    "rule of its own": lambda x: jax.nn.relu(x) + jax.grad(jax.nn.softplus)(x),
    "reverse rule of its own": lambda x: (_doubled()(x), jax.grad(lambda a: _doubled()(a) ** 2)(x)),
    "checkpoint": jax.grad(lambda x: jax.checkpoint(lambda a: jnp.sin(jnp.sin(a)))(x)),
    "closed call": lambda x: closed_call(jax.make_jaxpr(lambda a: a + 1)(x), x),
    "linear solution": lambda x: jnp.linalg.solve(jnp.eye(3) * 2 + x, jnp.arange(3.0)),
    "platforms": lambda x: lax.platform_dependent(x, cpu=jnp.sin, default=jnp.cos),
    "search": lambda x: jnp.searchsorted(jnp.arange(60.0), x * jnp.arange(7.0)),
    "logarithm": jnp.log2,
    "special function": lambda x: jax.scipy.special.gammainc(x, 2.0),
    "gamma": lambda x: jax.random.gamma(jax.random.key(1), x, (2,)),
    "random numbers": _random_numbers,
    "old keys": lambda x: jax.random.normal(jax.random.PRNGKey(4), (2,)) * x,
}


@cache
def _results() -> list[tuple[Any, Any]]:
    """Results of all programs, compiled and jitted as one program, for each number."""

    def run_all(x: Any) -> list[Any]:
        return [function(x) for function in COMPARED.values()]

    compiled, jitted = trimtab.compile(run_all, 1.0), jax.jit(run_all)
    return [(compiled(x), jitted(x)) for x in (1.25, 0.5)]


@pytest.mark.parametrize("name", COMPARED)
def test_program_agrees_with_jax(name: str) -> None:
    place = list(COMPARED).index(name)
    for compiled, jitted in _results():
        got, wanted = compiled[place], jitted[place]
        assert jax.tree.structure(got) == jax.tree.structure(wanted)
        for g, w in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
            assert (g.dtype, g.shape) == (w.dtype, w.shape)
            np.testing.assert_allclose(g, w, rtol=1e-13, atol=1e-15)


def test_reads_counts_of_a_scan() -> None:
    (equation,) = [e for e in jax.make_jaxpr(_scan)(1.0).eqns if e.primitive.name == "scan"]
    scan = jaxprs.scan_parameters(equation)
    assert (scan.constants, scan.carries, scan.length, scan.reverse) == (1, 2, 5, True)


@pytest.mark.parametrize(
    "form", [{"num_consts": 1, "num_carry": 2}, {"ft_in": SimpleNamespace(unpack=lambda: ([0], [0, 0], [0]))}]
)
def test_reads_both_forms_of_a_scan(form: dict[str, Any]) -> None:
    equation = SimpleNamespace(params={"jaxpr": jax.make_jaxpr(jnp.sin)(1.0), "length": 5, "reverse": False, **form})
    assert jaxprs.scan_parameters(equation)[1:] == (1, 2, 5, False)


@pytest.mark.parametrize("name", PROGRAMS)
def test_unknown_jaxpr_form_error_names_jax_version(name: str) -> None:
    program = jax.make_jaxpr(PROGRAMS[name])(1.0)
    found = [e for e in _equations(program.jaxpr) if e.primitive.name == name]
    assert found
    for equation in found:
        kept = {"length", "reverse", "linear"}  # no program, and no count
        rest = {k: v for k, v in equation.params.items() if k in kept}
        equation.params.clear()
        equation.params.update(rest)
    with pytest.raises(InputError) as refused:
        Function(program)
    assert str(refused.value).startswith(f"JAX {jax.__version__}: the parameters ")
    assert repr(name) in str(refused.value)


def _equations(jaxpr: Any) -> list[Any]:
    """All equations, those of calls included."""
    found = []
    for equation in jaxpr.eqns:
        call = jaxprs.program_of_call(equation)
        found += [equation, *([] if call is None else _equations(call.jaxpr))]
    return found

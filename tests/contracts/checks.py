"""What the contract tests hold every part to."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from contracts.parts import example, rollout
from trimtab.core.record import Quantity, declarations


def is_same(a: Any, b: Any) -> bool:
    """Whether two trees are equal, bit by bit."""
    if jax.tree.structure(a) != jax.tree.structure(b):
        return False
    return all(
        np.array_equal(x, y, equal_nan=True) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    )


def assert_near(a: Any, b: Any, rtol: float = 1e-9) -> None:
    """Two trees of equal structure agree to rounding."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(a), jax.tree.leaves(b), strict=True):
        where = jax.tree_util.keystr(path)
        np.testing.assert_allclose(np.asarray(x), np.asarray(y), rtol=rtol, atol=1e-12, err_msg=where)


def assert_finite(tree: Any) -> None:
    """No NaN and no infinity."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        assert np.isfinite(np.asarray(leaf)).all(), jax.tree_util.keystr(path)


class Traced(NamedTuple):
    """Program of a block's rollout, taking block and run, and the shapes of the state before and after a step."""

    program: Any
    state: Any
    next_state: Any


def trace(folder: str, one: Any, given: Any = None, steps: int = 40) -> Traced:
    """Trace a rollout. What the block and its state hold is unknown to the program, apart from structure and types."""
    given = given or example(folder, one)
    noted = []

    def shape(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf))

    def note(*states: Any) -> None:
        noted.append(jax.tree.map(shape, states))

    program = jax.jit(lambda one, run: rollout(folder, one, given, run, steps, note)).trace(one, np.uint32(0))
    return Traced(program, *noted[0])


def assert_stable(traced: Traced) -> None:
    """A step gives back a state of the structure, the shapes and the kinds of number that it took."""
    _, state, new = traced
    assert jax.tree.structure(new) == jax.tree.structure(state)
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(new), strict=True):
        where = jax.tree_util.keystr(path)
        assert a.shape == b.shape, where
        assert np.dtype(a.dtype).kind == np.dtype(b.dtype).kind, f"{where}: {a.dtype} became {b.dtype}"


def assert_pure(one: Traced, other: Traced) -> None:
    """Two traces of a block are one program: whatever else a step depends on shows as another program."""
    programs = [traced.program.jaxpr for traced in (one, other)]
    assert str(programs[0]) == str(programs[1]), "two calls differ"
    assert is_same(*(p.consts for p in programs)), "two calls differ"


def assert_declared(cls: type) -> None:
    """A record says where it comes from, and every field its meaning and unit."""
    doc = cls.__doc__ or ""
    assert "Source:" in doc, f"{cls.__name__}: no 'Source:' in the docstring"
    for name, declared in declarations(cls).items():
        assert declared.doc.strip(), f"{cls.__name__}.{name} has no doc"
        if isinstance(declared, Quantity):
            assert declared.unit.strip(), f"{cls.__name__}.{name} has no unit"
            assert declared.kind != "angle" or declared.unit in ("rad", "deg"), (
                f"{cls.__name__}.{name}: {declared.unit}"
            )
            assert declared.kind != "time" or declared.unit == "100 ns", f"{cls.__name__}.{name}: {declared.unit}"
            assert declared.kind != "mode" or declared.modes, f"{cls.__name__}.{name} names no modes"

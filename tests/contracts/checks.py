"""What the contract tests hold every part to."""

from typing import Any

import jax
import numpy as np

from contracts.parts import example, first_state
from trimtab.core.record import Quantity, declarations
from trimtab.loop.structure import strengthen_types


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


def assert_stable(folder: str, one: Any, given: Any = None) -> None:
    """A step gives back a state of the structure, the shapes and the kinds of number that it took."""
    given = given or example(folder, one)
    state = jax.eval_shape(lambda: first_state(folder, one, given, 0))
    new, _ = jax.eval_shape(lambda t, x: one.step(t, x, strengthen_types(given(t))), np.int64(0), state)
    assert jax.tree.structure(new) == jax.tree.structure(state)
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(new), strict=True):
        where = jax.tree_util.keystr(path)
        assert a.shape == b.shape, where
        assert np.dtype(a.dtype).kind == np.dtype(b.dtype).kind, f"{where}: {a.dtype} became {b.dtype}"


def assert_pure(folder: str, one: Any, given: Any = None) -> None:
    """Two calls compute the same, and no input is changed on the way.

    Traced, not run: what is not traced (numbers of the part, the state and the input) is there as it is, and whatever
    else a step could depend on shows as another program.
    """
    given = given or example(folder, one)
    state = first_state(folder, one, given, 0)
    x = strengthen_types(given(np.int64(0)))
    before = jax.tree.map(np.array, (one, state, x))
    programs = [jax.make_jaxpr(lambda t: one.step(t, state, x))(np.int64(0)) for _ in range(2)]
    assert str(programs[0]) == str(programs[1]), "two calls differ"
    constants = [p.consts for p in programs]
    assert is_same(*constants), "two calls differ"
    assert is_same(before, jax.tree.map(np.array, (one, state, x))), "an input was changed"


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

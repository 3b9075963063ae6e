"""Shapes of what the parts exchange, found without running them, and errors that name both ends where two don't fit."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar


def zeros_of(part: str, reads: str, function: Callable[..., Any], *inputs: Any) -> Any:
    """The output of a function with every number zero; nothing is computed.

    Raises InputError naming the part and what it was given when the two don't fit.
    """
    try:
        shape = jax.eval_shape(function, *inputs)
    except InputError:
        raise
    except (AttributeError, KeyError, TypeError, IndexError) as error:
        name = type(inputs[-1]).__name__ if inputs else "nothing"
        fix = f"give {part} an input that has what its step() reads, or another part that reads {name}"
        raise InputError(part, f"does not fit {reads}, which gives {name}: {error}", fix=fix) from error
    return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)


def zeros_like(tree: Any) -> Any:
    """The tree, of shapes or of numbers, with every number zero, as NumPy has it."""
    return jax.tree.map(lambda v: np.zeros(np.shape(v), jnp.result_type(v)), tree)


def step_if(due: Scalar, step: Callable[[], Any], hold: Callable[[], Any]) -> Any:
    """step() where due, else hold(); a plain call where due is known beforehand."""
    if due is True:
        return step()
    return jax.lax.cond(due, lambda: strengthen_types(step()), lambda: strengthen_types(hold()))


def strengthen_types(tree: Any) -> Any:
    """The same tree with every number an array of a fixed type, as a loop's carry must be."""

    def fix(leaf: Any) -> Any:
        return jax.lax.convert_element_type(leaf, np.dtype(jnp.result_type(leaf)))

    return jax.tree.map(fix, tree)


def cast_like(tree: Any, pattern: Any) -> Any:
    """tree with every number in the type of the pattern's."""
    return jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), tree, pattern)


def is_finite(tree: Any) -> Scalar:
    """Whether every real number of a tree is finite."""
    floats = [v for v in map(jnp.asarray, jax.tree.leaves(tree)) if jnp.issubdtype(v.dtype, jnp.floating)]
    finite = jnp.asarray(True)
    for v in floats:
        finite = finite & jnp.all(jnp.isfinite(v))
    return finite

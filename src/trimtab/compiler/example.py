"""Example arguments of `trimtab.compile`: checks of their types, and tracing by JAX."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.native.call import ArrayType
from trimtab.core.errors import InputError

PART = "compile"
ARRAYS = jax.ShapeDtypeStruct | jax.Array | np.ndarray | np.generic | bool | int | float | complex
"""Types of the arrays and numbers that an example may contain."""


def check_example(example: tuple[Any, ...], name: str) -> None:
    """Raise InputError if an example is not a tree of arrays of numbers."""
    try:
        leaves = jax.tree_util.tree_flatten_with_path(example)[0]
    except (ValueError, SystemError) as reason:  # e.g. dict keys that cannot be sorted, or a list that contains itself
        raise InputError(
            PART, f"the example for {name!r} is not a tree: {reason}", fix="use tuples and dicts"
        ) from None
    for path, value in leaves:
        where = f"argument {path[0].idx}{jax.tree_util.keystr(path[1:])} of the example for {name!r}"
        if not isinstance(value, ARRAYS):
            fix = "pass arrays and numbers; bind other arguments with functools.partial"
            raise InputError(PART, f"{where} is {type(value).__name__}, not an array", fix=fix)
        try:
            if not isinstance(value, jax.ShapeDtypeStruct):
                jax.typeof(_native(value))
        except (TypeError, ValueError, OverflowError) as reason:
            fix = "pass arrays of float64, float32, integers or bool"
            raise InputError(PART, f"{where} cannot be used: {str(reason).splitlines()[0]}", fix=fix) from None


def is_key(value: Any) -> bool:
    """Return True if an array contains random keys (jax.random.key)."""
    return isinstance(value, jax.Array | jax.ShapeDtypeStruct) and jaxprs.is_key(value)


def array_type(value: Any) -> ArrayType:
    """Return the shape and type of an array's numbers in memory. For random keys, these are the words of the keys."""
    keys = value.dtype if jaxprs.is_key(value) else None
    return ArrayType(jaxprs.physical_shape(value), np.dtype(jaxprs.physical_type(value)), keys)


def _native(value: Any) -> Any:
    """Return an array in this machine's byte order."""
    swapped = isinstance(value, np.ndarray | np.generic) and not value.dtype.isnative
    return value.astype(value.dtype.newbyteorder("=")) if swapped else value


def trace_example(function: Callable[..., Any], example: tuple[Any, ...], name: str) -> Any:
    """Return the function's jaxpr in float64, and the shapes of its results. JAX's settings stay as they are."""
    if not callable(function):
        raise InputError(PART, f"{type(function).__name__} is not a function", fix="compile(f, *example)")
    with jax.enable_x64(True):
        check_example(example, name)
    try:
        inspect.signature(function).bind(*example)
    except TypeError as reason:
        raise InputError(
            PART, f"{name!r} cannot be called with this example: {reason}", fix="pass all arguments"
        ) from None
    except ValueError:
        pass  # some functions written in C have no signature
    try:
        plain = functools.partial(function)  # a neural network may not be hashable
        with jax.enable_x64(True):
            return jax.make_jaxpr(plain, return_shape=True)(*jax.tree.map(_native, example))
    except jax.errors.TracerArrayConversionError as reason:
        problem = f"{name!r} converts a value known only at run time to a numpy array: {str(reason).splitlines()[0]}"
        raise InputError(PART, problem, fix="use jax.numpy in place of numpy") from None
    except jax.errors.NonConcreteBooleanIndexError as reason:
        problem = (
            f"{name!r} has an array whose number of elements is known only at run time: {str(reason).splitlines()[0]}"
        )
        raise InputError(PART, problem, fix="use jnp.where(condition, x, 0)") from None
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerIntegerConversionError) as reason:
        problem = f"{name!r} branches in Python on a value known only at run time: {str(reason).splitlines()[0]}"
        raise InputError(PART, problem, fix="use jnp.where, jax.lax.cond or jax.lax.fori_loop") from None
    except TypeError as reason:
        if "not a valid JAX type" not in str(reason):
            raise
        raise InputError(
            PART, f"{name!r} does not return arrays: {str(reason).splitlines()[0]}", fix="return arrays"
        ) from None

"""The example that `trimtab.compile` is given: what it may be made of, and what JAX traces with it."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.core.errors import InputError

PART = "compile"
ARRAYS = jax.ShapeDtypeStruct | jax.Array | np.ndarray | np.generic | bool | int | float | complex
"""What an example may be made of."""


def check_example(example: tuple[Any, ...], name: str) -> None:
    """Refuse an example that is no tree of arrays of numbers."""
    try:
        leaves = jax.tree_util.tree_flatten_with_path(example)[0]
    except (ValueError, SystemError) as reason:  # such as keys of a dict that cannot be ordered, a list in itself
        raise InputError(PART, f"the example for {name!r} is no tree: {reason}", fix="use tuples and dicts") from None
    for path, value in leaves:
        where = f"argument {path[0].idx}{jax.tree_util.keystr(path[1:])} of the example for {name!r}"
        if not isinstance(value, ARRAYS):
            fix = "give arrays and numbers; fix what is none with functools.partial"
            raise InputError(PART, f"{where} is {type(value).__name__}, no array", fix=fix)
        if is_key(value):
            fix = "give jax.random.key_data(key), and begin with key = jax.random.wrap_key_data(words)"
            raise InputError(PART, f"{where} is a typed key", fix=fix)
        try:
            if not isinstance(value, jax.ShapeDtypeStruct):
                jax.typeof(_native(value))
        except (TypeError, ValueError, OverflowError) as reason:
            fix = "give arrays of float64, float32, integers or bool"
            raise InputError(PART, f"{where} cannot be used: {str(reason).splitlines()[0]}", fix=fix) from None


def check_results(shapes: Any, name: str) -> None:
    """Refuse results that numpy cannot hold."""
    for path, value in jax.tree_util.tree_flatten_with_path(shapes)[0]:
        if is_key(value):
            where = f"result{jax.tree_util.keystr(path)} of {name!r}"
            raise InputError(PART, f"{where} is a typed key", fix="return jax.random.key_data(key)")


def is_key(value: Any) -> bool:
    """Whether it is an array of keys of jax.random."""
    return isinstance(value, jax.Array | jax.ShapeDtypeStruct) and jaxprs.is_key(value)


def _native(value: Any) -> Any:
    """An array in this machine's order of bytes."""
    swapped = isinstance(value, np.ndarray | np.generic) and not value.dtype.isnative
    return value.astype(value.dtype.newbyteorder("=")) if swapped else value


def trace_example(function: Callable[..., Any], example: tuple[Any, ...], name: str) -> Any:
    """The jaxpr, and the shapes of what it gives."""
    if not callable(function):
        raise InputError(PART, f"{type(function).__name__} is no function", fix="compile(f, *example)")
    check_example(example, name)
    try:
        inspect.signature(function).bind(*example)
    except TypeError as reason:
        raise InputError(PART, f"{name!r} does not take this example: {reason}", fix="give all arguments") from None
    except ValueError:
        pass  # it has no signature, as functions written in C
    try:
        plain = functools.partial(function)  # a network may have no hash
        return jax.make_jaxpr(plain, return_shape=True)(*jax.tree.map(_native, example))
    except jax.errors.TracerArrayConversionError as reason:
        problem = f"{name!r} makes a numpy array of what is known only when it runs: {str(reason).splitlines()[0]}"
        raise InputError(PART, problem, fix="use jax.numpy in place of numpy") from None
    except jax.errors.NonConcreteBooleanIndexError as reason:
        problem = f"{name!r} picks a number of elements that is known only when it runs: {str(reason).splitlines()[0]}"
        raise InputError(PART, problem, fix="use jnp.where(condition, x, 0)") from None
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerIntegerConversionError) as reason:
        problem = f"{name!r} decides in Python on what is known only when it runs: {str(reason).splitlines()[0]}"
        raise InputError(PART, problem, fix="use jnp.where, jax.lax.cond or jax.lax.fori_loop") from None
    except TypeError as reason:
        if "not a valid JAX type" not in str(reason):
            raise
        raise InputError(
            PART, f"{name!r} returns no array: {str(reason).splitlines()[0]}", fix="return arrays"
        ) from None

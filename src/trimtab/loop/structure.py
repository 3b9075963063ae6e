"""Shapes of the data that parts exchange, found without running the parts, and errors that name two unfit parts."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, is_record
from trimtab.loop.own_code import CONVERSIONS, describe_fault


def zeros_of(part: str, reads: str, function: Callable[..., Any], *inputs: Any) -> Any:
    """Return the output of a function with every number zero; nothing is computed.

    Raises: InputError naming the part, its input and the faulty line if they don't fit.
    """
    try:
        shape = jax.eval_shape(function, *inputs)
    except InputError:
        raise
    except Exception as error:
        fault = describe_fault(error)
        name = type(inputs[-1]).__name__ if inputs else "nothing"
        problem = f"{fault.place}{fault.problem}"
        if not isinstance(error, CONVERSIONS):
            problem = f"does not fit {reads}, which gives {name}: {problem}"
        fix = fault.fix or f"give {part} an input that has what its step() reads, or use another part that reads {name}"
        raise InputError(part, problem, choices=fault.choices, fix=fix) from error
    return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)


def zeros_of_step(part: str, reads: str, step: Callable[..., Any], *inputs: Any) -> tuple[Any, Any]:
    """Return state and output of a step, every number zero. Raise InputError if the step gives no such pair."""
    pair = zeros_of(part, reads, step, *inputs)
    if not isinstance(pair, tuple) or len(pair) != 2:  # pyright: ignore[reportUnknownArgumentType]
        raise InputError(
            part,
            f"its step() must return (state, output), got {describe_tree(pair)}",
            fix="return (state, output) from step()",
        )
    state, output = pair  # pyright: ignore[reportUnknownVariableType]
    return state, output


def check_members(part: str, value: Any, interface: Any, optional: Iterable[str] = ()) -> None:
    """Raise InputError for a part that lacks a method or a field of its interface, with the code to write."""
    for name in (*vars(interface), *interface.__annotations__):
        if name.startswith("_") or name in optional or hasattr(value, name):
            continue
        member, kind = vars(interface).get(name), type(value).__name__
        if inspect.isfunction(member):
            arguments = ", ".join(inspect.signature(member).parameters)
            raise InputError(part, f"{kind} has no {name}()", fix=f"def {name}({arguments}): …  in {kind}")
        raise InputError(
            part, f"{kind} has no {name!r}", fix=f"{name} = …  in {kind}: {_first_line(member)}".strip(": ")
        )


def _first_line(member: Any) -> str:
    return (getattr(member, "__doc__", "") or "").partition("\n")[0]


def check_alike(part: str, what: str, value: Any, like: Any, fix: str) -> None:
    """Raise InputError for a value with another structure than a pattern's, or with a number of another shape."""
    if jax.tree.structure(value) != jax.tree.structure(like):
        raise InputError(part, f"{what} is {describe_tree(value)}, but must be {describe_tree(like)}", fix=fix)
    pairs = zip(jax.tree_util.tree_flatten_with_path(like)[0], jax.tree.leaves(value), strict=True)
    for (keys, wanted), own in pairs:
        name, shape = jax.tree_util.keystr(keys, simple=True, separator="."), np.shape(wanted)
        if np.shape(own) != shape and (len(np.shape(own)) > len(shape) or not _fits(np.shape(own), shape)):
            problem = f"{what} has {name or 'a number'} of shape {np.shape(own)}, but it must be {shape}"
            raise InputError(part, problem, fix=fix)


def _fits(shape: tuple[int, ...], whole: tuple[int, ...]) -> bool:
    return all(a in (1, b) for a, b in zip(reversed(shape), reversed(whole), strict=False))


def describe_tree(tree: Any) -> str:
    """Return a description of a tree: its record, or its count of numbers."""
    if is_record(tree):
        return f"a {type(tree).__name__} as declared"
    if isinstance(tree, Mapping):
        names: Any = tree.keys()  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
        return f"a dictionary of {', '.join(map(str, names)) or 'nothing'}"
    count = len(jax.tree.leaves(tree))
    return f"not a record, with {count} number{'s' * (count != 1)}" if count else "nothing"


def zeros_like(tree: Any) -> Any:
    """Return the tree, of shapes or of numbers, with every number zero, as NumPy arrays."""
    return jax.tree.map(lambda v: np.zeros(np.shape(v), jnp.result_type(v)), tree)


def step_if(due: Scalar, step: Callable[[], Any], hold: Callable[[], Any]) -> Any:
    """Return step() where due, else hold(); a plain call if due is known beforehand."""
    if due is True:
        return step()
    return jax.lax.cond(due, lambda: strengthen_types(step()), lambda: strengthen_types(hold()))


def strengthen_types(tree: Any) -> Any:
    """Return the tree with every number an array of a fixed type, as a loop's carry must be."""

    def fix(leaf: Any) -> Any:
        return jax.lax.convert_element_type(leaf, np.dtype(jnp.result_type(leaf)))

    return jax.tree.map(fix, tree)


def cast_like(tree: Any, pattern: Any) -> Any:
    """Return the tree with every number in the type of the pattern's."""
    return jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), tree, pattern)


def is_finite(tree: Any) -> Scalar:
    """Return True if every real number of a tree is finite."""
    floats = [v for v in map(jnp.asarray, jax.tree.leaves(tree)) if jnp.issubdtype(v.dtype, jnp.floating)]
    finite = jnp.asarray(True)
    for v in floats:
        finite = finite & jnp.all(jnp.isfinite(v))
    return finite

"""Arguments and results of a compiled function: their trees, shapes and types, checks and conversions."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from trimtab.compiler import jaxprs
from trimtab.compiler.example import array_type, is_key
from trimtab.compiler.identifiers import distinct
from trimtab.compiler.native.call import ArrayType, LoadedFunction, TreeNode, make_callable
from trimtab.core.errors import InputError
from trimtab.core.quantity import Option, declarations, is_record


class Arguments:
    """Arguments that a compiled function takes: those of its example, by tree, shapes and types.

    inputs: types of the arrays, flat.  nodes: tree of the arguments for the interface to Python. If the interface does
    not know the tree, it gets the arrays as flat arguments.
    """

    def __init__(self, function: Callable[..., Any], example: tuple[Any, ...], name: str, avals: Sequence[Any]) -> None:
        self._name, self._names = name, argument_names(function, len(example))
        self._structure = jax.tree.structure(example)
        self.inputs = [array_type(a) for a in avals]
        self._keys = [(i, a.keys) for i, a in enumerate(self.inputs) if a.keys is not None]
        nodes = None if self._keys else _tree_nodes(example)
        self._is_flat = nodes is None
        self.nodes = nodes or [TreeNode("tuple", tuple, len(self.inputs)), *([TreeNode("leaf")] * len(self.inputs))]

    def normaliser(self, of_runs: bool) -> Callable[..., Any]:
        """Return the function for arguments that the interface to Python can't use as they are. of_runs: arrays may
        have an axis of runs."""
        normalise = self._normalise_runs if of_runs else self._normalise
        return (lambda *leaves: normalise(*self._structure.unflatten(leaves))) if self._is_flat else normalise

    def make_callable(self, program: LoadedFunction) -> Callable[..., Any]:
        """Return a Python callable that runs a compiled function with these arguments."""
        call = make_callable(program)
        if not self._is_flat:
            return call

        def call_flat(*arguments: Any) -> Any:
            try:
                leaves, structure = jax.tree.flatten(arguments)
            except (ValueError, SystemError):  # not a tree
                leaves, structure = [], None
            if structure != self._structure:
                return call(*self._flatten(arguments)[0])  # raises InputError
            for i, kind in self._keys:
                if is_key(leaves[i]) and leaves[i].dtype == kind:
                    leaves[i] = jaxprs.words_of(leaves[i])
            return call(*leaves)

        return call_flat

    def place_named(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> tuple[Any, ...]:
        """Return the arguments in the order of the function, with the named ones at their places."""
        rest = dict(named)
        try:
            placed = (*arguments, *(rest.pop(n) for n in self._names[len(arguments) :]))
        except KeyError as missing:
            raise self.refusal(f"argument {missing.args[0]!r} is missing") from None
        if rest:
            raise self.refusal(f"the function has no argument {next(iter(rest))!r}", choices=self._names)
        return placed

    def _normalise(self, *arguments: Any) -> tuple[Any, ...]:
        return tuple(self._flatten(arguments)[0])

    def _normalise_runs(self, *arguments: Any) -> tuple[Any, ...]:
        leaves, runs = self._flatten(arguments, batch=True)
        return tuple(
            np.ascontiguousarray(np.broadcast_to(v, (runs, *a.shape))) for v, a in zip(leaves, self.inputs, strict=True)
        )

    def _flatten(self, arguments: tuple[Any, ...], batch: bool = False) -> tuple[list[Any], int]:
        """Return the arguments as contiguous arrays of the types of the C code, and the number of runs."""
        count = len(self._structure.children())
        if len(arguments) != count:
            raise self.refusal(f"needs {count} arguments ({', '.join(self._names)}), got {len(arguments)}")
        try:
            paths, structure = jax.tree_util.tree_flatten_with_path(arguments)
        except (ValueError, SystemError) as reason:  # e.g. dict keys without an order, or a list in itself
            raise self.refusal(f"the arguments are not a tree: {reason}") from None
        if structure != self._structure:
            raise self.refusal(f"the arguments have the structure {structure}, the example has {self._structure}")
        arrays = [self._array(p, v, a, batch) for (p, v), a in zip(paths, self.inputs, strict=True)]
        counts = {
            v.shape[0]: p for (p, _), v, a in zip(paths, arrays, self.inputs, strict=True) if v.ndim > len(a.shape)
        }
        if batch and len(counts) != 1:
            have = (
                ", ".join(f"{self._path(p)} has {n} runs" for n, p in counts.items()) or "no array has an axis of runs"
            )
            raise self.refusal(have, fix="give arrays an additional first axis, of the same length in all")
        return arrays, next(iter(counts), 1)

    def _array(self, path: Any, value: Any, wanted: ArrayType, batch: bool) -> Any:
        if isinstance(value, Tracer):
            raise self.refusal(
                f"{self._path(path)} is traced by JAX",
                fix="compile the transformed function, e.g. compile(jax.grad(f), x)",
            )
        if isinstance(value, np.ma.MaskedArray):
            raise self.refusal(f"{self._path(path)} has masked numbers", fix="fill them: x.filled(0.0)")
        if is_key(value):
            if value.dtype != wanted.keys:
                problem = f"{self._path(path)} is a random key of type {value.dtype}"
                raise self.refusal(f"{problem}, the example has {wanted.dtype if wanted.keys is None else wanted.keys}")
            value = jaxprs.words_of(value)
        try:
            found = np.asarray(value)
        except Exception as reason:  # the object's __array__ may raise any exception
            raise self.refusal(f"{self._path(path)} is not an array: {reason}") from None
        shapes = f"{wanted.shape}" + (f" or (runs, {str(wanted.shape)[1:]}" if batch else "")
        if found.shape != wanted.shape and not (batch and found.shape[1:] == wanted.shape and found.ndim):
            raise self.refusal(
                f"{self._path(path)} has shape {found.shape}, the example has {shapes}",
                fix="compile the function for these shapes as well",
            )
        if found.dtype != wanted.dtype and not _can_stand_for(value, found.dtype, wanted.dtype):
            fix = f"convert with .astype(np.{wanted.dtype.name}), or compile the function for {found.dtype}"
            raise self.refusal(f"{self._path(path)} has type {found.dtype}, the example has {wanted.dtype}", fix=fix)
        try:
            with np.errstate(over="ignore"):
                # numpy has several types for the same numbers, e.g. long long and int64; C code gets int64
                return np.require(found, wanted.dtype, ["C", "A"]).view(wanted.dtype)
        except (OverflowError, TypeError, ValueError) as reason:
            raise self.refusal(f"{self._path(path)}: {reason}") from None

    def _path(self, path: Any) -> str:
        return f"{self._names[path[0].idx]}{jax.tree_util.keystr(path[1:])}"

    def refusal(self, problem: str, **more: Any) -> InputError:
        """Return the error about an argument."""
        more.setdefault("fix", "pass the shapes and types of the example, or compile the function for these too")
        return InputError(f"compiled {self._name!r}", problem, **more)


class Results:
    """Results of a compiled function.

    outputs: types of the arrays, flat.  nodes: tree of the results for the interface to Python; None if `assemble`
    makes the tree.
    """

    def __init__(self, shapes: Any) -> None:
        leaves, self._structure = jax.tree.flatten(shapes)
        self.outputs = [array_type(a) for a in leaves]
        self._has_keys = any(a.keys is not None for a in self.outputs)
        self.nodes = None if self._has_keys else _tree_nodes(self._structure.unflatten(self.outputs), results=True)

    def assemble(self, arrays: tuple[Any, ...]) -> Any:
        """Return the tree of the results, with random keys in place of their words."""
        if self._has_keys:
            pairs = zip(arrays, self.outputs, strict=True)
            arrays = tuple(v if a.keys is None else jaxprs.wrap_words(v, a.keys) for v, a in pairs)
        return self._structure.unflatten(arrays)


def argument_names(function: Callable[..., Any], count: int) -> list[str]:
    """Return the names of a function's first arguments, and "argument0" and so on where they are not known."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        parameters = ()
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)][:count]
    for i in range(len(names), count):
        names.append(distinct(f"argument{i}", names))
    return names


def _can_stand_for(value: Any, given: np.dtype[Any], wanted: np.dtype[Any]) -> bool:
    """Return True if a value can be converted to another type without loss. Python numbers follow JAX's rules."""
    if type(value) is float:
        return wanted.kind == "f"
    if type(value) is int:
        limits = np.iinfo(wanted) if wanted.kind in "iu" else None
        return wanted.kind == "f" or (limits is not None and limits.min <= value <= limits.max)
    return given.kind in "biuf" and np.can_cast(given, wanted, "safe")


def _tree_nodes(tree: Any, results: bool = False) -> list[TreeNode] | None:
    """Return the nodes of a tree of tuples, lists, dicts and records, or None if it contains other nodes."""
    nodes = [] if results else None
    try:
        nodes = list(_walk(tree, results))
    except TypeError:
        return None
    return nodes


def _walk(tree: Any, results: bool) -> Any:
    parts: Sequence[Any] = ()
    if type(tree) in (tuple, list):
        yield TreeNode(type(tree).__name__, type(tree), len(tree))
        parts = tree
    elif isinstance(tree, tuple) and hasattr(tree, "_fields") and _is_own_parts(tree):
        yield TreeNode("named", type(tree), len(tree))
        parts = tree
    elif type(tree) is dict:
        keys = sorted(tree)
        yield TreeNode("dict", dict, len(tree), tuple(keys))
        parts = [tree[key] for key in keys]
    elif tree is None:
        yield TreeNode("none", type(None))
    elif is_record(tree) and not results:
        declared = declarations(type(tree))
        if any(isinstance(d, Option) for d in declared.values()):
            raise TypeError("options are part of the tree's structure, and only JAX compares structures")
        yield TreeNode("record", type(tree), len(declared), tuple(declared))
        parts = [getattr(tree, name) for name in declared]
    elif isinstance(tree, ArrayType) if results else jax.tree_util.all_leaves([tree]):
        yield TreeNode("leaf")
    else:
        raise TypeError("the tree contains an unsupported kind of node")
    for part in parts:
        yield from _walk(part, results)


def _is_own_parts(tree: tuple[Any, ...]) -> bool:
    """Return True if JAX splits a named tuple into its elements, not into other parts registered for its class."""
    parts, _ = jax.tree.flatten(tree, is_leaf=lambda x: x is not tree)
    return len(parts) == len(tree) and all(a is b for a, b in zip(parts, tree, strict=True))

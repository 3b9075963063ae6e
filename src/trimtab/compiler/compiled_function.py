"""Compilation of any JAX function: `trimtab.compile`."""

import inspect
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from trimtab.compiler.block import function_block
from trimtab.compiler.example import check_results, is_key, trace_example
from trimtab.compiler.folder import ExportedFolder, export_function
from trimtab.compiler.function import Function, FunctionText
from trimtab.compiler.identifiers import distinct, function_identifier, identifier
from trimtab.compiler.ir import TYPES
from trimtab.compiler.lower import CompilerFaultError, report_fault
from trimtab.compiler.native.build import build_library, load_library
from trimtab.compiler.native.call import ArrayType, LoadedFunction, TreeNode, array_addresses, make_callable
from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.core.errors import InputError
from trimtab.core.quantity import Option, declarations, is_record

LANES = (1, 4, 8)
VECTORS = 0.98
"""Largest fraction of operations in vectorised loops at which computing several runs side by side (in lanes) still
saves time."""
PART = "compile"


def compile(
    function: Callable[..., Any], *example: Any, lanes: int | None = None, threads: int = 1
) -> "CompiledFunction":
    """Compile a JAX function to C with the machine's own C compiler.

    >>> import jax.numpy as jnp
    >>> from trimtab import compile
    >>> f"{compile(jnp.sin, 0.0)(0.5):.12f}"
    '0.479425538604'

    Args:
        function: pure function. Its arguments and results are arrays, numbers, and trees of them (tuples, lists, dicts,
            records). It may be a gradient: ``compile(jax.grad(f), x)``.
        example: example arguments. The compiled function accepts arguments of the same shapes and types; the values
            of the example do not matter. Python numbers are float64 and int64. The function is traced with
            ``jax.enable_x64``; the user's own setting ``jax_enable_x64`` stays as it is.
        lanes: number of runs that `CompiledFunction.lanes` computes side by side: 1, 4 or 8. If given, the code for
            lanes is built at once. If None, `lanes` is the number that the CPU supports; or 1 if lanes do not
            support a type of the function, or if a single run is vectorised already, e.g. a product of large matrices.
        threads: number of threads that share the runs of `CompiledFunction.lanes`.

    Returns:
        A function with the same arguments, which returns the same trees with numpy arrays.

    Raises:
        InputError: if a JAX primitive cannot be written as C (the error names the Python line), the example does not
            consist of arrays, or no C compiler works. A fault of trimtab's own compiler is an InputError too, and its
            message states what to report.
    """
    return CompiledFunction(function, example, lanes, threads)


class CompiledFunction:
    """Compiled function: call it like the original, with the shapes and types of the example.

    Python numbers are accepted for arrays without axes. An array of another type is accepted if the conversion loses
    nothing, such as float32 for float64. Other arguments raise InputError before anything runs. Several threads may
    call the function at the same time.

    workspace: bytes of memory that a call needs for large arrays; 0 for small functions.
    """

    def __init__(self, function: Callable[..., Any], example: tuple[Any, ...], lanes: int | None, threads: int) -> None:
        """Trace, lower, build and load the function; see `compile`."""
        if lanes is not None and (isinstance(lanes, bool) or lanes not in LANES):
            raise InputError(
                PART, f"lanes must be one of the choices, got {lanes}", choices=map(str, LANES), fix="lanes=8, or None"
            )
        if not isinstance(threads, int) or isinstance(threads, bool) or threads < 1:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError(PART, f"threads must be at least 1, got {threads!r}", fix="threads=1")
        self.name = _function_name(function)
        self._symbol = f"trimtab_{identifier(self.name)}"  # not a name of a C library or a reserved word
        self._function, self._example, self._threads, self._lanes = function, example, threads, lanes
        self._names = _argument_names(function, len(example))
        program, shapes = trace_example(function, example, self.name)
        check_results(shapes, self.name)
        with report_fault(f"function {self.name!r}"):
            self._lowered = Function(program)
            self._structure = jax.tree.structure(example)
            leaves, self._gives = jax.tree.flatten(shapes)
            self._inputs = [ArrayType(a.shape, np.dtype(TYPES[a.dtype])) for a in self._lowered.inputs]
            self._outputs = [ArrayType(a.shape, np.dtype(a.dtype)) for a in leaves]
            self._lock = threading.Lock()
            self._many: Callable[..., Any] | None = None
            text = self._lowered.program_text(self._symbol, large_as_data=True)
            self.c_source, self.workspace = text.text, text.workspace
            self._program = self._load(text, 0)
            self._call = make_callable(self._program)
        if lanes is not None:
            self._lanes_call()

    def _load(self, text: FunctionText, lanes: int) -> LoadedFunction:
        library = load_library(build_library(text.text, "c++" if lanes else "c", extra=text.flags))
        if text.tables:
            library[f"{self._symbol}_tables"](array_addresses(text.tables))
        takes = _tree_nodes(self._example)
        return LoadedFunction(
            library[self._symbol],
            text.workspace,
            self._inputs,
            self._outputs,
            takes or [TreeNode("tuple", tuple, -1)],
            _tree_nodes(jax.tree.unflatten(self._gives, self._outputs), results=True),
            self._normalise,
            self._gives.unflatten,
        )

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the function with these arguments.

        Raises InputError if the structure, shapes or types of the arguments differ from those of the example.
        """
        if named:
            arguments = self._place_named(arguments, named)
        return self._call(*arguments)

    def lanes(self, *arguments: Any) -> Any:
        """Call the function for many runs. Each array has an additional first axis, the index of the run.

        An array of the example's own shape is the same for all runs. Results have the axis of runs, too. This is
        ``jax.vmap``, with runs computed side by side in lanes and shared by threads. Results equal those of single
        calls bit for bit.

        Raises:
            InputError: if shapes or types differ from those of the example, or no array has an axis of runs.
        """
        try:
            return (self._many or self._lanes_call())(*arguments)
        except MemoryError:
            each = f"{self.workspace} bytes of workspace for each of {self._threads} threads"
            raise self._refusal(f"not enough memory for {each}", fix="threads=1, or smaller arrays") from None

    def export(self, folder: str | Path, *, name: str | None = None) -> list[Path]:
        """Write the function as C99 for embedded use, with a test from the example's values. Return the files.

        `trimtab export --verify FOLDER` compiles the files, runs the test, and compares the results with JAX.

        Args:
            folder: folder of the files; created if it is missing.
            name: name of the C function; by default the name of the Python function.

        Raises:
            InputError: if the folder cannot be written.
        """
        return export_callable(self._function, self._example, Path(folder), name=name).files

    def _lanes_call(self) -> Callable[..., Any]:
        with self._lock:
            if self._many is None:
                lanes, program = self._build_lanes()
                more = {"lanes": lanes, "threads": self._threads, "normalise": self._normalise_runs}
                self._many = make_callable(program._replace(**more))
        return self._many

    def _build_lanes(self) -> tuple[int, LoadedFunction]:
        lanes = self._lanes
        if lanes is None:
            found = find_compiler("c++")
            alone = self._lowered.vector_share() > VECTORS
            lanes = lane_count(found) if found and not alone else 1
        if lanes == 1:
            return 1, self._program
        try:
            with report_fault(f"function {self.name!r} over lanes"):
                text = self._lowered.program_text(self._symbol, lanes, large_as_data=True)
        except CompilerFaultError:
            raise
        except InputError:
            if self._lanes is not None:
                raise
            return 1, self._program
        return lanes, self._load(text, lanes)

    def _place_named(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> tuple[Any, ...]:
        rest = dict(named)
        try:
            placed = (*arguments, *(rest.pop(n) for n in self._names[len(arguments) :]))
        except KeyError as missing:
            raise self._refusal(f"argument {missing.args[0]!r} is missing") from None
        if rest:
            raise self._refusal(f"the function has no argument {next(iter(rest))!r}", choices=self._names)
        return placed

    def _normalise(self, *arguments: Any) -> tuple[Any, ...]:
        return tuple(self._flatten(arguments)[0])

    def _normalise_runs(self, *arguments: Any) -> tuple[Any, ...]:
        leaves, runs = self._flatten(arguments, batch=True)
        return tuple(
            np.ascontiguousarray(np.broadcast_to(v, (runs, *a.shape)))
            for v, a in zip(leaves, self._inputs, strict=True)
        )

    def _flatten(self, arguments: tuple[Any, ...], batch: bool = False) -> tuple[list[Any], int]:
        """Return the arguments as contiguous arrays of the types of the C code, and the number of runs."""
        if len(arguments) != len(self._example):
            problem = f"needs {len(self._example)} arguments ({', '.join(self._names)}), got {len(arguments)}"
            raise self._refusal(problem)
        try:
            paths, structure = jax.tree_util.tree_flatten_with_path(arguments)
        except (ValueError, SystemError) as reason:  # e.g. dict keys without an order, or a list in itself
            raise self._refusal(f"the arguments are not a tree: {reason}") from None
        if structure != self._structure:
            raise self._refusal(f"the arguments have the structure {structure}, the example has {self._structure}")
        arrays = [self._array(p, v, a, batch) for (p, v), a in zip(paths, self._inputs, strict=True)]
        counts = {
            v.shape[0]: p for (p, _), v, a in zip(paths, arrays, self._inputs, strict=True) if v.ndim > len(a.shape)
        }
        if batch and len(counts) != 1:
            have = (
                ", ".join(f"{self._path(p)} has {n} runs" for n, p in counts.items()) or "no array has an axis of runs"
            )
            raise self._refusal(have, fix="give arrays an additional first axis, of the same length in all")
        return arrays, next(iter(counts), 1)

    def _array(self, path: Any, value: Any, wanted: ArrayType, batch: bool) -> Any:
        if isinstance(value, Tracer):
            raise self._refusal(
                f"{self._path(path)} is traced by JAX",
                fix="compile the transformed function, e.g. compile(jax.grad(f), x)",
            )
        if isinstance(value, np.ma.MaskedArray):
            raise self._refusal(f"{self._path(path)} has masked numbers", fix="fill them: x.filled(0.0)")
        if is_key(value):
            raise self._refusal(f"{self._path(path)} is a typed key", fix="pass jax.random.key_data(key)")
        try:
            found = np.asarray(value)
        except Exception as reason:  # the object's __array__ may raise any exception
            raise self._refusal(f"{self._path(path)} is not an array: {reason}") from None
        shapes = f"{wanted.shape}" + (f" or (runs, {str(wanted.shape)[1:]}" if batch else "")
        if found.shape != wanted.shape and not (batch and found.shape[1:] == wanted.shape and found.ndim):
            raise self._refusal(
                f"{self._path(path)} has shape {found.shape}, the example has {shapes}",
                fix="compile the function for these shapes as well",
            )
        if found.dtype != wanted.dtype and not _can_stand_for(value, found.dtype, wanted.dtype):
            fix = f"convert with .astype(np.{wanted.dtype.name}), or compile the function for {found.dtype}"
            raise self._refusal(f"{self._path(path)} has type {found.dtype}, the example has {wanted.dtype}", fix=fix)
        try:
            with np.errstate(over="ignore"):
                # numpy has several types for the same numbers, e.g. long long and int64; C code gets int64
                return np.require(found, wanted.dtype, ["C", "A"]).view(wanted.dtype)
        except (OverflowError, TypeError, ValueError) as reason:
            raise self._refusal(f"{self._path(path)}: {reason}") from None

    def __reduce__(self) -> Any:
        """Pickle and copy the function, example and options. The copy is compiled again."""
        return CompiledFunction, (self._function, self._example, self._lanes, self._threads)

    def _path(self, path: Any) -> str:
        return f"{self._names[path[0].idx]}{jax.tree_util.keystr(path[1:])}"

    def _refusal(self, problem: str, **more: Any) -> InputError:
        more.setdefault("fix", "pass the shapes and types of the example, or compile the function for these too")
        return InputError(f"compiled {self.name!r}", problem, **more)


def _can_stand_for(value: Any, given: np.dtype[Any], wanted: np.dtype[Any]) -> bool:
    """Return True if a value can be converted to another type without loss. Python numbers follow JAX's rules."""
    if type(value) is float:
        return wanted.kind == "f"
    if type(value) is int:
        limits = np.iinfo(wanted) if wanted.kind in "iu" else None
        return wanted.kind == "f" or (limits is not None and limits.min <= value <= limits.max)
    return given.kind in "biuf" and np.can_cast(given, wanted, "safe")


def export_callable(
    function: Callable[..., Any], example: tuple[Any, ...], folder: Path, *, name: str | None = None
) -> ExportedFolder:
    """Write a JAX function as C99 without compiling it; see `CompiledFunction.export`."""
    name = function_identifier(_function_name(function) if name is None else name)
    trace_example(function, example, name)  # raises InputError if the function cannot be traced
    arguments = jax.tree.map(_example_numbers, example)
    block = function_block(function, arguments, name, _argument_names(function, len(example)))
    return export_function(folder, block, function, arguments)


def _function_name(function: Callable[..., Any]) -> str:
    """Return the name of a function for messages; "function" if it has none."""
    name = getattr(function, "__name__", "")
    return name if isinstance(name, str) and name.isidentifier() else "function"


def _argument_names(function: Callable[..., Any], count: int) -> list[str]:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        parameters = ()
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)][:count]
    for i in range(len(names), count):
        names.append(distinct(f"argument{i}", names))
    return names


def _example_numbers(leaf: Any) -> Any:
    """Return an array of the example, with zeros if the example only states its shape."""
    return np.zeros(leaf.shape, leaf.dtype) if isinstance(leaf, jax.ShapeDtypeStruct) else np.asarray(leaf)


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


__all__ = ["CompiledFunction", "compile"]

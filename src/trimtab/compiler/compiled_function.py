"""Compilation of any JAX function: `trimtab.compile`."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.arguments import Arguments, Results, argument_names
from trimtab.compiler.block import function_block
from trimtab.compiler.example import array_type, is_key, trace_example
from trimtab.compiler.folder import ExportedFolder, export_function
from trimtab.compiler.function import Function, FunctionText
from trimtab.compiler.identifiers import function_identifier, identifier
from trimtab.compiler.lower import CompilerFaultError, report_fault
from trimtab.compiler.native.build import build_library, load_library
from trimtab.compiler.native.call import LoadedFunction, array_addresses
from trimtab.compiler.native.compiler import find_compiler, lane_count
from trimtab.core.errors import InputError

LANES = (1, 4, 8, 16)
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
        lanes: number of runs that `CompiledFunction.lanes` computes side by side: 1, 4 or 8, or 16 with AVX-512 for a
            function of 32-bit numbers. If given, the code for lanes is built at once. If None, `lanes` is the number
            that fits into a vector of the CPU; or 1 if lanes do not support a type of the function, or if a single
            run is vectorised already, e.g. a product of large matrices.
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
        program, shapes = trace_example(function, example, self.name)
        with report_fault(f"function {self.name!r}"):
            self._lowered = Function(program)
            self._arguments = Arguments(function, example, self.name, [v.aval for v in program.jaxpr.invars])
            self._results = Results(shapes)
            self._lock = threading.Lock()
            self._many: Callable[..., Any] | None = None
            text = self._lowered.program_text(self._symbol, large_as_data=True)
            self.c_source, self.workspace = text.text, text.workspace
            self._program = self._load(text, 0)
            self._call = self._arguments.make_callable(self._program)
        if lanes is not None:
            self._lanes_call()

    def _load(self, text: FunctionText, lanes: int) -> LoadedFunction:
        library = load_library(build_library(text.text, "c++" if lanes else "c", extra=text.flags))
        if text.tables:
            library[f"{self._symbol}_tables"](array_addresses(text.tables))
        return LoadedFunction(
            library[self._symbol],
            text.workspace,
            self._arguments.inputs,
            self._results.outputs,
            self._arguments.nodes,
            self._results.nodes,
            self._arguments.normaliser(of_runs=False),
            self._results.assemble,
        )

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the function with these arguments.

        Raises InputError if the structure, shapes or types of the arguments differ from those of the example.
        """
        if named:
            arguments = self._arguments.place_named(arguments, named)
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
            raise self._arguments.refusal(f"not enough memory for {each}", fix="threads=1, or smaller arrays") from None

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
                normalise = self._arguments.normaliser(of_runs=True)
                more = {"lanes": lanes, "threads": self._threads, "normalise": normalise}
                self._many = self._arguments.make_callable(program._replace(**more))
        return self._many

    def _build_lanes(self) -> tuple[int, LoadedFunction]:
        found = find_compiler("c++")
        width = lane_count(found) if found else 1  # doubles in a vector
        lanes, halves = self._lanes, width > 1 and self._lowered.has_half_width()
        if lanes is None:
            alone = self._lowered.vector_share() > VECTORS
            lanes = 1 if alone else 2 * width if halves else width
        if lanes == 1:
            return 1, self._program
        halves = halves and lanes == 2 * width
        if lanes == 16 and not halves:
            problem = f"16 lanes of {self.name!r} do not fit into a vector: they need AVX-512 and numbers of 32 bits"
            raise InputError(PART, problem, fix="lanes=8, or None")
        try:
            with report_fault(f"function {self.name!r} over lanes"):
                text = self._lowered.program_text(self._symbol, lanes, large_as_data=True, halves=halves)
        except CompilerFaultError:
            raise
        except InputError:
            if self._lanes is not None:
                raise
            return 1, self._program
        return lanes, self._load(text, lanes)

    def __reduce__(self) -> Any:
        """Pickle and copy the function, example and options. The copy is compiled again."""
        return CompiledFunction, (self._function, self._example, self._lanes, self._threads)


def export_callable(
    function: Callable[..., Any], example: tuple[Any, ...], folder: Path, *, name: str | None = None
) -> ExportedFolder:
    """Write a JAX function as C99 without compiling it; see `CompiledFunction.export`."""
    name = function_identifier(_function_name(function) if name is None else name)
    trace_example(function, example, name)  # raises InputError if the function cannot be traced
    arguments = jax.tree.map(_example_numbers, example)

    def of_words(*words: Any) -> Any:
        """Return the results, computed from the words of random keys; results that are keys become words."""
        given = jax.tree.map(lambda v, x: jaxprs.wrap_words(v, x.dtype) if is_key(x) else v, words, example)
        return jax.tree.map(lambda v: jax.random.key_data(v) if is_key(v) else v, function(*given))

    block = function_block(of_words, arguments, name, argument_names(function, len(example)))
    return export_function(folder, block, of_words, arguments)


def _function_name(function: Callable[..., Any]) -> str:
    """Return the name of a function for messages; "function" if it has none."""
    name = getattr(function, "__name__", "")
    return name if isinstance(name, str) and name.isidentifier() else "function"


def _example_numbers(leaf: Any) -> Any:
    """Return an array of the example, with zeros if the example only states its shape, and the words of a random
    key."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        of = array_type(leaf)
        return np.zeros(of.shape, of.dtype)
    return np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf)


__all__ = ["CompiledFunction", "compile"]

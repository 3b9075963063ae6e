"""Compiled functions as Python callables. A call adds much less than a microsecond.

The generated text is plain C that works on pointers. One small library, built once per machine, is the interface to
Python: it checks the arguments, passes the addresses of their numbers, and builds the results. This module describes
a compiled function to that library.
"""

import ctypes
import functools
import sys
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from trimtab.compiler.native.build import build_library
from trimtab.core.errors import InputError

KINDS = {"leaf": 0, "tuple": 1, "list": 2, "dict": 3, "none": 4, "record": 5, "named": 6}
NUMBERS = {"float64": "d", "float32": "f", "int64": "l", "int32": "i", "bool": "?"}
"""Scalar types for which a Python number can be passed -> letter of the type in arguments.c."""

FORMATS = {"float64": "d", "float32": "f", "bool": "?", "int8": "b", "int16": "h", "int32": "i", "int64": "q"}
FORMATS |= {"uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q"}
"""Array types -> their format letters in the buffer protocol, as `jax.Array` uses them."""
TEXTS = ("arguments.c", "batch.c", "call.c")


class TreeNode(NamedTuple):
    """Node of a tree of arguments or results. In a list of nodes, the parts of a node follow it.

    kind: a key of KINDS.
    cls: Python class of the node.
    parts: number of parts.
    keys: keys of a dict in JAX's order, or names of a record's fields.
    """

    kind: str
    cls: type | None = None
    parts: int = 0
    keys: tuple[str, ...] = ()


class ArrayType(NamedTuple):
    """Shape and type of an input or output array.

    keys: type of the random keys (`jax.random.key`) whose words are the numbers; None for an array of other numbers.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    keys: Any = None

    @property
    def width(self) -> int:
        """Return the size of the array in bytes."""
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize


class LoadedFunction(NamedTuple):
    """Compiled function, with the description of its arguments and results.

    function: C function `void f(const void *const *in, void *const *out, void *workspace, int32_t runs)`.
    workspace: bytes of memory that each call needs.
    inputs, outputs: types of the arrays.
    takes: tree of the arguments (a tuple). If its first node has -1 parts, `normalise` handles all arguments.
    gives: tree of the results; None if `assemble` builds the results from a flat tuple.
    normalise: all arguments -> flat tuple of contiguous arrays of the types of `inputs`; raises InputError.
    assemble: flat tuple of arrays -> tree of results.
    lanes: 0 for a single run; else the number of runs computed side by side. Arrays then have an axis of runs.
    threads: number of threads that share the runs.
    """

    function: Any
    workspace: int
    inputs: Sequence[ArrayType]
    outputs: Sequence[ArrayType]
    takes: Sequence[TreeNode]
    gives: Sequence[TreeNode] | None
    normalise: Callable[..., Any]
    assemble: Callable[..., Any]
    lanes: int = 0
    threads: int = 1


class _Node(ctypes.Structure):
    _fields_ = [
        ("kind", ctypes.c_int64),
        ("count", ctypes.c_int64),
        ("type", ctypes.c_void_p),
        ("keys", ctypes.c_void_p),
    ]


class _Leaf(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_void_p),
        ("scalar", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("axes", "numbers", "format", "width")),
        ("shape", ctypes.c_void_p),
        ("empty", ctypes.c_void_p),
    ]


class _Program(ctypes.Structure):
    _fields_ = [
        ("function", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("workspace", "n_in", "n_out", "lanes", "threads")),
        *((name, ctypes.c_void_p) for name in ("in", "out", "takes", "gives")),
        *((name, ctypes.c_void_p) for name in ("array", "python_float", "python_int", "python_bool", "empty", "none")),
        *((name, ctypes.c_void_p) for name in ("normalise", "assemble", "spare")),
    ]


@functools.cache
def _library() -> Any:
    """Return the library that calls compiled functions from Python. Its own functions are called with the GIL held."""
    text = "\n".join(files("trimtab.compiler.native").joinpath(name).read_text("utf-8") for name in TEXTS)
    extra = ("-pthread", *(("-undefined", "dynamic_lookup") if sys.platform == "darwin" else ()))
    locked = ctypes.PyDLL(str(build_library(f"#define HEAD {object.__basicsize__}\n{text}", extra=extra)))
    locked.trimtab_callable.restype = ctypes.py_object
    locked.trimtab_callable.argtypes = [ctypes.c_void_p, ctypes.py_object]
    argument_types = [ctypes.py_object] * 3 + [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.py_object]
    locked.trimtab_knows_arrays.argtypes = argument_types
    probe = np.zeros((3, 5))
    if sys.implementation.name != "cpython" or not locked.trimtab_knows_arrays(
        probe, np.ndarray, probe.dtype, probe.ctypes.data, *probe.shape, np.float64(np.pi)
    ):
        problem = f"in Python {sys.version.split()[0]}, numpy {np.__version__} does not have the expected array layout"
        raise InputError("compile", problem, fix="use CPython with numpy 1.24 or newer")
    return locked


def make_callable(program: LoadedFunction) -> Callable[..., Any]:
    """Return a Python callable that runs a compiled function. Several threads may call it at the same time."""
    kept: list[Any] = [program]
    made = _Program()
    made.function = ctypes.cast(program.function, ctypes.c_void_p).value
    made.workspace, made.n_in, made.n_out = program.workspace, len(program.inputs), len(program.outputs)
    made.lanes, made.threads = program.lanes, program.threads
    setattr(made, "in", _pointer(_leaf_array(program.inputs, kept), kept))
    made.out = _pointer(_leaf_array(program.outputs, kept), kept)
    made.takes = _pointer(_node_array(program.takes, kept), kept)
    made.gives = _pointer(_node_array(program.gives or (), kept), kept)
    made.array, made.empty = _object(np.ndarray, kept), _object(np.empty, kept)
    made.python_float, made.python_int, made.python_bool = (_object(t, kept) for t in (float, int, bool))
    made.none, made.normalise = _object(None, kept), _object(program.normalise, kept)
    made.assemble = None if program.gives is not None else _object(program.assemble, kept)
    return _library().trimtab_callable(_pointer(made, kept), kept)


def _object(thing: Any, kept: list[Any]) -> int:
    kept.append(thing)
    return id(thing)


def _pointer(thing: Any, kept: list[Any]) -> int:
    kept.append(thing)
    return ctypes.addressof(thing)


def _numbers(numbers: Sequence[int]) -> Any:
    return (ctypes.c_int64 * max(len(numbers), 1))(*numbers)


def array_addresses(arrays: Sequence[Any]) -> Any:
    """Return a C array of pointers to the data of these arrays. The arrays must stay alive while it is used."""
    return (ctypes.c_void_p * max(len(arrays), 1))(*[a.ctypes.data for a in arrays])


def _leaf_array(arrays: Sequence[ArrayType], kept: list[Any]) -> Any:
    made = (_Leaf * max(len(arrays), 1))()
    for leaf, a in zip(made, arrays, strict=False):
        leaf.type, leaf.axes = _object(a.dtype, kept), len(a.shape)
        leaf.scalar = None if a.shape else _object(a.dtype.type, kept)
        leaf.numbers = 0 if a.shape else ord(NUMBERS.get(a.dtype.name, "\0"))
        leaf.format, leaf.width = ord(FORMATS.get(a.dtype.name, "\0")), a.width
        leaf.shape = _pointer(_numbers(a.shape), kept)
        leaf.empty = _object((a.shape, a.dtype), kept)
    return made


def _node_array(nodes: Sequence[TreeNode], kept: list[Any]) -> Any:
    made = (_Node * max(len(nodes), 1))()
    for node, n in zip(made, nodes, strict=False):
        node.kind, node.count = KINDS[n.kind], n.parts
        node.type = None if n.cls is None else _object(n.cls, kept)
        keys = (ctypes.c_void_p * max(len(n.keys), 1))(*[_object(key, kept) for key in n.keys])
        node.keys = _pointer(keys, kept)
    return made

"""Any JAX function as a compiled one: traced, lowered, written and called through pointers to arrays."""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.analysis import find_varying, prune
from trimtab.compiler.arrays import Array, is_small, scalars
from trimtab.compiler.elementary import preamble_text
from trimtab.compiler.ir import TYPES, Buffer, Builder, Value
from trimtab.compiler.lower import Lowering
from trimtab.compiler.rules import RULES
from trimtab.compiler.text import C_TYPES
from trimtab.compiler.writer import Writer
from trimtab.core.errors import InputError
from trimtab.native.build import build_library, load_library


class Function:
    """A lowered function: its program, what goes in and what comes out, as flat lists of arrays."""

    def __init__(self, jaxpr: Any, real: str = "f64", hoist: bool = False) -> None:
        self.b = Builder(hoist)
        lowering = Lowering(self.b, RULES, real)
        indexed = jaxprs.indexed_inputs(jaxpr.jaxpr)
        self.inputs = [
            parameter_array(v.aval.shape, lowering.type_name(v.aval.dtype), i in indexed)
            for i, v in enumerate(jaxpr.jaxpr.invars)
        ]
        self.outputs = lowering.lower_program(jaxpr, self.inputs, [False] * len(self.inputs))
        kept = [v for a in self.outputs if a.items is not None for v in a.items.ravel()]
        self.live = prune([self.b.prologue, self.b.top], kept, [a.buffer for a in self.outputs if a.buffer is not None])

    def text(self, name: str, lanes: int = 0) -> str:
        """C, or C++ over lanes, of `void name(const void *const *in, void *const *out, int32_t runs)`."""
        blocks = [self.b.prologue, self.b.top]
        inputs = [thing for a in self.inputs for thing in ([a.buffer] if a.items is None else a.items.ravel())]
        varying = find_varying(blocks, inputs, []) if lanes else None
        w = Writer({}, self.live, varying)
        w.note_sincos(blocks)
        for i, a in enumerate(self.inputs):
            _load_input(w, i, a, lanes)
        for block in blocks:
            w.write_block(block)
        for i, a in enumerate(self.outputs):
            _store_output(w, i, a, lanes)
        arguments = "const void *const *in, void *const *out, int32_t runs"
        head = f"{'extern ' + chr(34) + 'C' + chr(34) + ' ' if lanes else ''}void {name}({arguments})\n{{"
        return "\n".join([preamble_text(w, lanes), head, *w.lines, "    (void)in; (void)out; (void)runs;", "}\n"])


def parameter_array(shape: tuple[int, ...], dtype: str, in_memory: bool) -> Array:
    """An array that is given: scalars, or a buffer where it is large or indexed."""
    size = math.prod(shape)
    if is_small(shape) and not in_memory:
        return scalars([Value("input", (), dtype) for _ in range(size)], shape, dtype)
    return Array(shape, dtype, buffer=Buffer(dtype, size, "input"))


def _load_input(w: Writer, i: int, a: Array, lanes: int) -> None:
    T = C_TYPES[a.dtype]
    source = f"((const {T} *)in[{i}])"
    if a.items is None:
        assert a.buffer is not None
        name = w.names[id(a.buffer)] = f"in{i}"
        if not lanes:
            w.write_line(f"const {T} *{name} = in[{i}];")
            return
        w.write_line(f"{w.type(a.dtype, True)} {name}[{max(a.size, 1)}];")
        minus = "-(int64_t)" if a.dtype == "bool" else ""
        read = f"{minus}{source}[(l < runs ? l : 0) * {a.size} + j]"
        w.write_line(f"for (int32_t j = 0; j < {a.size}; j++) EACH_LANE {name}[j][l] = {read};")
        return
    for j, v in enumerate(a.items.ravel()):
        if id(v) not in w.live:
            continue
        name = w.names[id(v)] = f"in{i}_{j}"
        if lanes:
            minus = "-(int64_t)" if a.dtype == "bool" else ""
            w.write_line(f"{w.type(a.dtype, True)} {name};")
            w.write_line(f"EACH_LANE {name}[l] = {minus}{source}[(l < runs ? l : 0) * {a.size} + {j}];")
        else:
            w.write_line(f"const {T} {name} = {source}[{j}];")


def _store_output(w: Writer, i: int, a: Array, lanes: int) -> None:
    T = C_TYPES[a.dtype]
    target = f"(({T} *)out[{i}])"
    if a.items is not None:
        for j, v in enumerate(a.items.ravel()):
            if lanes:
                w.write_line(
                    f"EACH_LANE if (l < runs) {target}[l * {a.size} + {j}] = {_lane_number(w.vector_text(v), a.dtype)};"
                )
            else:
                w.write_line(f"{target}[{j}] = {w.name(v)};")
        return
    assert a.buffer is not None
    name, offset = w.name(a.buffer), "" if a.offset is None else f" + {w.name(a.offset)}"
    wide = w.varies(a.buffer)
    if lanes:
        value = _lane_number(f"{name}[j{offset}]", a.dtype) if wide else f"{name}[j{offset}]"
        w.write_line(
            f"for (int32_t j = 0; j < {a.size}; j++) EACH_LANE if (l < runs) {target}[l * {a.size} + j] = {value};"
        )
    else:
        w.write_line(f"for (int32_t j = 0; j < {a.size}; j++) {target}[j] = {name}[j{offset}];")


def _lane_number(text: str, dtype: str) -> str:
    return f"({text})[l] != 0" if dtype == "bool" else f"({text})[l]"


def lower_function(function: Callable[..., Any], arguments: Sequence[Any], real: str = "f64") -> Function:
    """A JAX function lowered for arguments of these shapes and types."""
    return Function(jax.make_jaxpr(function)(*arguments), real)


def compile_function(function: Callable[..., Any], *example: Any) -> Callable[..., Any]:
    """A JAX function compiled by the machine's C compiler.

    Args:
        function: pure; arrays, scalars and trees of them in and out.
        example: arguments; their shapes and types are those that the compiled function takes, numbers play no part.

    Returns:
        A function of the same arguments that gives the same trees, of numpy arrays.

    Raises:
        InputError: a primitive without C text, naming the line that made it; or no C compiler.
    """
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*example)
    made = Function(program)
    call = load_library(build_library(made.text("trimtab_call"))).trimtab_call
    call.restype = None
    outputs, tree = jax.tree.flatten(shapes)
    wanted = jax.tree.structure(example)

    def run_compiled(*arguments: Any) -> Any:
        flat, given = jax.tree.flatten(arguments)
        if given != wanted:
            raise InputError("compiled function", f"takes {wanted}, was given {given}", fix="pass the same trees")
        held = [np.asarray(v, TYPES[a.dtype], order="C") for v, a in zip(flat, made.inputs, strict=True)]
        for v, a in zip(held, made.inputs, strict=True):
            if v.shape != a.shape:
                problem = f"an argument has shape {v.shape}, wanted is {a.shape}"
                raise InputError("compiled function", problem, fix="compile it for these shapes")
        results = [np.empty(o.shape, o.dtype) for o in outputs]
        call(_pointer_array(held), _pointer_array(results), ctypes.c_int32(1))
        return jax.tree.unflatten(tree, results)

    return run_compiled


def _pointer_array(arrays: list[Any]) -> Any:
    return (ctypes.c_void_p * max(len(arrays), 1))(*[a.ctypes.data for a in arrays])

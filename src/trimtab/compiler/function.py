"""Tracing, lowering and C text of any JAX function. The C function is called with pointers to arrays."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax

from trimtab.compiler import jaxprs
from trimtab.compiler.analysis import find_varying, prune, vector_share
from trimtab.compiler.arrays import Array, is_small, scalars
from trimtab.compiler.elementary import preamble_text
from trimtab.compiler.ir import Builder, Local
from trimtab.compiler.lane_width import has_half_width
from trimtab.compiler.lower import Lowering
from trimtab.compiler.pieces import PieceFrame, build_level, plan_pieces
from trimtab.compiler.rules import RULES
from trimtab.compiler.tables import filling_text, table_numbers
from trimtab.compiler.text import C_TYPES
from trimtab.compiler.uniform import branch_uniform_selects
from trimtab.compiler.values import Buffer, Value
from trimtab.compiler.workspace import CALL_STACK, plan_workspace
from trimtab.compiler.writer import Writer


class Function:
    """Lowered function: its program, and its inputs and outputs as flat lists of arrays."""

    def __init__(self, jaxpr: Any, real: str = "f64", hoist: bool = False) -> None:
        self.b = Builder(hoist)
        lowering = Lowering(self.b, RULES, real)
        lowering.check_sizes([*jaxpr.jaxpr.invars, *jaxpr.jaxpr.constvars])
        indexed = jaxprs.indexed_inputs(jaxpr.jaxpr)
        self.inputs = [
            parameter_array(
                jaxprs.physical_shape(v.aval), lowering.type_name(jaxprs.physical_type(v.aval)), i in indexed
            )
            for i, v in enumerate(jaxpr.jaxpr.invars)
        ]
        with jax.enable_x64(True):
            self.outputs = lowering.lower_program(jaxpr, self.inputs, [False] * len(self.inputs))
        kept = [v for a in self.outputs if a.items is not None for v in a.items.ravel()]
        self.blocks = [self.b.prologue, self.b.top]
        self.live = prune(self.blocks, kept, [a.buffer for a in self.outputs if a.buffer is not None])

    def text(self, name: str, lanes: int = 0) -> str:
        """Return the C text, or C++ text for lanes, of `void name(const void *const *in, void *const *out, void *,
        int32_t)`."""
        return self.program_text(name, lanes).text

    def program_text(
        self, name: str, lanes: int = 0, large_as_data: bool = False, halves: bool = False
    ) -> "FunctionText":
        """Return the C text (C++ for lanes), the size of the workspace that the caller provides, and large tables.

        halves: the lanes hold numbers of 32 bits, see `has_half_width`.
        """
        blocks = self.blocks
        varying = find_varying(blocks, _array_contents(self.inputs), []) if lanes else None
        if varying is not None:
            blocks = branch_uniform_selects(blocks, varying, _array_contents(self.outputs))
        names = {} if lanes else self._result_names()
        operands = [a.buffer for a in self.inputs if a.buffer is not None] if lanes else []
        results = [a.buffer for a in self.outputs if a.buffer is not None]
        workspace = plan_workspace(blocks, operands, results, lanes, varying, names, CALL_STACK)
        w = Writer(names, self.live, varying, workspace)
        w.data = [] if large_as_data else None
        w.note_sincos(blocks)
        for i, a in enumerate(self.inputs):
            _load_input(w, i, a, lanes)
        for i, a in enumerate(self.outputs):
            if a.buffer is not None and id(a.buffer) in w.names and w.names[id(a.buffer)] == f"out{i}":
                w.write_line(f"{C_TYPES[a.dtype]} *restrict out{i} = out[{i}];")
        given = [("void *", "workspace")] if workspace.size else []
        w.divide(plan_pieces(blocks, _array_contents(self.outputs), names), PieceFrame(name, lanes, given))
        for block in blocks:
            w.write_block(block)
        for i, a in enumerate(self.outputs):
            _store_output(w, i, a, lanes)
        frame, size = w.frame.place(workspace.size)
        arguments = "const void *const *in, void *const *out, void *workspace, int32_t runs"
        linkage = 'extern "C" ' if lanes else ""
        head = f"{linkage}void {name}({arguments})\n{{"
        silence = "    (void)in; (void)out; (void)workspace; (void)runs;"
        text = "\n".join([preamble_text(w, lanes, halves), w.frame.text(), head, frame, *w.lines, silence, "}\n"])
        data = w.data or []
        tables = [table_numbers(buffer) for buffer in data]
        text += filling_text(name, [w.names[id(buffer)] for buffer in data], tables, linkage)
        return FunctionText(text, size, tables, build_level(blocks, lanes))

    def vector_share(self) -> float:
        """Return the fraction of the function's operations that a C compiler vectorises in a single run."""
        return vector_share(self.blocks)

    def has_half_width(self) -> bool:
        """Return True if nearly all numbers that differ between lanes have 32 bits."""
        inputs = _array_contents(self.inputs)
        return has_half_width(self.blocks, find_varying(self.blocks, inputs, []), inputs)

    def _result_names(self) -> dict[int, str]:
        """Return the C name of the caller's array, e.g. out0, for each result's buffer that can be in the caller's
        memory."""
        own = {id(i.buffer) for block in (self.b.prologue, self.b.top) for i in block.items if isinstance(i, Local)}
        names: dict[int, str] = {}
        for i, a in enumerate(self.outputs):
            whole = a.buffer is not None and a.offset is None and a.buffer.size == a.size
            if whole and id(a.buffer) in own and id(a.buffer) not in names:
                names[id(a.buffer)] = f"out{i}"
        return names


class FunctionText(NamedTuple):
    """C text of a function.

    workspace: bytes of memory, aligned to 64, that the caller provides.
    tables: arrays that are passed to `NAME_tables` once, before the first call.
    flags: compiler flags in addition to the usual ones.
    """

    text: str
    workspace: int
    tables: list[Any]
    flags: tuple[str, ...] = ()


def _array_contents(arrays: list[Array]) -> list[Any]:
    """Return the values and buffers of these arrays, including the offsets into buffers."""
    return [
        thing
        for a in arrays
        for thing in ([a.buffer, *([] if a.offset is None else [a.offset])] if a.items is None else a.items.ravel())
    ]


def parameter_array(shape: tuple[int, ...], dtype: str, in_memory: bool) -> Array:
    """Return an input array: scalars, or a buffer if the array is large or must be in memory."""
    size = math.prod(shape)
    if is_small(shape) and not in_memory:
        return scalars([Value("input", (), dtype) for _ in range(size)], shape, dtype)
    return Array(shape, dtype, buffer=Buffer(dtype, size, "input"))


def _load_input(w: Writer, i: int, a: Array, lanes: int) -> None:
    T = C_TYPES[a.dtype]
    source = f"((const {T} *)in[{i}])"
    if a.items is None:
        assert a.buffer is not None
        name = f"in{i}"
        if not lanes:
            w.names[id(a.buffer)] = name
            w.write_line(f"const {T} *{name} = in[{i}];")
            return
        w.declare_buffer(a.buffer, name)
        minus = "-(tt_mask)" if a.dtype == "bool" else ""
        read = f"{minus}{source}[(l < runs ? l : 0) * INT64_C({a.size}) + j]"
        w.write_line(f"for (int32_t j = 0; j < {a.size}; j++) EACH_LANE {name}[j][l] = {read};")
        return
    for j, v in enumerate(a.items.ravel()):
        if id(v) not in w.live:
            continue
        name = w.names[id(v)] = f"in{i}_{j}"
        if lanes:
            read = f"{w.note_use(f'tv_gather_{a.dtype}')}({source} + {j}, {a.size}, runs)"
            w.write_line(f"const {w.type(a.dtype, True)} {name} = {read};")
        else:
            w.write_line(f"const {T} {name} = {source}[{j}];")


def _store_output(w: Writer, i: int, a: Array, lanes: int) -> None:
    T = C_TYPES[a.dtype]
    target = f"(({T} *)out[{i}])"
    if a.items is not None:
        for j, v in enumerate(a.items.ravel()):
            if lanes:
                write = w.note_use(f"tv_scatter_{a.dtype}")
                w.write_line(f"{write}({target} + {j}, {a.size}, runs, {w.vector_text(v)});")
            else:
                w.write_line(f"{target}[{j}] = {w.name(v)};")
        return
    assert a.buffer is not None
    name, offset = w.name(a.buffer), "" if a.offset is None else f" + {w.name(a.offset)}"
    wide = w.varies(a.buffer)
    if name == f"out{i}":
        return
    if lanes:
        value = _lane_number(f"{name}[j{offset}]", a.dtype) if wide else f"{name}[j{offset}]"
        w.write_line(
            f"for (int32_t j = 0; j < {a.size}; j++) "
            f"EACH_LANE if (l < runs) {target}[l * INT64_C({a.size}) + j] = {value};"
        )
    else:
        w.write_line(f"for (int32_t j = 0; j < {a.size}; j++) {target}[j] = {name}[j{offset}];")


def _lane_number(text: str, dtype: str) -> str:
    return f"({text})[l] != 0" if dtype == "bool" else f"({text})[l]"


def lower_function(function: Callable[..., Any], arguments: Sequence[Any], real: str = "f64") -> Function:
    """Lower a JAX function for arguments of the shapes and types of `arguments`."""
    with jax.enable_x64(True):
        return Function(jax.make_jaxpr(function)(*arguments), real)

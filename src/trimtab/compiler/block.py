"""C text of a block: structs of its parameters, state, input and output, and the functions that work on them.

State is read and written in place, so that its large arrays are never copied.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.analysis import prune
from trimtab.compiler.arrays import Array, copy_array, copy_into, is_small, scalars
from trimtab.compiler.c_functions import helper_texts
from trimtab.compiler.elementary import INCLUDES, LICENCE_NOTE, used_elementary_text
from trimtab.compiler.ir import Block, Builder, If, Local, Loop
from trimtab.compiler.lower import Lowering, report_fault
from trimtab.compiler.pieces import PieceFrame, build_level, plan_pieces
from trimtab.compiler.rules import RULES
from trimtab.compiler.structs import Member, comment_text, members, struct_text
from trimtab.compiler.text import C_TYPES, number_literal
from trimtab.compiler.values import Buffer, Value
from trimtab.compiler.workspace import plan_workspace
from trimtab.compiler.writer import Writer


class BlockDefinition(NamedTuple):
    """Definition of a block, from which the block's C text is generated.

    Attributes:
        name: prefix of all names in the C text.
        doc: one-line description of the block, for the C header.
        step: pure function (parameters, state, input) -> (state, output).
        init: function from the parameters to the initial state.
        parameters: tree of records of numbers: the parameters with their defaults.
        input: tree of records with the shapes of the input; the values are not used.
    """

    name: str
    doc: str
    step: Callable[[Any, Any, Any], tuple[Any, Any]]
    init: Callable[[Any], Any]
    parameters: Any
    input: Any


class BlockText(NamedTuple):
    """C text of a block, and the members of its structs.

    workspace: size (bytes) of the memory, aligned to 64 bytes, that is the last argument of the block's functions; 0 if
        they need no such argument.
    is_function: True if the block has neither parameters nor state. It is then a single C function of the same name.
    frame: size (bytes) on the stack of the values that the pieces of a large function share; 0 if there are no such
        values, or if they are in the workspace.
    flags: compiler flags in addition to the usual ones.
    """

    name: str
    header: str
    source: str
    inputs: list[Member]
    outputs: list[Member]
    parameters: list[Member]
    workspace: int = 0
    is_function: bool = False
    frame: int = 0
    flags: tuple[str, ...] = ()

    def call(self, p: str, s: str, in_: str, out: str, workspace: str) -> str:
        """Return the C statement that calls the step."""
        name = self.name if self.is_function else f"{self.name}_step"
        given = [in_, out] if self.is_function else [p, s, in_, out]
        return f"{name}({', '.join([*given, *([workspace] if self.workspace else [])])});"


def function_block(
    function: Callable[..., Any], example: tuple[Any, ...], name: str, names: list[str]
) -> BlockDefinition:
    """Return a pure function as a block without parameters and state. names: names of the function's arguments."""

    def step(p: Any, s: Any, given: dict[str, Any]) -> tuple[Any, Any]:
        return s, function(*(given[n] for n in names))

    return BlockDefinition(name, f"{name} as C.", step, lambda p: (), (), dict(zip(names, example, strict=True)))


def block_text(block: BlockDefinition, real: str = "f64") -> BlockText:
    """Return the C text of a block. real: "f64" computes in double, "f32" in float."""
    with jax.enable_x64(True):
        begin, state = jax.make_jaxpr(block.init, return_shape=True)(block.parameters)
        each, shapes = jax.make_jaxpr(block.step, return_shape=True)(block.parameters, state, block.input)
        with report_fault(f"block {block.name!r}"):
            return _traced_block_text(block, real, (begin, state), (each, shapes))


def _traced_block_text(block: BlockDefinition, real: str, init: tuple[Any, Any], step: tuple[Any, Any]) -> BlockText:
    """Return the C text of a block. init, step: the traced functions, each with the shapes of its results."""
    name, (begin, state), (each, shapes) = block.name, init, step
    P, S = members(block.parameters, real), members(state, real)
    IN, OUT = members(block.input, real), members(shapes[1], real)
    starting = _Routine(begin, [StructPlace("p->", P)], [StructPlace("s->", S)], real)
    sources = [StructPlace("p->", P), StructPlace("s->", S, True), StructPlace("in->", IN)]
    stepping = _Routine(each, sources, [StructPlace("s->", S), StructPlace("out->", OUT)], real)
    w = Writer({}, set())
    alone = not P and not S
    bodies = [
        starting.write_body(w, f"{name}_init", [(f"const {name}_params *", "p"), (f"{name}_state *", "s")]),
        stepping.write_body(w, name if alone else f"{name}_step", _step_arguments(name, alone)),
    ]
    bounded = not any(r.has_data_dependent_loop() for r in (starting, stepping))
    size, frame = max(body.workspace for body in bodies), max(body.frame for body in bodies)
    header = _header_text(name, block.doc, real, {"params": P, "state": S, "in": IN, "out": OUT}, bounded, size, frame)
    tables, defaults = _default_lines(P, [np.asarray(v) for v in jax.tree.leaves(block.parameters)])
    parts = [
        LICENCE_NOTE,
        f'#include "{name}.h"\n',
        INCLUDES,
        used_elementary_text(w),
        helper_texts(w.used),
        *w.tables,
        *tables,
    ]
    heads = _function_heads(name, size, alone)
    unused = [["p"], ["p", "s"], ["p", "s", "in", "out"]]
    parts += [body.pieces for body in bodies if body.pieces]
    for head, lines, silenced in zip(heads, (defaults, *(body.lines for body in bodies)), unused, strict=True):
        if head:
            places = [n for n in silenced if not alone or n in ("in", "out")]
            places += ["workspace"] if "*workspace" in head else []
            parts.append(_step_function_text(head, lines, places))
    level = max((build_level(r.blocks) for r in (starting, stepping)), default=())
    return BlockText(name, header, "\n".join(parts), IN, OUT, P, size, alone, frame, level)


def _step_arguments(name: str, alone: bool) -> list[tuple[str, str]]:
    """Return the types and names of the arguments of the step function, without the workspace."""
    own = [] if alone else [(f"const {name}_params *", "p"), (f"{name}_state *", "s")]
    return [*own, (f"const {name}_in *", "in"), (f"{name}_out *", "out")]


def _function_heads(name: str, workspace: int, alone: bool) -> tuple[str, str, str]:
    """Return the C declarations of the functions defaults, init and step. For a pure function, only step is
    declared."""
    more = ", void *workspace" if workspace else ""
    if alone:
        return "", "", f"{name}(const {name}_in *in, {name}_out *out{more})"
    arguments = ", ".join(f"{kind}{argument}" for kind, argument in _step_arguments(name, False))
    init = f"{name}_init(const {name}_params *p, {name}_state *s{more})"
    return f"{name}_defaults({name}_params *p)", init, f"{name}_step({arguments}{more})"


def _step_function_text(head: str, lines: list[str], unused: list[str]) -> str:
    silence = " ".join(f"(void){name};" for name in unused)
    return "\n".join([f"void {head}", "{", *lines, f"    {silence}", "}\n"])


def _header_text(
    name: str, doc: str, real: str, structs: dict[str, list[Member]], bounded: bool, workspace: int, frame: int
) -> str:
    guard = f"{name.upper()}_H"
    docs = {
        "params": "Parameters; the defaults are those of the scenario.",
        "state": "State kept between steps.",
        "in": "Inputs of a step.",
        "out": "Outputs of a step.",
    }
    loops = (
        "every loop is bounded"
        if bounded
        else "the length of some loops depends on data, so the execution time has no known bound"
    )
    alone = not structs["params"] and not structs["state"]
    if alone:
        structs, docs = {kind: structs[kind] for kind in ("in", "out")}, {"in": "Arguments.", "out": "Results."}
    typedefs = [struct_text(f"{name}_{kind}", m, docs[kind]) for kind, m in structs.items()]
    heads = [f"void {head};\n" if head else "" for head in _function_heads(name, workspace, alone)]
    calls = [
        f"/* Set all parameters to their defaults. */\n{heads[0]}",
        f"/* Set the state to its value before the first step. */\n{heads[1]}",
        f"/* Compute one step. No memory is allocated, no state is kept outside *s, {loops}. */\n{heads[2]}",
    ]
    if alone:
        calls = [f"/* Compute the results. No memory is allocated, no state is kept, {loops}. */\n{heads[2]}"]
    if workspace:
        size = f"enum {{ {name.upper()}_WORKSPACE = {workspace} }};\n"
        calls.insert(
            0, f"/* Bytes of memory at `workspace`, aligned to 64. Its content is not kept between calls. */\n{size}"
        )
    if frame:
        size = f"enum {{ {name.upper()}_FRAME = {frame} }};\n"
        calls.insert(0, f"/* Bytes of stack that a step uses for the values that its functions share. */\n{size}")
    plus = '#ifdef __cplusplus\nextern "C" {\n#endif\n', "#ifdef __cplusplus\n}\n#endif\n"
    top = [f"#ifndef {guard}", f"#define {guard}\n", "#include <stdbool.h>", "#include <stdint.h>\n", plus[0]]
    number = f"/* Type of real numbers. */\ntypedef {C_TYPES[real]} {name}_real;\n"
    return "\n".join([LICENCE_NOTE, f"/* {comment_text(doc)} */", *top, number, *typedefs, *calls, plus[1], "#endif\n"])


def _default_lines(parameters: list[Member], values: list[Any]) -> tuple[list[str], list[str]]:
    tables, lines = [], []
    for i, (m, value) in enumerate(zip(parameters, values, strict=True)):
        numbers = [
            number_literal(n, m.dtype) for n in value.astype(np.float32 if m.dtype == "f32" else value.dtype).ravel()
        ]
        if len(numbers) <= 8:
            lines += [f"    {m.at('p->', k)} = {text};" for k, text in enumerate(numbers)]
            continue
        table = f"default{i}"
        tables.append(f"static const {C_TYPES[m.dtype]} {table}[{m.size}] = {{{', '.join(numbers)}}};")
        lines.append(f"    memcpy(p->{m.path}, {table}, sizeof {table});")
    return tables, lines


class StructPlace(NamedTuple):
    """Struct members that are accessed through one pointer. base: C text of the pointer, e.g. "s->". writable: large
    arrays may be changed in place."""

    base: str
    members: list[Member]
    writable: bool = False


class _Body(NamedTuple):
    """Body of a C function. pieces: text of the functions that it calls. workspace, frame: sizes (bytes), as in
    BlockText."""

    pieces: str
    lines: list[str]
    workspace: int
    frame: int


class _Routine:
    """C function of a block: its lowered jaxpr, the structs that it reads, and the structs that it writes."""

    def __init__(self, jaxpr: Any, sources: list[StructPlace], targets: list[StructPlace], real: str) -> None:
        self.b = b = Builder()
        indexed = jaxprs.indexed_inputs(jaxpr.jaxpr)
        self.operands: list[tuple[str, Member, Array, bool]] = []
        dying: list[bool] = []
        for place in sources:
            for m in place.members:
                array = _operand_array(m, place, len(dying) in indexed)
                self.operands.append((place.base, m, array, place.writable))
                dying.append(place.writable)
        arrays = Lowering(b, RULES, real).lower_program(jaxpr, [a for _, _, a, _ in self.operands], dying)
        self.results: list[tuple[str, Member, Array]] = []
        rest = iter(arrays)
        pairs = [(place, m, next(rest)) for place in targets for m in place.members]
        # results that read the state's arrays are written first, because the state's results overwrite those arrays
        for place, m, a in pairs:
            if not self._state_buffer(place, m):
                self._write_result(place, m, a)
        self._write_states([(place, m, a) for place, m, a in pairs if self._state_buffer(place, m)])
        values = [v for _, _, a in self.results if a.items is not None for v in a.items.ravel()]
        buffers = [a.buffer for _, _, a in self.results if a.buffer is not None]
        self.blocks, self.needed = [b.prologue, b.top], [*values, *buffers]
        self.live = prune(self.blocks, values, buffers)
        self.workspace = plan_workspace(self.blocks, results=buffers)

    def _state_buffer(self, place: StructPlace, m: Member) -> Buffer | None:
        """Return the buffer in which a member is kept between calls, or None."""
        for base, other, array, _ in self.operands:
            if base == place.base and other.path == m.path:
                return array.buffer
        return None

    def _write_result(self, place: StructPlace, m: Member, array: Array) -> None:
        if self._alias_result(array):
            self.results.append((place.base, m, array))
            return
        if array.items is None or not is_small(array.shape):
            target = Buffer(array.dtype, array.size, "state", f"{place.base}{m.path}")
            copy_into(self.b, target, array)
            array = Array(array.shape, array.dtype, buffer=target)
        self.results.append((place.base, m, array))

    def _alias_result(self, array: Array) -> bool:
        """Put a result directly into its struct member, to save a copy. Return False if that is impossible."""
        buffer = array.buffer
        if buffer is None or buffer.kind != "local" or array.offset is not None:
            return False
        own = [item for item in self.b.top.items if isinstance(item, Local) and item.buffer is buffer]
        if own:
            self.b.top.items.remove(own[0])
            buffer.kind = "state"
        return bool(own)

    def _write_states(self, pairs: list[tuple[StructPlace, Member, Array]]) -> None:
        """Write large states to their own buffers. A new value that lies in a state's buffer is copied first."""
        own = [self._state_buffer(place, m) for place, m, _ in pairs]
        moves = []
        for (place, m, a), target in zip(pairs, own, strict=True):
            assert target is not None
            if a.buffer is not target:
                crossing = a.buffer is not None and any(a.buffer is t for t in own)
                moves.append((target, copy_array(self.b, a) if crossing else a))
            self.results.append((place.base, m, Array(a.shape, a.dtype, buffer=target)))
        for target, source in moves:
            copy_into(self.b, target, source)

    def has_data_dependent_loop(self) -> bool:
        """Return True if the program has a loop whose number of iterations depends on data."""
        return _has_while_loop(self.blocks)

    def write_body(self, w: Writer, function: str, arguments: list[tuple[str, str]]) -> _Body:
        """Return the body of the C function with this name and these arguments (type, name)."""
        blocks = self.blocks
        w.live, w.workspace, start = self.live, self.workspace, len(w.lines)
        w.note_sincos(blocks)
        for base, m, array, writable in self.operands:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
                continue
            assert array.items is not None
            for k, v in enumerate(array.items.ravel()):
                if not writable and id(v) in self.live:  # loaded where it is used: a branch not taken loads nothing
                    w.names[id(v)] = m.at(base, k)
                elif id(v) in self.live:
                    w.names[id(v)] = name = w.fresh("x")
                    w.write_line(f"const {C_TYPES[v.dtype]} {name} = {m.at(base, k)};")
        for base, m, array in self.results:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
        given = [*arguments, *([("void *", "workspace")] if self.workspace.size else [])]
        w.divide(plan_pieces(blocks, self.needed, exported=True), PieceFrame(function, 0, given))
        for block in blocks:
            w.write_block(block)
        for base, m, array in self.results:
            if array.items is not None:
                for k, v in enumerate(array.items.ravel()):
                    text = w.name(v)
                    w.write_line(f"{m.at(base, k)} = {text};")
        frame, workspace = w.frame.place(self.workspace.size)
        return _Body(w.frame.text(), [*([frame] if frame else []), *w.lines[start:]], workspace, w.frame.stack)


def _has_while_loop(blocks: list[Block]) -> bool:
    for item in (i for block in blocks for i in block.items):
        if isinstance(item, If) and _has_while_loop([item.first, item.second]):
            return True
        if isinstance(item, Loop) and (item.count is None or _has_while_loop([item.body])):
            return True
    return False


def _operand_array(m: Member, place: StructPlace, indexed: bool) -> Array:
    if is_small(m.shape) and not (indexed and m.shape):
        return scalars([Value("input", (), m.dtype) for _ in range(m.size)], m.shape, m.dtype)
    kind = "state" if place.writable else "input"
    return Array(m.shape, m.dtype, buffer=Buffer(m.dtype, m.size, kind, f"{place.base}{m.path}"))

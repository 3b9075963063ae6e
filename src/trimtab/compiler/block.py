"""A block as embedded C: structs of its parameters, state, input and output, and the functions that work on them.

State is read and written in place, so that large arrays of it are never copied.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler import jaxprs
from trimtab.compiler.analysis import prune
from trimtab.compiler.arrays import Array, copy_array, copy_into, is_small, scalars
from trimtab.compiler.elementary import INCLUDES, LICENCE_NOTE, elementary_names, elementary_text
from trimtab.compiler.ir import Block, Buffer, Builder, If, Local, Loop, Value
from trimtab.compiler.lower import Lowering
from trimtab.compiler.rules import RULES
from trimtab.compiler.structs import Member, members, struct_text
from trimtab.compiler.text import C_TYPES, number_literal
from trimtab.compiler.writer import Writer


class BlockDefinition(NamedTuple):
    """What a block is, before it is text.

    Attributes:
        name: before every name in the text.
        doc: one line on what it is.
        step: (parameters, state, input) -> (state, output); pure.
        init: parameters -> first state.
        parameters: tree of records of numbers: the parameters with their defaults.
        input: tree of records of the shape of the input; its numbers play no part.
    """

    name: str
    doc: str
    step: Callable[[Any, Any, Any], tuple[Any, Any]]
    init: Callable[[Any], Any]
    parameters: Any
    input: Any


class BlockText(NamedTuple):
    """The text of a block, and what its structs hold."""

    name: str
    header: str
    source: str
    inputs: list[Member]
    outputs: list[Member]
    parameters: list[Member]


def block_text(block: BlockDefinition, real: str = "f64") -> BlockText:
    """The C of a block. real: "f64" computes in double, "f32" in float."""
    name = block.name
    begin, state = jax.make_jaxpr(block.init, return_shape=True)(block.parameters)
    each, shapes = jax.make_jaxpr(block.step, return_shape=True)(block.parameters, state, block.input)
    P, S = members(block.parameters, real), members(state, real)
    IN, OUT = members(block.input, real), members(shapes[1], real)
    starting = _Routine(begin, [StructPlace("p->", P)], [StructPlace("s->", S)], real)
    sources = [StructPlace("p->", P), StructPlace("s->", S, True), StructPlace("in->", IN)]
    stepping = _Routine(each, sources, [StructPlace("s->", S), StructPlace("out->", OUT)], real)
    w = Writer({}, set())
    bodies = starting.body_lines(w), stepping.body_lines(w)
    bounded = not any(r.has_data_dependent_loop() for r in (starting, stepping))
    header = _header_text(name, block.doc, real, {"params": P, "state": S, "in": IN, "out": OUT}, bounded)
    tables, defaults = _default_lines(P, [np.asarray(v) for v in jax.tree.leaves(block.parameters)])
    parts = [
        LICENCE_NOTE,
        f'#include "{name}.h"\n',
        INCLUDES,
        elementary_text(0, elementary_names(w)),
        w.helper_texts(),
        *w.tables,
        *tables,
    ]
    parts.append(_step_function_text(f"{name}_defaults({name}_params *p)", defaults, ["p"]))
    parts.append(_step_function_text(f"{name}_init(const {name}_params *p, {name}_state *s)", bodies[0], ["p", "s"]))
    arguments = f"const {name}_params *p, {name}_state *s, const {name}_in *in, {name}_out *out"
    parts.append(_step_function_text(f"{name}_step({arguments})", bodies[1], ["p", "s", "in", "out"]))
    return BlockText(name, header, "\n".join(parts), IN, OUT, P)


def _step_function_text(head: str, lines: list[str], unused: list[str]) -> str:
    silence = " ".join(f"(void){name};" for name in unused)
    return "\n".join([f"void {head}", "{", *lines, f"    {silence}", "}\n"])


def _header_text(name: str, doc: str, real: str, structs: dict[str, list[Member]], bounded: bool) -> str:
    guard = f"{name.upper()}_H"
    docs = {
        "params": "Parameters; the defaults are those of the scenario.",
        "state": "All that is remembered between two steps.",
        "in": "What a step is given.",
        "out": "What a step gives.",
    }
    loops = "every loop is bounded" if bounded else "some loops end on data, so its time has no bound known here"
    typedefs = [struct_text(f"{name}_{kind}", m, docs[kind]) for kind, m in structs.items()]
    calls = [
        f"/* Set all parameters to their defaults. */\nvoid {name}_defaults({name}_params *p);\n",
        f"/* Begin: the state before the first step. */\nvoid {name}_init(const {name}_params *p, {name}_state *s);\n",
        f"/* One step. No memory is allocated, nothing is kept outside *s, {loops}. */\nvoid {name}_step("
        f"const {name}_params *p, {name}_state *s, const {name}_in *in, {name}_out *out);\n",
    ]
    plus = '#ifdef __cplusplus\nextern "C" {\n#endif\n', "#ifdef __cplusplus\n}\n#endif\n"
    top = [f"#ifndef {guard}", f"#define {guard}\n", "#include <stdbool.h>", "#include <stdint.h>\n", plus[0]]
    number = f"/* What real numbers are computed in. */\ntypedef {C_TYPES[real]} {name}_real;\n"
    return "\n".join([LICENCE_NOTE, f"/* {doc} */", *top, number, *typedefs, *calls, plus[1], "#endif\n"])


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
    """Members behind one pointer, e.g. "s->"; writable: their large arrays may be changed in place."""

    base: str
    members: list[Member]
    writable: bool = False


class _Routine:
    """One function of a block: its jaxpr lowered, where its operands come from, and where its results go."""

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
        # what others read of the state's arrays goes out before these are overwritten
        for place, m, a in pairs:
            if not self._state_buffer(place, m):
                self._write_result(place, m, a)
        self._write_states([(place, m, a) for place, m, a in pairs if self._state_buffer(place, m)])
        values = [v for _, _, a in self.results if a.items is not None for v in a.items.ravel()]
        buffers = [a.buffer for _, _, a in self.results if a.buffer is not None]
        self.live = prune([b.prologue, b.top], values, buffers)

    def _state_buffer(self, place: StructPlace, m: Member) -> Buffer | None:
        """The buffer in which a member is kept between calls, if it is one."""
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
        """Let a result's own memory be the member itself, where nothing else needs it: no copy, and no stack."""
        buffer = array.buffer
        if buffer is None or buffer.kind != "local" or array.offset is not None:
            return False
        own = [item for item in self.b.top.items if isinstance(item, Local) and item.buffer is buffer]
        if own:
            self.b.top.items.remove(own[0])
            buffer.kind = "state"
        return bool(own)

    def _write_states(self, pairs: list[tuple[StructPlace, Member, Array]]) -> None:
        """Large states end in their own buffers; one that another state reads from is copied first."""
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
        """Whether some loop runs as long as a condition holds."""
        return _has_while_loop([self.b.prologue, self.b.top])

    def body_lines(self, w: Writer) -> list[str]:
        """The body of the function."""
        blocks = [self.b.prologue, self.b.top]
        w.live, start = self.live, len(w.lines)
        w.note_sincos(blocks)
        for base, m, array, writable in self.operands:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
                continue
            assert array.items is not None
            for k, v in enumerate(array.items.ravel()):
                if not writable and id(v) in self.live:  # read where it is used: a branch not taken loads nothing
                    w.names[id(v)] = m.at(base, k)
                elif id(v) in self.live:
                    w.names[id(v)] = name = w.fresh("x")
                    w.write_line(f"const {C_TYPES[v.dtype]} {name} = {m.at(base, k)};")
        for base, m, array in self.results:
            if array.buffer is not None:
                w.names[id(array.buffer)] = f"{base}{m.path}"
        for block in blocks:
            w.write_block(block)
        for base, m, array in self.results:
            if array.items is not None:
                for k, v in enumerate(array.items.ravel()):
                    text = w.name(v)
                    w.write_line(f"{m.at(base, k)} = {text};")
        return w.lines[start:]


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

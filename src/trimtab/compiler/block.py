"""A block as embedded C: structs of its parameters, state, input and output, and the functions that work on them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.c_functions import C_TYPES
from trimtab.compiler.elementary import INCLUDES, LICENCE_NOTE, elementary_names, elementary_text
from trimtab.compiler.routine import Routine, StructPlace
from trimtab.compiler.scalar_text import number_literal
from trimtab.compiler.structs import Member, members, struct_text
from trimtab.compiler.writer import Writer


class ExportedBlock(NamedTuple):
    """The text of a block, and what its structs hold."""

    name: str
    header: str
    source: str
    inputs: list[Member]
    outputs: list[Member]
    params: list[Member]


def export_step(
    name: str,
    doc: str,
    params: Any,
    init: Callable[[Any], Any],
    step: Callable[[Any, Any, Any], tuple[Any, Any]],
    given: Any,
    real: str = "f64",
) -> ExportedBlock:
    """The C of a block.

    Args:
        name: before every name in the text.
        doc: one line on what it is.
        params: tree of records of numbers: the parameters with their defaults.
        init: params -> first state.
        step: (params, state, given) -> (state, output).
        given: a tree of records of the shape of the input.
        real: "f64" computes in double, "f32" in float.
    """
    begin, state = jax.make_jaxpr(init, return_shape=True)(params)
    each, shapes = jax.make_jaxpr(step, return_shape=True)(params, state, given)
    P, S = members(params, real), members(state, real)
    IN, OUT = members(given, real), members(shapes[1], real)
    starting = Routine(begin, [StructPlace("p->", P)], [StructPlace("s->", S)], real)
    sources = [StructPlace("p->", P), StructPlace("s->", S, True), StructPlace("in->", IN)]
    stepping = Routine(each, sources, [StructPlace("s->", S), StructPlace("out->", OUT)], real)
    w = Writer({}, set())
    bodies = starting.body_lines(w), stepping.body_lines(w)
    bounded = not any(r.has_data_dependent_loop() for r in (starting, stepping))
    header = _header_text(name, doc, real, {"params": P, "state": S, "in": IN, "out": OUT}, bounded)
    tables, defaults = _default_lines(P, [np.asarray(v) for v in jax.tree.leaves(params)])
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
    return ExportedBlock(name, header, "\n".join(parts), IN, OUT, P)


def _step_function_text(head: str, lines: list[str], unused: list[str]) -> str:
    silence = " ".join(f"(void){name};" for name in unused)
    return "\n".join([f"void {head}", "{", *lines, f"    {silence}", "}\n"])


def _header_text(name: str, doc: str, real: str, held: dict[str, list[Member]], bounded: bool) -> str:
    guard = f"{name.upper()}_H"
    docs = {
        "params": "Parameters; the defaults are those of the scenario.",
        "state": "All that is remembered between two steps.",
        "in": "What a step is given.",
        "out": "What a step gives.",
    }
    loops = "every loop is bounded" if bounded else "some loops end on data, so its time has no bound known here"
    structs = [struct_text(f"{name}_{kind}", m, docs[kind]) for kind, m in held.items()]
    calls = [
        f"/* Set all parameters to their defaults. */\nvoid {name}_defaults({name}_params *p);\n",
        f"/* Begin: the state before the first step. */\nvoid {name}_init(const {name}_params *p, {name}_state *s);\n",
        f"/* One step. No memory is allocated, nothing is kept outside *s, {loops}. */\nvoid {name}_step("
        f"const {name}_params *p, {name}_state *s, const {name}_in *in, {name}_out *out);\n",
    ]
    plus = '#ifdef __cplusplus\nextern "C" {\n#endif\n', "#ifdef __cplusplus\n}\n#endif\n"
    top = [f"#ifndef {guard}", f"#define {guard}\n", "#include <stdbool.h>", "#include <stdint.h>\n", plus[0]]
    number = f"/* What real numbers are computed in. */\ntypedef {C_TYPES[real]} {name}_real;\n"
    return "\n".join([LICENCE_NOTE, f"/* {doc} */", *top, number, *structs, *calls, plus[1], "#endif\n"])


def _default_lines(held: list[Member], values: list[Any]) -> tuple[list[str], list[str]]:
    tables, lines = [], []
    for i, (m, value) in enumerate(zip(held, values, strict=True)):
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

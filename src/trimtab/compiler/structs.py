"""C structs from trees of records, with the same dotted paths, and functions that convert them to rows of numbers.

The unit and meaning of each field become a C comment.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.arrays import type_name
from trimtab.compiler.identifiers import distinct, identifier
from trimtab.compiler.ir import TYPES
from trimtab.compiler.text import C_TYPES
from trimtab.core.quantity import Quantity, leaves


class Member(NamedTuple):
    """Number or array in a C struct. path: dotted path in C. name: dotted path in the log, e.g. with a hyphen."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None
    name: str

    @property
    def size(self) -> int:
        """Return the number of elements of the member."""
        return math.prod(self.shape)

    @property
    def numpy_type(self) -> np.dtype[Any]:
        """Return the numpy type of the member's elements."""
        return np.dtype(TYPES[self.dtype])

    def at(self, base: str, k: int | str) -> str:
        """Return the C text of the member's element k, e.g. s->law.timer or s->P[3]."""
        return f"{base}{self.path}" if not self.shape else f"{base}{self.path}[{k}]"


def members(tree: Any, real: str) -> list[Member]:
    """Return the leaves of a tree of records, in JAX's order. real: "f64", or "f32" in place of float64."""
    declared = {path: d for path, _, d in leaves(tree) if isinstance(d, Quantity)}
    found, paths = [], dict[tuple[str, ...], str]()
    for keys, value in jax.tree_util.tree_flatten_with_path(tree)[0]:
        names = [str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", "")))) for k in keys]
        dtype = type_name(value.dtype if hasattr(value, "dtype") else np.asarray(value).dtype)
        path, name = _member_path(tuple(names), paths) or "value", ".".join(names) or "value"
        kept = real if dtype == "f64" else dtype
        found.append(Member(path, np.shape(value), kept, declared.get(name), name))
    return found


def _member_path(names: tuple[str, ...], paths: dict[tuple[str, ...], str]) -> str:
    """Return the C path of a member. paths: paths assigned so far, to which the new path is added."""
    if not names:
        return ""
    if names not in paths:
        above = _member_path(names[:-1], paths)
        path = f"{above}.{identifier(names[-1])}" if above else identifier(names[-1])
        paths[names] = distinct(path, paths.values())
    return paths[names]


def struct_text(name: str, held: list[Member], doc: str) -> str:
    """Return the C typedef of a struct with these members. Dotted paths become nested structs."""
    tree: dict[str, Any] = {}
    for m in held:
        *groups, last = m.path.split(".")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[last] = m
    body = _field_text(tree, 1) or "    char nothing;  /* C has no empty structs */\n"
    return f"/* {comment_text(doc)} */\ntypedef struct {{\n{body}}} {name};\n"


def _field_text(tree: dict[str, Any], depth: int) -> str:
    pad, text = "    " * depth, ""
    for name, item in tree.items():
        if isinstance(item, Member):
            size = f"[{max(item.size, 1)}]" if item.shape else ""
            text += f"{pad}{C_TYPES[item.dtype]} {name}{size};{_comment_text(item)}\n"
        else:
            text += f"{pad}struct {{\n{_field_text(item, depth + 1)}{pad}}} {name};\n"
    return text


def _comment_text(m: Member) -> str:
    if m.declaration is None:
        return ""
    d = m.declaration
    unit = "" if d.unit == "1" else f"{d.unit}: "
    frame = f" Frame {d.frame}." if d.frame else ""
    modes = f" {', '.join(f'{i} {n}' for i, n in enumerate(d.modes))}." if d.modes else ""
    shape = f" {' x '.join(map(str, m.shape))}, row-major." if len(m.shape) > 1 else ""
    return f"  /* {comment_text(f'{unit}{d.doc}{frame}{modes}{shape}')} */"


def comment_text(text: str) -> str:
    """Return the text as a single line that can be put in a C comment: it neither opens nor ends a comment."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??/", "?? /").split())


def row_declarations(name: str, inputs: list[Member], outputs: list[Member]) -> str:
    """Return the C declarations of the functions that convert rows of numbers to a block's structs and back."""
    n_in, n_out = sum(m.size for m in inputs), sum(m.size for m in outputs)
    return f"""enum {{ VECTORS_IN = {n_in}, VECTORS_OUT = {n_out} }};

void vectors_set_in(const double *row, {name}_in *in);
void vectors_get_out(const {name}_out *out, double *row);
"""


def row_functions(name: str, inputs: list[Member], outputs: list[Member]) -> str:
    """Return the C functions that convert rows of numbers to the structs of the block `name`, and back."""
    sets = _row_lines(inputs, lambda m, i, k: f"{m.at('in->', i)} = {_from_double(m, f'row[{k}]')};")
    gets = _row_lines(outputs, lambda m, i, k: f"row[{k}] = (double){m.at('out->', i)};")
    sets, gets = sets or ["    (void)row; (void)in;"], gets or ["    (void)out; (void)row;"]
    lines = [f"void vectors_set_in(const double *row, {name}_in *in)", "{", *sets, "}", ""]
    lines += [f"void vectors_get_out(const {name}_out *out, double *row)", "{", *gets, "}", ""]
    return "\n".join(lines)


LOOPED = 256
"""Number of elements above which an array is copied by a loop."""


def _row_lines(held: list[Member], line: Callable[[Member, Any, Any], str]) -> list[str]:
    """Return the C text line(member, element, position in the row) for every number of these members."""
    lines, start = [], 0
    for m in held:
        if m.size > LOOPED:
            lines.append(f"    for (int32_t i = 0; i < {m.size}; i++) {line(m, 'i', f'{start} + i')}")
        else:
            lines += [f"    {line(m, i, start + i)}" for i in range(m.size)]
        start += m.size
    return lines


def _from_double(m: Member, text: str) -> str:
    return f"{text} != 0" if m.dtype == "bool" else f"({C_TYPES[m.dtype]}){text}"

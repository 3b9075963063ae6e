"""Members of C structs from trees of records: the same dotted paths, with unit and meaning as comments."""

import keyword
import math
import re
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.arrays import type_name
from trimtab.compiler.c_functions import C_TYPES
from trimtab.core.record import Quantity, leaves

RESERVED = {*keyword.kwlist, "main", "bool", "true", "false"}
RESERVED |= {"auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern"}
RESERVED |= {"float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed"}
RESERVED |= {"sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while"}


class Member(NamedTuple):
    """One array of a struct. path: with dots, as C reads it.  name: the same as the log has it, e.g. with a hyphen."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None
    name: str

    @property
    def size(self) -> int:
        """How many numbers."""
        return math.prod(self.shape)

    def at(self, base: str, k: int) -> str:
        """Text of element k, e.g. s->law.timer or s->P[3]."""
        return f"{base}{self.path}" if not self.shape else f"{base}{self.path}[{k}]"


def members(tree: Any, real: str) -> list[Member]:
    """The leaves of a tree of records, in the order of JAX; real: "f64", or "f32" for every float64."""
    declared = {path: d for path, _, d in leaves(tree) if isinstance(d, Quantity)}
    found = []
    for keys, value in jax.tree_util.tree_flatten_with_path(tree)[0]:
        names = [str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", "")))) for k in keys]
        dtype = type_name(value.dtype if hasattr(value, "dtype") else np.asarray(value).dtype)
        path, name = ".".join(map(identifier, names)) or "value", ".".join(names) or "value"
        kept = real if dtype == "f64" else dtype
        found.append(Member(path, np.shape(value), kept, declared.get(name), name))
    return found


def identifier(name: str) -> str:
    """A name that C takes: numbers get an underscore before them, words of the language one behind."""
    made = re.sub(r"\W", "_", name)
    if made[:1].isdigit():
        return f"_{made}"
    return f"{made}_" if made in RESERVED else made


def struct_text(name: str, held: list[Member], doc: str) -> str:
    """The typedef of a struct with these members, nested as their paths are."""
    tree: dict[str, Any] = {}
    for m in held:
        *groups, last = m.path.split(".")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[last] = m
    body = _field_text(tree, 1) or "    char nothing;  /* C has no empty structs */\n"
    return f"/* {doc} */\ntypedef struct {{\n{body}}} {name};\n"


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
    text = f"{unit}{d.doc}{frame}{modes}{shape}".replace("*/", "* /").replace("\n", " ")
    return f"  /* {text} */"

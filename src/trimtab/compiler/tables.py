"""Constant tables of the C code: short ones are in the text, long ones may be passed when the library is loaded."""

from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from trimtab.compiler.ir import TYPES
from trimtab.compiler.text import C_TYPES, number_literal
from trimtab.compiler.values import Buffer

LITERALS = 1024
"""Maximum length of a table in the text, if longer tables may be passed as data."""


def table_text(name: str, buffer: Buffer, as_data: bool) -> str:
    """Return the C declaration of a table. as_data: True to leave out the numbers, which are then passed to the loaded
    library."""
    if as_data:
        return f"static {C_TYPES[buffer.dtype]} {name}[{buffer.size}];"
    numbers = ", ".join(number_literal(n, buffer.dtype) for n in buffer.data) or "0"
    return f"static const {C_TYPES[buffer.dtype]} {name}[{max(buffer.size, 1)}] = {{{numbers}}};"


def table_numbers(buffer: Buffer) -> Any:
    """Return the numbers of a table, in their type in C."""
    return np.asarray(buffer.data, TYPES[buffer.dtype])


def filling_text(function: str, names: Sequence[str], numbers: Sequence[Any], linkage: str = "") -> str:
    """Return `void FUNCTION_tables(const void *const *tables)`, which fills tables before the first call.

    A digest of the numbers is part of the text, so functions that differ only in their tables are different libraries.
    """
    if not names:
        return ""
    digest = sha256(b"".join(table.tobytes() for table in numbers)).hexdigest()
    copies = [f"    memcpy({name}, tables[{i}], sizeof {name});" for i, name in enumerate(names)]
    head = f"{linkage}void {function}_tables(const void *const *tables)"
    return "\n".join([f"\n/* Numbers of the tables: sha256 {digest}. */", head, "{", *copies, "}\n"])

"""Constants that [1] prints, and values that follow from its equations by a program that is no part of the package."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from trimtab.study import Row, within

MASS, INERTIA, ARM = 2.6, 0.096, 0.32
"""Mass, inertia and arm in kg, kg m² and m: [1] section 4.1 (5.7 lb), table 4.2 (mean of both trials), 4.1 (12.6
in).
"""
TABLE = Path(__file__).with_name("reference.json")
"""File of row -> value, written by tests/oracles/hovercraft.py."""


@cache
def _values() -> dict[str, float]:
    return json.loads(TABLE.read_text(encoding="utf-8"))


def reference_values(prefix: str) -> dict[str, float]:
    """Return row -> value for the ids with a prefix, in the order of the table."""
    return {id: value for id, value in _values().items() if id.startswith(prefix)}


def reference_row(id: str, what: str, computed: Any, citation: str, **about: Any) -> Row:
    """Return the row of this id, compared with the value of tests/oracles/hovercraft.py. about: as in `within`."""
    return within(id, what, _values()[id], computed, citation, basis="reference", **about)

"""Constants printed in [1], and values computed from its equations by a program outside the package."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from trimtab.study import Row, within

MASS, INERTIA, ARM = 2.6, 0.096, 0.32
"""Mass (kg), inertia (kg m²) and arm (m): [1] section 4.1 (5.7 lb), table 4.2 (mean of both trials), section 4.1
(12.6 in).
"""
TABLE = Path(__file__).with_name("reference.json")
"""JSON file of row id -> reference value, written by tests/oracles/hovercraft.py."""


@cache
def _values() -> dict[str, float]:
    return json.loads(TABLE.read_text(encoding="utf-8"))


def reference_values(prefix: str) -> dict[str, float]:
    """Return row id -> reference value for the ids with a prefix, in the order of the file."""
    return {id: value for id, value in _values().items() if id.startswith(prefix)}


def reference_row(id: str, what: str, computed: Any, citation: str, **about: Any) -> Row:
    """Return a row that compares with the value of this id from tests/oracles/hovercraft.py.

    about: options of `within`.
    """
    return within(id, what, _values()[id], computed, citation, basis="reference", **about)

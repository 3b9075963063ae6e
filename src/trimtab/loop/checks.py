"""Checks of a scenario's values before a run: finite, in range, declared shape, valid choice, valid period."""

from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.interfaces import optional_member
from trimtab.core.quantity import Option, Quantity, leaves, records
from trimtab.core.time import format_time

SHORTEST_PERIOD = 100
"""Minimum period: 10 µs, in units of 100 ns. A smaller integer is almost always a time in seconds or ms by mistake."""


def check_values(tree: Any, path: str = "") -> None:
    """Check every declared field of a tree of records, and call check() of every record in the tree.

    Raise InputError, with the path of the field, for an invalid value.
    """
    for where, value, declared in leaves(tree, path):
        if isinstance(declared, Quantity):
            _check_quantity(where, value, declared)
        else:
            _check_option(where, value, declared)
    for where, child in records(tree, path):
        if where != path:
            check_part(where, optional_member(child, "check"))


def check_part(where: str, own: Any) -> None:
    """Call `own`, the check() method of a part. An error message names the part by its path `where`."""
    try:
        own()
    except InputError as error:
        part = where if not error.part or error.part in where else f"{where}: {error.part}"
        raise InputError(part, error.problem, choices=error.choices, fix=error.fix) from None


def _check_quantity(where: str, value: Any, declared: Quantity) -> None:
    unit = "" if declared.unit == "1" else f" {declared.unit}"
    in_unit = f" in{unit}" if unit else ""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(
            where, f"{value!r} is not a number", fix=argument("settings", "NUMBER", where) + in_unit
        ) from None
    if declared.shape and array.shape != declared.shape:
        problem = f"must have shape {declared.shape}, but has shape {array.shape}"
        raise InputError(where, problem, fix=f"give an array of shape {declared.shape}{in_unit}")
    if value is None or callable(value):
        raise InputError(
            where, f"must be a number, got {value!r:.60}", fix=argument("settings", "NUMBER", where) + in_unit
        )
    if not np.isfinite(array).all():
        raise InputError(where, f"{value} is not finite", fix=argument("settings", "NUMBER", where) + in_unit)
    for bound, wrong, text in (
        (declared.above, lambda b: array <= b, "above"),
        (declared.low, lambda b: array < b, "at least"),
        (declared.high, lambda b: array > b, "at most"),
    ):
        if bound is not None and wrong(bound).any():
            fix = f"{argument('settings', 'VALUE', where)} {text} {bound:g}{unit}"
            first = value if array.ndim == 0 else array[wrong(bound)][0]  # for an array: first number out of range
            raise InputError(where, f"{first}{unit} is out of range: it must be {text} {bound:g}{unit}", fix=fix)


def _check_option(where: str, value: Any, declared: Option) -> None:
    if declared.kind == "period":
        low = max(declared.low or 0, SHORTEST_PERIOD if where.endswith("period") else 0)
        if not isinstance(value, int) or isinstance(value, bool):
            fix = f"write e.g. ms(20) in Python or {argument('settings', '20 ms', where)}"
            raise InputError(where, f"the time must be an integer in units of 100 ns, got {value!r}", fix=fix)
        if value < low:
            problem = f"{format_time(value)} is too short: it must be at least {format_time(low)}"
            raise InputError(where, problem, fix=argument("settings", "20 ms", where))
    elif declared.choices and value not in declared.choices:
        choices = [str(c) for c in declared.choices]
        raise InputError(
            where, f"{value!r} is not a choice", choices=choices, fix=argument("settings", choices[0], where)
        )

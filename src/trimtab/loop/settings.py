"""Settings written as text, ``path=value``, put into a scenario; the path is the same as in the log and the docs."""

import json
from collections.abc import Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.record import Option, Quantity, absent_parts, leaves, with_leaf, with_part_of
from trimtab.core.time import parse_time

T = TypeVar("T")


def with_settings(tree: T, settings: Mapping[str, str]) -> T:
    """A copy with every path set; refuses unknown paths and values of the wrong type, and names what is near.

    An optional part that a path leads into is put there, e.g. the hovercraft's friction.
    """
    for path, text in settings.items():
        try:
            tree = with_leaf(with_part_of(tree, path), path, partial(_parse_value, path, text))
        except KeyError:
            raise _unknown_path_error(tree, path) from None
    return tree


def _unknown_path_error(tree: Any, path: str) -> InputError:
    known = [p for p, _, _ in leaves(tree)]
    known += [f"{where}.{p}" for where, declared in absent_parts(tree) for p, _, _ in leaves(declared.optional)]
    below = [p for p in known if p.startswith(path + ".")]
    near = below[:8] or closest(path, known, 6) or sorted({p.split(".")[0] for p in known})
    fix = (
        f"--set {near[0]}=…"
        if below or near[0] in known
        else "trimtab list SCENARIO  shows every path with its value and unit"
    )
    return InputError(f"--set {path}", "there is no such setting", choices=near, fix=fix)


def _parse_value(path: str, text: str, old: Any, declared: Quantity | Option) -> Any:
    if isinstance(declared, Option):
        return _parse_option(path, text, old, declared)
    try:
        number = json.loads(text)
        array = np.asarray(number, np.float64)
    except (TypeError, ValueError):
        if np.shape(old):
            problem = f"{text!r} is not a list of finite numbers of shape {np.shape(old)}"
            fix = f"--set '{path}={json.dumps(np.asarray(old).tolist())}'"
            raise InputError(f"--set {path}", problem, fix=fix) from None
        number = _parse_float(path, text, declared)
        array = np.asarray(number)
    if array.shape != np.shape(old):
        problem = f"{text!r} has shape {array.shape}, wanted is {np.shape(old)}"
        raise InputError(f"--set {path}", problem, fix=f"--set '{path}={json.dumps(np.asarray(old).tolist())}'")
    return number if array.ndim == 0 else array


def _parse_float(path: str, text: str, declared: Quantity) -> float:
    try:
        return float(text)  # nan and inf are read here and refused by the checks, with the range
    except ValueError:
        unit = "" if declared.unit == "1" else f", in {declared.unit}"
        fix = f"--set {path}=NUMBER{unit}"
        raise InputError(f"--set {path}", f"{text!r} is not a number", fix=fix) from None


def _parse_option(path: str, text: str, old: Any, declared: Option) -> Any:
    if declared.kind == "period":
        try:
            return parse_time(text)
        except InputError as error:
            fix = f"--set {path}='20 ms'"
            raise InputError(f"--set {path}", error.problem, choices=error.choices, fix=fix) from None
    if declared.choices:
        choices = {str(c): c for c in declared.choices}
        if text not in choices:
            fix = f"--set {path}={next(iter(choices))}"
            raise InputError(f"--set {path}", f"{text!r} is not a choice", choices=choices, fix=fix)
        return choices[text]
    try:
        return type(old)(text) if not isinstance(old, bool) else {"true": True, "false": False}[text.lower()]
    except (ValueError, KeyError):
        kind = type(old).__name__
        raise InputError(f"--set {path}", f"{text!r} is not of type {kind}", fix=f"--set {path}={old}") from None

"""Application of settings, ``path=value``, to a scenario. The log and the docs use the same paths."""

import json
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import first_number, has_index, split_index
from trimtab.core.record import Option, Quantity, absent_parts, leaves, with_leaf, with_part_of
from trimtab.core.suggestions import unknown_setting
from trimtab.core.time import nearest_time, parse_time
from trimtab.core.units import parse_amount, parse_unit
from trimtab.loop.parts import UNSET, is_name, is_part, with_part

T = TypeVar("T")


def with_settings(tree: T, settings: Mapping[str, Any]) -> T:
    """Return a copy of the scenario with every setting applied.

    Raise InputError for an unknown path or an invalid value. For an unknown path, the message names similar paths.

    >>> from trimtab import build, with_settings
    >>> with_settings(build("hovercraft/spin"), {"world.vehicle.mass": "3000 g"}).world.vehicle.mass
    3.0

    A number may have a unit, e.g. ``3 kg``. To replace a part, set the path of the part to the name of a class, e.g.
    ``world.uplink=Wire`` (see `loop.parts`). Settings of the part's fields then apply to the new part. A setting of an
    optional part, e.g. of the hovercraft's friction, adds this part to the scenario.
    """
    tree, rest = with_parts(tree, texts_of(settings))
    for path, text in rest.items():
        whole, at = split_index(path)
        change = partial(parse_value, path, text) if at is None else partial(_parse_one_number, path, at, text)
        try:
            tree = with_leaf(with_part_of(tree, whole), whole, change)
        except KeyError:
            raise unknown_setting("settings", path, setting_paths(tree)) from None
    return tree


def texts_of(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the settings with all values as text. Numbers and lists of numbers have the form used after ``--set``."""
    return {
        path: value if isinstance(value, str) else json.dumps(np.asarray(value).tolist(), default=str)
        for path, value in settings.items()
    }


def setting_paths(tree: Any) -> list[str]:
    """Return the paths of all settings, including the settings of optional parts."""
    absent = [f"{where}.{p}" for where, declared in absent_parts(tree) for p, _, _ in leaves(declared.optional)]
    return [p for p, _, _ in leaves(tree)] + absent


def with_parts(tree: T, settings: Mapping[str, str]) -> tuple[T, dict[str, str]]:
    """Return a copy of the scenario with each part replaced that a setting names, and the remaining settings."""
    rest = dict(settings)
    for path in sorted(settings, key=lambda p: p.count(".")):
        if path in rest and is_name(rest[path]) and is_part(tree, path):
            tree = with_part(tree, path, rest, parse_value)
    return tree, rest


def parse_value(path: str, text: str, old: Any, declared: Quantity | Option) -> Any:
    """Return the value that a setting's text describes.

    old: present value, or UNSET if the field has no value yet.  declared: declaration of the field.
    """
    if isinstance(declared, Option):
        return _parse_option(path, text, old, declared)
    shape = declared.shape if old is UNSET else np.shape(old)
    try:
        number = _parse_numbers(path, text, declared)
        array = np.asarray(number, np.float64)
    except InputError:
        raise
    except (TypeError, ValueError):
        problem = f"{text!r} is not a list of finite numbers of shape {shape}"
        raise InputError(argument_name("settings", path), problem, fix=_example_list(path, old, shape)) from None
    if array.shape != shape and (old is not UNSET or shape):
        problem = f"{text!r} has shape {array.shape}, but must have shape {shape}"
        raise InputError(argument_name("settings", path), problem, fix=_example_list(path, old, shape))
    return number if array.ndim == 0 else array


def _parse_one_number(path: str, at: tuple[int, ...], text: str, old: Any, declared: Quantity | Option) -> Any:
    """Return an array in which one element is replaced by the value of a setting. at: index of the element."""
    array = np.array(old, np.float64) if isinstance(declared, Quantity) else np.zeros(())
    if not array.ndim or not has_index(array.shape, at):
        whole, _ = split_index(path)
        problem = (
            f"the array has shape {np.shape(old)}, so it has no element with this index"
            if isinstance(declared, Quantity)
            else "is not an array of numbers"
        )
        fix = argument("settings", text, first_number(whole, array.shape))
        raise InputError(argument_name("settings", path), problem, fix=fix)
    array[at] = parse_value(path, text, float(array[at]), declared)
    return array


def _example_list(path: str, old: Any, shape: tuple[int, ...]) -> str:
    return argument("settings", json.dumps(np.asarray(np.zeros(shape) if old is UNSET else old).tolist()), path)


def _parse_numbers(path: str, text: str, declared: Quantity) -> Any:
    """Return the number or the list of numbers in a text. A unit may follow each number or the complete list."""
    body, bracket, unit = text.rpartition("]")
    try:
        value = json.loads(body + bracket if bracket else text)
    except ValueError:
        if bracket:
            raise
        value = text
    return _convert_units(path, value, unit.strip() if bracket else "", declared)


def _convert_units(path: str, value: Any, unit: str, declared: Quantity) -> Any:
    if isinstance(value, list):
        several: list[Any] = value  # pyright: ignore[reportUnknownVariableType]
        return [_convert_units(path, v, unit, declared) for v in several]
    part = argument_name("settings", path)
    if not isinstance(value, str):
        _check_number(path, value, declared)
    try:
        if isinstance(value, str):
            return parse_amount(part, value, declared.unit)
        return value * parse_unit(part, unit, declared.unit) if unit else value
    except InputError as error:
        own = "" if declared.unit == "1" else f" {declared.unit}"
        no_number = "is not a number" in error.problem
        fix = argument("settings", "NUMBER" if no_number else value, path) + (f", in{own}" if no_number and own else "")
        if not no_number and isinstance(value, str):
            fix = argument("settings", error.fix, path)
        raise InputError(part, error.problem, choices=error.choices, fix=fix) from None


def _check_number(path: str, value: Any, declared: Quantity) -> None:
    """Raise InputError for a number outside the range of 64-bit floats, or for true or false instead of a number."""
    problem = ""
    if isinstance(value, bool) and declared.kind != "flag":
        problem = f"must be a number, got {str(value).lower()}"
    elif isinstance(value, int | float) and 0 < abs(value) < sys.float_info.min:
        problem = f"the magnitude of {value:g} is smaller than any normal number of 64 bits"
    elif isinstance(value, int) and abs(value) > sys.float_info.max:
        problem = f"the magnitude is larger than {sys.float_info.max:.3g}, the largest number of 64 bits"
    if problem:
        unit = "" if declared.unit == "1" else f", in {declared.unit}"
        raise InputError(argument_name("settings", path), problem, fix=argument("settings", "NUMBER", path) + unit)


def _parse_option(path: str, text: str, old: Any, declared: Option) -> Any:
    if declared.kind == "period":
        try:
            return parse_time(text)
        except InputError as error:
            usual = "20 s" if path == "duration" else "20 ms"
            fix = argument("settings", nearest_time(text, usual), path)
            raise InputError(argument_name("settings", path), error.problem, choices=error.choices, fix=fix) from None
    if declared.choices:
        choices = {str(c): c for c in declared.choices} | {
            str(c).lower(): c for c in declared.choices if c in (True, False)
        }
        if text not in choices:
            offer = [str(c) for c in declared.choices]
            raise InputError(
                argument_name("settings", path),
                f"{text!r} is not a choice",
                choices=offer,
                fix=argument("settings", offer[0], path),
            )
        return choices[text]
    try:
        return _parse_plain(text, old)
    except (ValueError, KeyError):
        kind = type(old).__name__
        raise InputError(
            argument_name("settings", path), f"{text!r} is not of type {kind}", fix=argument("settings", old, path)
        ) from None


def _parse_plain(text: str, old: Any) -> Any:
    if isinstance(old, bool):
        return {"true": True, "false": False}[text.lower()]
    if isinstance(old, tuple) or text.startswith("["):
        return _as_tuples(json.loads(text))
    return text if old is UNSET else type(old)(text)


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(v) for v in value) if isinstance(value, list) else value

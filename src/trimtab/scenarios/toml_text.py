"""Write a scenario as a scenario file (`scenarios.toml_file`) that contains every setting with its unit and meaning."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from trimtab.core.quantity import Option, Quantity, declarations, leaves, records
from trimtab.core.time import format_time
from trimtab.logs.metrics import Target
from trimtab.loop.parts import find_class, part_modules
from trimtab.scenarios.toml_file import PART, signal_units

FEW = 16
"""Maximum length of a list whose values are written. For a longer list, only the length is written, as a comment."""
NOT_WRITTEN = ("name",)
WHOLE = ("world", "autopilot")
"""Paths of the records whose class a scenario file cannot choose."""


def format_scenario(name: str, scenario: Any, choices: Mapping[str, tuple[str, ...]]) -> str:
    """Return the text of a scenario file that describes a scenario of the catalogue completely.

    name: name of the scenario, used as base of the file.  choices: name of each argument -> choices, the default first.
    """
    top = [(p, v, d) for p, v, d in leaves(scenario) if "." not in p and p not in NOT_WRITTEN]
    lines = [
        f"# {name}. A deleted line's value comes from the base or a choice. To run the file:  trimtab run FILE.toml",
        "",
    ]
    lines += [f"base = {json.dumps(name)}", *(_format_line(*leaf) for leaf in top)]
    if choices:
        lines += ["", "[choices]"]
        lines += [f"# {n} = {json.dumps(c[0])}  # {' | '.join(c)}" for n, c in choices.items() if c]
    own = list(leaves(scenario))
    for path, part in records(scenario):
        below = [(p, v, d) for p, v, d in own if p.rpartition(".")[0] == path and path]
        if not path or (path in WHOLE and not below):
            continue
        lines += ["", f"[{path}]"]
        if path not in WHOLE and path not in choices:
            lines.append(f"{PART} = {json.dumps(type(part).__name__)}{_first_line(type(part))}")
        lines += [_format_line(p.rpartition(".")[2], value, d) for p, value, d in below]
    return "\n".join([*lines, *_format_targets(scenario.targets, signal_units(scenario))]) + "\n"


def _first_line(kind: type) -> str:
    doc = (kind.__doc__ or "").partition("\n")[0].strip()
    return f"  # {doc}" if doc else ""


def _format_line(key: str, value: Any, declared: Quantity | Option) -> str:
    text, note = _format_value(value, declared)
    return f"{key} = {text}  # {note}{declared.doc}" if text else f"# {key}: {note}{declared.doc}"


def _format_value(value: Any, declared: Quantity | Option) -> tuple[str, str]:
    """Return a value in TOML notation, and a note that is written before the description of the field.

    The value is "" if it is too long to be written.
    """
    if isinstance(declared, Option):
        if declared.kind == "period":
            return json.dumps(format_time(value)), ""
        choices = f"{' | '.join(map(str, declared.choices))}: " if len(declared.choices) > 1 else ""
        return _format_option(value), choices
    unit = "" if declared.unit == "1" else declared.unit
    if np.ndim(value):
        numbers, note = np.asarray(value), f"{unit}: " if unit else ""
        return (json.dumps(numbers.tolist()), note) if numbers.size <= FEW else ("", f"{numbers.size} numbers. ")
    number = np.asarray(value).item()
    if isinstance(number, bool):
        return str(number).lower(), ""
    return (json.dumps(f"{number!r} {unit}"), "") if unit else (repr(number), "")


def _format_option(value: Any) -> str:
    try:
        plain = json.dumps(value)
    except TypeError:
        return ""
    return "" if "null" in plain or "{" in plain else plain


def _format_targets(targets: Iterable[Target], units: Mapping[str, str]) -> list[str]:
    lines: list[str] = []
    for target in targets:
        unit = units.get(target.path, "1")
        numbers = {"value": target.value, "band": target.band}
        texts = {n: repr(float(v)) if unit == "1" else json.dumps(f"{float(v)!r} {unit}") for n, v in numbers.items()}
        lines += ["", "[[targets]]", f"signal = {json.dumps(target.path)}", *(f"{n} = {t}" for n, t in texts.items())]
    return lines


def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, made from the fields, units and meanings that the records declare."""
    classes = {name: find_class("schema", name) for name in sorted(part_modules())}
    text = {"type": "string"}
    kinds = [
        {"if": {"properties": {PART: {"const": n}}, "required": [PART]}, "then": {"$ref": f"#/$defs/{n}"}}
        for n in classes
    ]
    tree = {name: _field_schema(d) for name, d in declarations(classes["Scenario"]).items()}
    target = {"signal": text, "value": {"type": ["number", "string"]}, "band": {"type": ["number", "string"]}}
    own = {
        "base": {**text, "description": "Scenario of the catalogue, or another scenario file."},
        "name": {**text, "description": "Name of the scenario in logs and plots."},
        "without": {"type": "array", "items": text, "description": "Imperfections to switch off."},
        "faults": {"type": "array", "items": text, "description": "Faults, written as after --fault."},
        "choices": {
            "type": "object",
            "description": "Arguments of the base, and settings that are not paths: predictor, uplink, reference …",
        },
        "targets": {
            "type": "array",
            "items": {"type": "object", "properties": target, "required": [*target], "additionalProperties": False},
        },
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "trimtab scenario file",
        "type": "object",
        "properties": tree | {"world": _open(classes["World"]), "autopilot": _open(classes["Autopilot"])} | own,
        "additionalProperties": False,
        "$defs": {
            "part": {
                "type": ["object", "string"],
                "properties": {PART: text | {"examples": [*classes]}},
                "allOf": kinds,
            },
            **{name: _class_schema(kind) for name, kind in classes.items()},
        },
    }


def _open(kind: Any) -> dict[str, Any]:
    return {k: v for k, v in _class_schema(kind).items() if k != "additionalProperties"}


def _class_schema(kind: Any) -> dict[str, Any]:
    doc = (kind.__doc__ or "").partition("\n")[0].strip()
    fields = {name: _field_schema(d) for name, d in declarations(kind).items()}
    return {
        "type": "object",
        "description": doc,
        "properties": {PART: {"type": "string"}, **fields},
        "additionalProperties": False,
    }


def _field_schema(declared: Any) -> dict[str, Any]:
    about = {"description": declared.doc}
    if isinstance(declared, Quantity):
        unit = "" if declared.unit == "1" else f" Unit: {declared.unit}."
        return {"type": ["number", "string", "boolean", "array"], "description": f"{declared.doc}{unit}"}
    if isinstance(declared, Option):
        if declared.choices:
            return {**about, "enum": [c for c in declared.choices if c is not None]}
        return about | ({"type": ["string", "number"]} if declared.kind == "period" else {})
    return {**about, "anyOf": [{"$ref": "#/$defs/part"}, {"type": "array"}]}

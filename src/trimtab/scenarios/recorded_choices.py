"""Check of a log's metadata before a scenario is built from the recorded choices.

A file that is named only in a log is never opened.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.scenarios.build import CALIBRATION, LINKS
from trimtab.scenarios.catalogue import GAIN

FILE_ARGUMENTS = (*LINKS, CALIBRATION, GAIN)
"""Settings of a scenario whose value is a file name. A file that is named only in a log is never opened."""


class _FieldRule(NamedTuple):
    """Rule for the type of a metadata field.

    kind: name of the type in messages.  holds: function that returns True for a value of this type.
    """

    kind: str
    holds: Callable[[Any], bool]


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_table_of_texts(value: Any) -> bool:
    return _is_table(value) and all(map(_is_text, value)) and all(map(_is_text, value.values()))


def _is_list_of_texts(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(map(_is_text, value))


TEXT, TEXTS = _FieldRule("a text", _is_text), _FieldRule("a list of texts", _is_list_of_texts)
TABLE, TEXT_TABLE = _FieldRule("a table", _is_table), _FieldRule("a table of texts", _is_table_of_texts)
WHOLE = _FieldRule("a whole number", lambda value: isinstance(value, int) and not isinstance(value, bool))
RULES: Mapping[str, _FieldRule] = {
    "scenario": TEXT,
    "side": TEXT,
    "seed": WHOLE,
    "run": WHOLE,
    "parameters": TABLE,
    "parts": TEXT_TABLE,
    "choices": TABLE,
}
CHOICE_RULES: Mapping[str, _FieldRule] = {
    "scenario": TEXT,
    "arguments": TEXT_TABLE,
    "settings": TEXT_TABLE,
    "without": TEXTS,
    "faults": TEXTS,
    CALIBRATION: TABLE,
    GAIN: TABLE,
}
REQUIRED_CHOICES = ("arguments", "settings", "without", "faults")


def check_recorded_choices(log: Log) -> None:
    """Raise InputError if a field of the log's metadata has the wrong type, or if an argument is a file name.

    The message names the field. File names are not accepted, because a file that is named only in a log is not opened.
    """
    _check_fields(log.metadata, RULES, "")
    choices = log.metadata.get("choices")
    if not choices:
        return
    _check_fields(choices, CHOICE_RULES, "choices.")
    for name in REQUIRED_CHOICES:
        if choices.get(name) is None:
            raise _field_error(f"choices.{name}", "is missing")
    for name in choices["arguments"]:
        if name in FILE_ARGUMENTS:
            raise _field_error(f"choices.arguments.{name}", "is a file name, which this field must not contain")
    for name in (CALIBRATION, GAIN):
        if choices.get(name) is not None and not _is_text(choices[name].get("content")):
            raise _field_error(f"choices.{name}.content", "must be a text")


def _check_fields(fields: Mapping[str, Any], rules: Mapping[str, _FieldRule], prefix: str) -> None:
    for name, rule in rules.items():
        value = fields.get(name)
        if value is not None and not rule.holds(value):
            raise _field_error(f"{prefix}{name}", f"must be {rule.kind}, got {value!r:.60}")


def _field_error(field: str, problem: str) -> InputError:
    return InputError("log", f"the log's field {field} {problem}", fix="use an unchanged log written by trimtab")

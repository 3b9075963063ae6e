"""MAVLink dialect of a scenario: the standard messages, and messages derived from the samples and commands that vehicle
and autopilot exchange.

    SAMPLE_<SENSOR>   t, valid and the numbers of the value, one message for each sensor
    COMMAND           t, valid and the numbers of the value; as an extension the session number of the sender
    INSTANT           t and the number of samples; ends an instant when vehicle and autopilot run in lockstep

A sample that does not fit into one payload is sent in several messages, SAMPLE_<SENSOR>_1 and so on, each with t and
valid. Age and freshness of a sample are not sent, because the receiver computes them. Names and texts are restricted,
so that MAVLink's code generators for all programming languages accept them.
Source: https://mavlink.io/en/guide/xml_schema.html.
"""

import builtins
import hashlib
import keyword
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, leaves
from trimtab.core.signals import Command, Frame
from trimtab.flight.mavlink.authority import SESSION
from trimtab.flight.mavlink.definitions import MAX_PAYLOAD, SIZES, MessageDefinition, read_definitions

DESCRIPTION = re.compile(">[^<]*<")
"""Pattern of the text between two tags in the XML definitions."""
FIRST_ID = 0x747400
"""First id of derived messages ("tt", then a byte), far from the message ids of published dialects."""
MOST_MESSAGES = 256
TYPES = {"f": "double", "b": "uint8_t", "i8": "int64_t", "i4": "int32_t", "u4": "uint32_t"}
STANDARD = Path(__file__).with_name("standard.xml")
COMMAND, INSTANT = "command", "instant"
SESSION_TYPE = "uint32_t"
TIME, VALID = "t", "valid"
LANGUAGE_WORDS = """
    auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    bool true false class new delete this throw try catch namespace template public private protected virtual
    friend operator using function import package export final finally abstract boolean byte interface native
    super synchronized transient let var with yield await implements debugger instanceof typeof
"""
GENERATED_WORDS = """
    system_id component_id msg chan buf packet status msgbuf len self signing force_mavlink1 format name id
    fieldnames ordered_fieldnames orders lengths array_lengths crc_extra unpacker instance_field instance_offset
    msgname native_format fieldtypes fielddisplays_by_name fieldenums_by_name fieldunits_by_name
"""
"""Names of arguments and attributes in the code that MAVLink's generators write."""
RESERVED_WORDS = {
    w.lower() for w in (*LANGUAGE_WORDS.split(), *GENERATED_WORDS.split(), *keyword.kwlist, *dir(builtins))
}


class ValuePlace(NamedTuple):
    """Source of one value of a message: path of a number or array in the sample or command, index in the array, and
    MAVLink's type."""

    path: str
    slot: int
    type: str


class Dialect(NamedTuple):
    """Dialect of a link: all messages that vehicle, autopilot and ground stations can exchange.

    text: the definitions as MAVLink's XML.  definitions: definition of every message, by name.  by_id: the same by
    message id.
    groups: names of the messages that carry a sample or command, by path ("samples.imu", "command", "instant").
    places: source of each value of a derived message, by the message's name.
    """

    text: str
    definitions: Mapping[str, MessageDefinition]
    by_id: Mapping[int, MessageDefinition]
    groups: Mapping[str, tuple[str, ...]]
    places: Mapping[str, tuple[ValuePlace, ...]]

    @property
    def fingerprint(self) -> bytes:
        """Hash of the dialect, eight bytes. Vehicle and autopilot compare their hashes, because equal hashes mean equal
        formats of the messages.

        The hash depends on names, types, units and order of the fields, not on their descriptions.
        """
        return hashlib.sha256(DESCRIPTION.sub("><", self.text).encode()).digest()[:8]


class _FieldPiece(NamedTuple):
    """Part of a number or array that becomes one field of a message: `numbers` elements from index `start` on.

    scalar: True if the value at `path` is a single number, not an array.
    """

    path: str
    start: int
    numbers: int
    scalar: bool
    type: str
    unit: str
    doc: str

    @property
    def size(self) -> int:
        return self.numbers * SIZES[self.type]


def derive_dialect(frame_like: Frame, command_like: Command) -> Dialect:
    """Return the dialect for sensor samples and commands with the structure of the examples.

    Args:
        frame_like: example of a frame of samples, with any values.  command_like: example of a command, with any
            values.

    Raises InputError if there are more derived messages than message ids.
    """
    parts_of = {f"samples.{s}": _split_parts(sample, f"samples.{s}") for s, sample in frame_like.samples.items()}
    parts_of[COMMAND] = _split_parts(command_like, COMMAND, room=MAX_PAYLOAD - SIZES[SESSION_TYPE])
    now = _FieldPiece(TIME, 0, 1, True, "int64_t", "100 ns", "Time of the completed instant.")
    count = _FieldPiece("samples", 0, 1, True, "int32_t", "1", "Number of samples of this instant.")
    parts_of[INSTANT] = [[now, count]]
    standard = STANDARD.read_text("utf-8")
    used_names = {name.lower() for name in read_definitions(standard)}
    groups: dict[str, tuple[str, ...]] = {}
    contents: dict[str, list[_FieldPiece]] = {}
    for group, parts in sorted(parts_of.items()):
        name = message_name(group.replace("samples.", "sample_", 1))
        several = [name] if len(parts) == 1 else [f"{name}_{k + 1}" for k in range(len(parts))]
        groups[group] = tuple(unique_name(n, used_names) for n in several)
        contents |= dict(zip(groups[group], parts, strict=True))
    if len(contents) > MOST_MESSAGES:
        problem = f"{len(contents)} messages are needed, but only {MOST_MESSAGES} message ids are reserved"
        raise InputError("dialect", problem, fix="use fewer sensors, or combine several sensors into one")
    return _make_dialect(standard, groups, contents)


def _split_parts(record: Any, path: str, room: int = MAX_PAYLOAD) -> list[list[_FieldPiece]]:
    """Return the message fields of a sample or command (time, validity and the numbers of the value), split into as
    many payloads as needed."""
    head, rest = [], []
    for below, value, declared in leaves(record):
        if not isinstance(declared, Quantity):
            continue
        piece = _field_piece(f"{path}.{below}", value, declared)
        if below in (TIME, VALID):
            head.append(piece)
        elif below.startswith("value"):
            rest.append(piece)
    parts: list[list[_FieldPiece]] = [[*head]]
    for piece in rest:
        while piece.numbers:
            fit = (room - sum(p.size for p in parts[-1])) // SIZES[piece.type]
            if not fit or (fit < piece.numbers and len(parts[-1]) > len(head) and piece.size <= MAX_PAYLOAD // 2):
                parts.append([*head])
                continue
            fits = min(fit, piece.numbers)
            parts[-1].append(piece._replace(numbers=fits))
            piece = piece._replace(start=piece.start + fits, numbers=piece.numbers - fits)
    return parts


def _field_piece(path: str, value: Any, declared: Quantity) -> _FieldPiece:
    shape = np.shape(value)
    dtype = np.dtype(declared.dtype())
    kind = TYPES.get(dtype.kind) or TYPES[f"{dtype.kind}{dtype.itemsize}"]
    return _FieldPiece(path, 0, int(np.prod(shape, dtype=int)), shape == (), kind, declared.unit, declared.doc)


def _make_dialect(standard: str, groups: dict[str, tuple[str, ...]], contents: dict[str, list[_FieldPiece]]) -> Dialect:
    fields_of = {name: _name_fields(contents[name]) for name in sorted(contents)}
    group_of = {name: group for group, names in groups.items() for name in names}
    lines: list[str] = []
    for k, (name, fields) in enumerate(fields_of.items()):
        lines += _message_xml(name, FIRST_ID + k, group_of[name], fields)
    text = standard.replace("  </messages>", "\n".join([*lines, "  </messages>"]))
    definitions = read_definitions(text)
    places = {
        name: tuple(
            ValuePlace(fields[f.name].path, fields[f.name].start + k, f.type)
            for f in definitions[name].fields
            if f.name in fields
            for k in range(f.slots)
        )
        for name, fields in fields_of.items()
    }
    return Dialect(text, definitions, {d.id: d for d in definitions.values()}, groups, places)


def _name_fields(pieces: list[_FieldPiece]) -> dict[str, _FieldPiece]:
    used_names = {SESSION}
    return {unique_name(field_name(p.path), used_names): p for p in pieces}


def _message_xml(name: str, number: int, group: str, fields: dict[str, _FieldPiece]) -> list[str]:
    lines = [f'    <message id="{number}" name="{name}">']
    lines.append(f"      <description>{plain_text(f'trimtab: {group}')}</description>")
    for own, p in fields.items():
        kind = p.type if p.scalar else f"{p.type}[{p.numbers}]"
        unit = "" if p.unit == "1" else f' units="{plain_text(p.unit)}"'
        lines.append(f'      <field type="{kind}" name="{own}"{unit}>{plain_text(p.doc)}</field>')
    if group == COMMAND:
        lines += [
            "      <extensions/>",
            f'      <field type="{SESSION_TYPE}" name="{SESSION}">Session of the sender.</field>',
        ]
    return [*lines, "    </message>"]


def message_name(text: str) -> str:
    """Return a text converted to a valid message name: capitals, digits and underscores, starting with a letter."""
    return _legal_name(text).upper()


def field_name(path: str) -> str:
    """Return a message field's name, made from a path: the part of the path after `value`, or else the last name in the
    path, with underscores for dots."""
    _, _, below = path.partition(".value.")
    return _legal_name(below or path.rsplit(".", 1)[-1])


def unique_name(name: str, used_names: set[str]) -> str:
    """Return the name, with a number appended if the name is already used (ignoring case). Add the result to
    `used_names`.

    used_names: names in lower case.
    """
    unique, k = name, 1
    while unique.lower() in used_names:
        k += 1
        unique = f"{name}_{k}"
    used_names.add(unique.lower())
    return unique


def plain_text(text: str) -> str:
    """Return a text as one line without double quotes, safe in XML and in comments and strings of all languages."""
    ascii_only = text.replace("°", "deg").replace("²", "^2").replace("µ", "u").encode("ascii", "replace").decode()
    one_line = " ".join(re.sub("[\0-\x1f\x7f]", " ", ascii_only).split())
    one_line = one_line.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("'''", "'")
    return one_line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _legal_name(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    if not name[:1].isalpha():
        name = f"v_{name.lstrip('_')}"
    return f"{name}_" if name.lower() in RESERVED_WORDS else name

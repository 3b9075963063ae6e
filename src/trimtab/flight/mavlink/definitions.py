"""Definitions of messages, read from MAVLink's XML and used to pack and parse messages, and decoded messages.

A payload contains the fields of a message, ordered by the size of their elements, largest first. Fields with elements
of equal size keep the order of declaration. Extension fields follow in the order of declaration. The check byte
CRC_EXTRA is computed from the message's name and the fields without extensions.
Source: https://mavlink.io/en/guide/serialization.html.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree

from fastcrc.crc16 import mcrf4xx

from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest

CODES = {
    "double": "d",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "int32_t": "i",
    "uint32_t": "I",
    "int16_t": "h",
    "uint16_t": "H",
    "int8_t": "b",
    "uint8_t": "B",
    "char": "s",
}
SIZES = {name: struct.calcsize("<" + code) for name, code in CODES.items()}
VERSION_FIELD = "uint8_t_mavlink_version"
MAX_PAYLOAD = 255


class Field(NamedTuple):
    """Field of a message.

    type: MAVLink's name for the type of an element, `char` for text.
    length: number of elements, or 0 for a single number.
    at: index of the field's first value in the message.
    slots: number of the field's values. A text is one value.
    default: value of the field if no value is given.
    """

    name: str
    type: str
    length: int
    at: int
    slots: int
    default: int


class MessageDefinition(NamedTuple):
    """Definition of a message: its fields in the order of the payload, and the format of the payload.

    crc_extra: check byte of the definition.  size: number of bytes of the payload, with extensions.
    base: number of bytes of the payload without extensions.  ranges: lowest and highest value of each integer, None for
    a value that is not an integer.
    """

    name: str
    id: int
    fields: tuple[Field, ...]
    crc_extra: int
    packing: struct.Struct
    base: int
    where: Mapping[str, Field]
    ranges: tuple[tuple[int, int] | None, ...]

    def __repr__(self) -> str:
        """Return a short text with the message's name and number."""
        return f"<{self.name} {self.id}>"

    @property
    def size(self) -> int:
        """Number of bytes of the payload, including the extension fields."""
        return self.packing.size

    @property
    def blank_values(self) -> list[Any]:
        """Return the default values of all fields of a message, in the order of the payload."""
        values: list[Any] = []
        for f in self.fields:
            values += [b""] if f.type == "char" else [f.default] * f.slots
        return values


def read_definitions(text: str) -> dict[str, MessageDefinition]:
    """Return the definition of each message in the text of a MAVLink XML file, by the message's name. Enumerations are
    skipped."""
    root = ElementTree.fromstring(text)
    version = int(root.findtext("version", "3"))
    return {m.attrib["name"]: _read_definition(m, version) for m in root.iter("message")}


def _read_definition(message: ElementTree.Element, version: int) -> MessageDefinition:
    base, extensions = [], []
    target = base
    for child in message:
        if child.tag == "extensions":
            target = extensions
        elif child.tag == "field":
            target.append(_read_field(child, version))
    base.sort(key=lambda f: -SIZES[f.type])
    fields, at = [], 0
    for f in [*base, *extensions]:
        fields.append(f._replace(at=at))
        at += f.slots
    packing = struct.Struct("<" + "".join(_struct_code(f) for f in fields))
    name = message.attrib["name"]
    return MessageDefinition(
        name=name,
        id=int(message.attrib["id"]),
        fields=tuple(fields),
        crc_extra=_crc_extra(name, base),
        packing=packing,
        base=sum(SIZES[f.type] * max(f.length, 1) for f in base),
        where={f.name: f for f in fields},
        ranges=tuple(_integer_range(f.type) for f in fields for _ in range(f.slots)),
    )


def _read_field(element: ElementTree.Element, version: int) -> Field:
    kind, _, length = element.attrib["type"].rstrip("]").partition("[")
    default = 0
    if kind == VERSION_FIELD:
        kind, default = "uint8_t", version
    count = int(length or 0)
    slots = 1 if kind == "char" else max(count, 1)
    return Field(element.attrib["name"], kind, count, 0, slots, default)


def _struct_code(field: Field) -> str:
    return f"{max(field.length, 1)}{CODES[field.type]}" if field.length or field.type == "char" else CODES[field.type]


def _crc_extra(name: str, base: list[Field]) -> int:
    text = name.encode() + b" "
    for f in base:
        text += f"{f.type} {f.name} ".encode() + (bytes((f.length,)) if f.length else b"")
    low, high = mcrf4xx(text).to_bytes(2, "little")
    return low ^ high


def _integer_range(kind: str) -> tuple[int, int] | None:
    if kind in ("double", "float", "char"):
        return None
    bits = 8 * SIZES[kind]
    return (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


class Message(NamedTuple):
    """Decoded message.

    values: values in the order of the payload. An array has one value per element. A text is one value of type bytes.
    `Dialect.places` states the meaning of each value.
    system, component: ids of the sender.  is_signed: True if the signature was checked and is valid.
    link: stream number of the signature, or 0 without a signature.
    """

    name: str
    values: tuple[Any, ...]
    definition: MessageDefinition
    system: int
    component: int
    is_signed: bool
    link: int = 0

    def get(self, field: str) -> Any:
        """Return the value of the field with the given name: a number, a tuple of numbers, or a text."""
        return _field_value(self.definition.where[field], self.values)

    def fields(self) -> dict[str, Any]:
        """Return the values of all fields, by field name."""
        return {f.name: _field_value(f, self.values) for f in self.definition.fields}


def _field_value(field: Field, values: tuple[Any, ...]) -> Any:
    if field.type == "char":
        return values[field.at].partition(b"\0")[0].decode("utf-8", "replace")
    return values[field.at : field.at + field.slots] if field.length else values[field.at]


def arrange_values(definition: MessageDefinition, fields: Mapping[str, Any]) -> list[Any]:
    """Return the values of named fields in the order of the payload. Missing fields get their default.

    Raises InputError for a field that the message does not have, or with the wrong number of values.
    """
    values = definition.blank_values
    for name, value in fields.items():
        field = definition.where.get(name)
        if field is None:
            near = closest(name, definition.where) or list(definition.where)
            problem = f"no field {name!r}"
            raise InputError(f"message {definition.name}", problem, choices=near, fix=f"write {near[0]!r}")
        if field.type == "char":
            values[field.at] = value.encode() if isinstance(value, str) else bytes(value)
        elif field.length:
            if len(value) != field.length:
                problem = f"the field {name} must have {field.length} values, got {len(value)}"
                raise InputError(f"message {definition.name}", problem, fix=f"give {field.length} values")
            values[field.at : field.at + field.slots] = value
        else:
            values[field.at] = value
    return values


def fit_values(definition: MessageDefinition, values: Sequence[Any]) -> list[Any]:
    """Return the values, each limited to the range of its integer type. NaN in an integer field becomes 0."""
    if len(values) != len(definition.ranges):
        problem = f"the message must have {len(definition.ranges)} values, got {len(values)}"
        raise InputError(
            f"message {definition.name}",
            problem,
            fix="pass the values by field name, or all values in the order of the payload",
        )
    kinds = [f.type for f in definition.fields for _ in range(f.slots)]
    return [_fit_value(v, r, k) for v, r, k in zip(values, definition.ranges, kinds, strict=True)]


def _fit_value(value: Any, allowed: tuple[int, int] | None, kind: str) -> Any:
    if kind == "char":
        return value.encode() if isinstance(value, str) else bytes(value)
    if allowed is None:
        real = float(value)
        if kind == "float" and math.isfinite(real) and abs(real) > 3.4028235677973366e38:
            return math.copysign(math.inf, real)
        return real
    low, high = allowed
    if value != value:
        return 0
    return low if value <= low else high if value >= high else int(value)

"""A message that has come in, and values put into the shape that a definition packs."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from trimtab.core.errors import InputError, closest
from trimtab.wire.definitions import Definition, Field


class Message(NamedTuple):
    """A decoded message.

    values: in the order of the payload, arrays number by number, text as bytes; `places` of the dialect say which is
    which.  system, component: who sent it, on which link.  signed: whether its signature was checked and right.
    """

    name: str
    values: tuple[Any, ...]
    definition: Definition
    system: int
    component: int
    link: int
    sequence: int
    signed: bool

    def get(self, field: str) -> Any:
        """A field by name: a number, a tuple of numbers, or a text."""
        return _value(self.definition.where[field], self.values)

    def fields(self) -> dict[str, Any]:
        """Every field by name."""
        return {f.name: _value(f, self.values) for f in self.definition.fields}


def _value(field: Field, values: tuple[Any, ...]) -> Any:
    if field.type == "char":
        return values[field.at].partition(b"\0")[0].decode("utf-8", "replace")
    return values[field.at : field.at + field.slots] if field.length else values[field.at]


def arrange(definition: Definition, given: Mapping[str, Any]) -> list[Any]:
    """Values in the order of the payload from fields by name; what is not given is zero.

    Raises InputError for a field that the message doesn't have, or with the wrong number of values.
    """
    values = definition.blank
    for name, value in given.items():
        field = definition.where.get(name)
        if field is None:
            near = closest(name, definition.where) or list(definition.where)
            problem = f"there is no field {name!r}"
            raise InputError(f"message {definition.name}", problem, choices=near, fix=f"write {near[0]!r}")
        if field.type == "char":
            values[field.at] = value.encode() if isinstance(value, str) else bytes(value)
        elif field.length:
            if len(value) != field.length:
                problem = f"{name} has {field.length} values, not {len(value)}"
                raise InputError(f"message {definition.name}", problem, fix=f"give {field.length} values")
            values[field.at : field.at + field.slots] = value
        else:
            values[field.at] = value
    return values


def fitted(definition: Definition, values: Sequence[Any]) -> list[Any]:
    """The same values, each the nearest that its type can hold; NaN becomes 0 in an integer."""
    if len(values) != len(definition.ranges):
        problem = f"has {len(definition.ranges)} values, not {len(values)}"
        raise InputError(f"message {definition.name}", problem, fix="give them by name, or in the payload's order")
    kinds = [f.type for f in definition.fields for _ in range(f.slots)]
    return [_fit(v, r, k) for v, r, k in zip(values, definition.ranges, kinds, strict=True)]


def _fit(value: Any, allowed: tuple[int, int] | None, kind: str) -> Any:
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

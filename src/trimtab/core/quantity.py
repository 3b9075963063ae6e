"""Declarations of fields (unit, meaning and valid range), and access to them.

Three kinds of field:

- ``quantity``: a number or array. It is a run-time input: a new value needs no new compilation.
- ``part``: another record, a mapping or tuple of records, or None.
- ``option``: a choice or a period. It is part of the program: a new value needs a new compilation.

A field has the same name in ``--set``, the log, the plots and the exported code. This module does not import JAX, so
programs that only read logs, draw them or run compiled code start without JAX.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.units import check_kept, check_symbols

Scalar = Any
"""Type of a number: a float, or an array of shape () while a run is traced."""

DTYPES = {
    "real": np.float64,
    "angle": np.float64,
    "time": np.int64,
    "count": np.int32,
    "mode": np.int32,
    "word": np.uint32,
    "flag": np.bool_,
}
KINDS = tuple(DTYPES)
MISSING = dataclasses.MISSING


@dataclasses.dataclass(frozen=True)
class Quantity:
    """Declaration of a numeric field. Bounds are checked before a run. Values must be > above, >= low and <= high."""

    unit: str
    doc: str
    frame: str = ""
    kind: str = "real"
    source: str = ""
    above: float | None = None
    low: float | None = None
    high: float | None = None
    modes: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()

    def dtype(self) -> Any:
        """Return the numpy type that the field has in a run."""
        return DTYPES[self.kind]


@dataclasses.dataclass(frozen=True)
class Part:
    """Declaration of a nested record. optional: record that replaces None when a setting names one of its fields."""

    doc: str
    optional: Any = None


@dataclasses.dataclass(frozen=True)
class Option:
    """Declaration of a static choice. Kind `period` is a time in integer units of 100 ns, at least `low`."""

    doc: str
    kind: str = "choice"
    choices: tuple[Any, ...] = ()
    low: int | None = None


Declaration = Quantity | Part | Option

Off = Mapping[str, Any]
"""Name of an imperfection -> value of the field without the imperfection, or a function from record to this value."""
NOTHING_OFF: Off = MappingProxyType({})


def quantity(
    unit: str,
    doc: str,
    *,
    default: Any = MISSING,
    frame: str = "",
    kind: str = "real",
    source: str = "",
    above: float | None = None,
    low: float | None = None,
    high: float | None = None,
    modes: tuple[str, ...] = (),
    shape: tuple[int, ...] = (),
    off: Off = NOTHING_OFF,
) -> Any:
    """Declare a numeric field: unit ("1" when it has none), meaning, frame, kind, valid range and source.

    >>> from trimtab import quantity, record
    >>> @record
    ... class Spring:
    ...     stiffness: float = quantity("N/m", "Spring stiffness.", default=20.0, above=0)
    >>> Spring()
    Spring(stiffness=20.0)
    """
    if kind not in KINDS:
        raise TypeError(f"quantity kind {kind!r} is not one of {KINDS}")
    _check_declaration(unit, {"above": above, "low": low, "high": high}, shape)
    check_symbols(unit)
    check_kept(unit)
    declared = Quantity(unit, doc, frame, kind, source, above, low, high, modes, shape)
    return _field(declared, default, off)


def _check_declaration(unit: Any, bounds: Mapping[str, Any], shape: Any) -> None:
    """Raise InputError for a unit that is not a text, a bound that is not a number, or a shape that is not a tuple."""
    if not isinstance(unit, str) or not unit:
        problem = f"the unit must be a text, got {unit!r}"
        raise InputError("quantity", problem, fix='quantity("m", "Meaning.", …); the unit of a pure number is "1"')
    for name, bound in bounds.items():
        if bound is not None and (isinstance(bound, str) or not isinstance(bound, int | float | np.number)):
            fix = f"write {name}=0.0, without quotes and without a unit"
            raise InputError("quantity", f"{name} must be a number in {unit}, got {bound!r}", fix=fix)
    low, high = bounds["low"], bounds["high"]
    if low is not None and high is not None and low > high:
        raise InputError(
            "quantity",
            f"low must not be above high, got low={low:g} and high={high:g}",
            fix=f"write low={high:g}, high={low:g}",
        )
    if not isinstance(shape, tuple):
        raise InputError("quantity", f"shape must be a tuple, got {shape!r}", fix=f"write shape=({shape},)")


def part(doc: str, *, default: Any = MISSING, off: Off = NOTHING_OFF, optional: Any = None) -> Any:
    """Declare a nested record (or a mapping or tuple of records, or None).

    >>> from trimtab import part, record
    >>> from trimtab.links.wire import Wire
    >>> @record
    ... class Line:
    ...     wire: Wire = part("Wire of the line.", default=Wire())
    >>> Line().wire.period
    10000

    optional: for a part that may be None, the record that replaces None when a setting names one of its fields.
    """
    return _field(Part(doc, optional), default, off)


def option(
    doc: str,
    *,
    default: Any = MISSING,
    choices: tuple[Any, ...] = (),
    kind: str = "choice",
    off: Off = NOTHING_OFF,
) -> Any:
    """Declare a static choice; `choices` lists the valid values.

    >>> from trimtab import option, record
    >>> @record
    ... class Gearbox:
    ...     gear: str = option("Selected gear.", default="low", choices=("low", "high"))
    >>> Gearbox("high").gear
    'high'
    """
    return _field(Option(doc, kind, choices), default, off)


def period(doc: str, *, default: Any = MISSING, low: int = 1, off: Off = NOTHING_OFF) -> Any:
    """Declare a static time in integer units of 100 ns, e.g. ``default=ms(6)``; at least `low`.

    >>> from trimtab import period, record
    >>> @record
    ... class Lamp:
    ...     blink: int = period("Time between two blinks.", default="500 ms")
    >>> Lamp().blink
    5000000
    """
    return _field(Option(doc, "period", (), low), default, off)


def imperfection(
    unit: str,
    doc: str,
    name: str,
    *,
    default: Any = 0.0,
    low: float | None = 0,
    high: float | None = None,
    source: str = "",
) -> Any:
    """Declare the size of an imperfection. The size 0 switches the imperfection off."""
    return quantity(unit, doc, default=default, low=low, high=high, source=source, off={name: 0.0})


def switch(doc: str, name: str) -> Any:
    """Declare a flag that is True while an imperfection is switched on. The default is True."""
    return option(doc, default=True, choices=(True, False), off={name: False})


def _field(declared: Declaration, default: Any, off: Off = NOTHING_OFF) -> Any:
    metadata = {"declared": declared, "off": off}
    if isinstance(default, Mapping | np.ndarray | list):  # dataclasses refuse mutable defaults
        return dataclasses.field(default_factory=lambda: default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def is_record(value: Any) -> bool:
    """Return True if value is an instance of a record."""
    return _is_record_class(type(value))


@functools.cache
def _is_record_class(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) and all("declared" in f.metadata for f in dataclasses.fields(kind))


def declarations(cls: Any) -> Mapping[str, Declaration]:
    """Return the declaration of each field of a record or a class of records, keyed by field name."""
    return _declarations_of(cls if isinstance(cls, type) else type(cls))


@functools.cache
def _declarations_of(kind: Any) -> Mapping[str, Declaration]:
    return MappingProxyType({f.name: f.metadata["declared"] for f in dataclasses.fields(kind)})


def children(value: Any) -> list[tuple[str, Any, Declaration | None]]:
    """Return name, value and declaration of each child of a record, mapping or tuple."""
    if is_record(value):
        declared = declarations(value)
        return [(n, getattr(value, n), d) for n, d in declared.items()]
    if isinstance(value, Mapping):
        items: Any = value.items()  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
        return [(str(n), v, None) for n, v in items]
    if isinstance(value, tuple | list):
        several: Any = value  # pyright: ignore[reportUnknownVariableType]
        return [(str(i), v, None) for i, v in enumerate(several)]
    return []


def absent_parts(value: Any, path: str = "") -> Iterator[tuple[str, Part]]:
    """Yield every optional part below `value` that is None, as (dotted path, declaration), in field order."""
    for name, child, declared in children(value):
        here = f"{path}.{name}" if path else name
        if child is None and isinstance(declared, Part) and declared.optional is not None:
            yield here, declared
        elif not isinstance(declared, Quantity | Option):
            yield from absent_parts(child, here)


def records(value: Any, path: str = "") -> list[tuple[str, Any]]:
    """Return (path, record) for a record and for all records below it."""
    below = [pair for name, child, _ in children(value) for pair in records(child, f"{path}.{name}" if path else name)]
    return [(path, value), *below] if is_record(value) else below


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any, Quantity | Option]]:
    """Yield every quantity and option below `value`, as (dotted path, value, declaration), in field order."""
    for name, child, declared in children(value):
        here = f"{path}.{name}" if path else name
        if isinstance(declared, Quantity | Option):
            yield here, child, declared
        else:
            yield from leaves(child, here)


def part_classes(tree: Any, path: str = "") -> dict[str, str]:
    """Return the class name of each record below a tree, keyed by path."""
    classes = {}
    for name, child, _ in children(tree):
        here = f"{path}.{name}" if path else name
        classes |= ({here: type(child).__name__} if is_record(child) else {}) | part_classes(child, here)
    return classes


def plain_setting(value: Any) -> Any:
    """Return the value of a quantity or an option in the form in which a log's metadata stores it."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    return np.asarray(value).tolist()


def split_component(path: str) -> tuple[str, int | None]:
    """Split the path of a signal's component into path and index: ("truth.velocity", 2) for "truth.velocity[2]"."""
    match = re.fullmatch(r"(.+)\[(\d+)\]", path)
    return (match[1], int(match[2])) if match else (path, None)


def split_index(path: str) -> tuple[str, tuple[int, ...] | None]:
    """Split the path of a parameter's element into path and index: ("autopilot.law.K", (0, 1)) for
    "autopilot.law.K[0,1]"."""
    match = re.fullmatch(r"([^\[\]]+)\[(\d+(?:\s*,\s*\d+)*)\]", path.strip())
    return (match[1], tuple(int(i) for i in match[2].split(","))) if match else (path, None)


def has_index(shape: tuple[int, ...], at: tuple[int, ...] | None) -> bool:
    """Return True if an array of this shape has an element at this index. The index of a scalar is None."""
    return len(at or ()) == len(shape) and all(i < n for i, n in zip(at or (), shape, strict=True))


def first_number(path: str, shape: tuple[int, ...]) -> str:
    """Return the path of the first element of a parameter: "autopilot.law.K[0,0]", or the plain path of a scalar."""
    return f"{path}[{','.join('0' * len(shape))}]" if shape else path


def component_paths(path: str, shape: tuple[int, ...]) -> list[str]:
    """Return the path of each component of a signal: `path` itself for a scalar, else "truth.velocity[0]" and so on."""
    return [f"{path}[{i}]" for i in range(math.prod(shape))] if shape else [path]

"""What a field is declared as: unit, meaning and valid range; and reading what has been declared.

Three kinds of field:

- ``quantity``  a number or array; a run-time input, so that changing it never compiles anything again;
- ``part``      another record, a mapping or tuple of records, or None;
- ``option``    a choice or a period; it shapes the program, so changing it compiles again.

What is declared here is the name of the same thing in ``--set``, the log, the plots and the exported code. This module
does not import JAX: what only reads logs, draws them or flies a compiled program starts without it.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

Scalar = Any
"""A float, or an array of shape () while a run is traced."""

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
    """What a numeric field means. Bounds are checked before a run; `above` is strict, `low` and `high` are not."""

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
        """The numpy type that the field has in a run."""
        return DTYPES[self.kind]


@dataclasses.dataclass(frozen=True)
class Part:
    """A nested record. optional: what takes the place of None where a setting names one of its fields."""

    doc: str
    optional: Any = None


@dataclasses.dataclass(frozen=True)
class Option:
    """A static choice. Kind `period` is a time in integer units of 100 ns and must be at least `low`."""

    doc: str
    kind: str = "choice"
    choices: tuple[Any, ...] = ()
    low: int | None = None


Declaration = Quantity | Part | Option

Off = Mapping[str, Any]
"""Name of an imperfection -> what the field is without it: a value, or a function of the record that gives one."""
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
    """Declare a numeric field: unit ("1" when it has none), meaning, frame, kind, valid range and source."""
    if kind not in KINDS:
        raise TypeError(f"quantity kind {kind!r} is not one of {KINDS}")
    declared = Quantity(unit, doc, frame, kind, source, above, low, high, modes, shape)
    return _field(declared, default, off)


def part(doc: str, *, default: Any = MISSING, off: Off = NOTHING_OFF, optional: Any = None) -> Any:
    """Declare a nested record (or a mapping or tuple of records, or None).

    optional: for a part that may be None, the record that a setting of one of its fields puts there.
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
    """Declare a static choice; `choices` lists the valid values."""
    return _field(Option(doc, kind, choices), default, off)


def period(doc: str, *, default: Any = MISSING, low: int = 1, off: Off = NOTHING_OFF) -> Any:
    """Declare a static time in integer units of 100 ns, e.g. ``default=ms(6)``; at least `low`."""
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
    """Declare the size of an imperfection; at 0 it is switched off."""
    return quantity(unit, doc, default=default, low=low, high=high, source=source, off={name: 0.0})


def switch(doc: str, name: str) -> Any:
    """Declare whether an imperfection is there; it is, until it is switched off."""
    return option(doc, default=True, choices=(True, False), off={name: False})


def _field(declared: Declaration, default: Any, off: Off = NOTHING_OFF) -> Any:
    metadata = {"declared": declared, "off": off}
    if isinstance(default, Mapping | np.ndarray | list):  # dataclasses refuse mutable defaults
        return dataclasses.field(default_factory=lambda: default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def is_record(value: Any) -> bool:
    """Whether value is an instance of a record."""
    return _is_record_class(type(value))


@functools.cache
def _is_record_class(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) and all("declared" in f.metadata for f in dataclasses.fields(kind))


def declarations(cls: Any) -> Mapping[str, Declaration]:
    """Field name -> what was declared, for a record or its class."""
    return _declarations_of(cls if isinstance(cls, type) else type(cls))


@functools.cache
def _declarations_of(kind: Any) -> Mapping[str, Declaration]:
    return MappingProxyType({f.name: f.metadata["declared"] for f in dataclasses.fields(kind)})


def children(value: Any) -> list[tuple[str, Any, Declaration | None]]:
    """Name, value and declaration of everything one level below a record, mapping or tuple."""
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
    """Every optional part below value that is not there, as (dotted path, declaration), in declared order."""
    for name, child, declared in children(value):
        here = f"{path}.{name}" if path else name
        if child is None and isinstance(declared, Part) and declared.optional is not None:
            yield here, declared
        elif not isinstance(declared, Quantity | Option):
            yield from absent_parts(child, here)


def records(value: Any, path: str = "") -> list[tuple[str, Any]]:
    """Path and record, of a record and of all below it."""
    below = [pair for name, child, _ in children(value) for pair in records(child, f"{path}.{name}" if path else name)]
    return [(path, value), *below] if is_record(value) else below


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any, Quantity | Option]]:
    """Every quantity and option below value, as (dotted path, value, declaration), in declared order."""
    for name, child, declared in children(value):
        here = f"{path}.{name}" if path else name
        if isinstance(declared, Quantity | Option):
            yield here, child, declared
        else:
            yield from leaves(child, here)

"""Records: frozen dataclasses that are pytrees, each field declared once with unit, meaning and valid range.

Three kinds of field:

- ``quantity``  a number or array; a run-time input, so that changing it never compiles anything again;
- ``part``      another record, a mapping or tuple of records, or None;
- ``option``    a choice or a period; it shapes the program, so changing it compiles again.

What is declared here is the name of the same thing in ``--set``, the log, the plots and the exported code.

This module does not import JAX, so that what only reads logs starts without it. `core.float64`, which everything that
computes imports, makes the records pytrees; a program that imports JAX itself gets them as soon as it makes one.
"""

import dataclasses
import importlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar, dataclass_transform

import numpy as np

T = TypeVar("T")
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
PENDING_RECORDS: list[Any] = []
"""Records that are not pytrees yet, because nothing had imported JAX when they were made."""
X64_VARIABLE = "JAX_ENABLE_X64"
X64_WAS_UNSET = "jax" not in sys.modules and X64_VARIABLE not in os.environ
"""Whether JAX was told here to start in float64, should it be imported; `core.float64` takes the note away again."""
if X64_WAS_UNSET:
    os.environ[X64_VARIABLE] = "1"


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
    """A nested record."""

    doc: str


@dataclasses.dataclass(frozen=True)
class Option:
    """A static choice. Kind `period` is a time in integer units of 100 ns and must be at least `low`."""

    doc: str
    kind: str = "choice"
    choices: tuple[Any, ...] = ()
    low: int | None = None


Declaration = Quantity | Part | Option


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
) -> Any:
    """Declare a numeric field: unit ("1" when it has none), meaning, frame, kind, valid range and source."""
    if kind not in KINDS:
        raise TypeError(f"quantity kind {kind!r} is not one of {KINDS}")
    declared = Quantity(unit, doc, frame, kind, source, above, low, high, modes, shape)
    return _field(declared, default)


def part(doc: str, *, default: Any = MISSING) -> Any:
    """Declare a nested record (or a mapping or tuple of records, or None)."""
    return _field(Part(doc), default)


def option(doc: str, *, default: Any = MISSING, choices: tuple[Any, ...] = (), kind: str = "choice") -> Any:
    """Declare a static choice; `choices` lists the valid values."""
    return _field(Option(doc, kind, choices), default)


def period(doc: str, *, default: Any = MISSING, low: int = 1) -> Any:
    """Declare a static time in integer units of 100 ns, e.g. ``default=ms(6)``; at least `low`."""
    return _field(Option(doc, "period", (), low), default)


def _field(declared: Declaration, default: Any) -> Any:
    metadata = {"declared": declared}
    if isinstance(default, Mapping | np.ndarray | list):  # dataclasses refuse mutable defaults
        held: Any = default
        return dataclasses.field(default_factory=lambda: held, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclass_transform(frozen_default=True, field_specifiers=(quantity, part, option, period))
def record(cls: type[T]) -> type[T]:
    """Make a class a record: a frozen dataclass, and for JAX a pytree with the field names as path."""
    if "jax" not in sys.modules:
        _register_on_creation(cls)
    made: Any = dataclasses.dataclass(frozen=True, eq=False)(cls)
    for f in dataclasses.fields(made):
        if "declared" not in f.metadata:
            raise TypeError(f"{cls.__name__}.{f.name} is not declared: use quantity(), part(), option() or period()")
    PENDING_RECORDS.append(made)
    _register_pending_records()
    return made


def _register_pending_records() -> None:
    """Make the records that wait pytrees, once the program has imported JAX."""
    if PENDING_RECORDS and "jax" in sys.modules:
        importlib.import_module("trimtab.core.float64").register_records()


def _register_on_creation(cls: Any) -> None:
    """Let each new one of a class look whether JAX has been imported since the class was made."""
    finish = getattr(cls, "__post_init__", None)

    def __post_init__(self: Any) -> None:
        _register_pending_records()
        if finish is not None:
            finish(self)

    cls.__post_init__ = __post_init__


def is_record(value: Any) -> bool:
    """Whether value is an instance of a record."""
    kind = type(value)
    return dataclasses.is_dataclass(kind) and all("declared" in f.metadata for f in dataclasses.fields(kind))


def declarations(cls: Any) -> dict[str, Declaration]:
    """Field name -> what was declared, for a record or its class."""
    return {f.name: f.metadata["declared"] for f in dataclasses.fields(cls)}


def replace(r: T, **changes: Any) -> T:
    """A copy of a record with some fields changed."""
    made: Any = dataclasses.replace(r, **changes)  # pyright: ignore[reportArgumentType, reportUnknownVariableType, reportCallIssue]
    return made


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


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any, Quantity | Option]]:
    """Every quantity and option below value, as (dotted path, value, declaration), in declared order."""
    for name, child, declared in children(value):
        here = f"{path}.{name}" if path else name
        if isinstance(declared, Quantity | Option):
            yield here, child, declared
        else:
            yield from leaves(child, here)


def with_leaf(value: Any, path: str, change: Callable[[Any, Quantity | Option], Any]) -> Any:
    """A copy of a tree of records in which the leaf at a dotted path is change(old value, declaration).

    Raises KeyError with the path where there is no such leaf.
    """
    head, _, rest = path.partition(".")
    for name, child, declared in children(value):
        if name != head:
            continue
        if isinstance(declared, Quantity | Option):
            if rest:
                raise KeyError(path)
            return _replace_child(value, name, change(child, declared))
        if rest:
            return _replace_child(value, name, with_leaf(child, rest, change))
    raise KeyError(path)


def _replace_child(value: Any, name: str, child: Any) -> Any:
    if isinstance(value, Mapping):
        items: dict[str, Any] = dict(value)  # pyright: ignore[reportUnknownArgumentType]
        items[name] = child
        return items
    if isinstance(value, tuple):
        several: list[Any] = list(value)  # pyright: ignore[reportUnknownArgumentType]
        several[int(name)] = child
        return tuple(several)
    return replace(value, **{name: child})


def to_arrays(tree: T) -> T:
    """The same tree with every quantity as a numpy array of its declared type, so that equal programs compile once."""

    def convert(value: Any) -> Any:
        if is_record(value):
            changes: dict[str, Any] = {}
            for name, child, declared in children(value):
                if isinstance(declared, Quantity):
                    changes[name] = np.asarray(child, declared.dtype())
                elif isinstance(declared, Part):
                    changes[name] = convert(child)
            return replace(value, **changes)
        if isinstance(value, Mapping):
            items: Any = value.items()  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
            return {n: convert(v) for n, v in items}
        if isinstance(value, tuple):
            several: Any = value  # pyright: ignore[reportUnknownVariableType]
            return tuple(convert(v) for v in several)
        return value

    return convert(tree)


if "jax" in sys.modules:
    importlib.import_module("trimtab.core.float64")

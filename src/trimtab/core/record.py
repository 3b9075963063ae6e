"""Records: frozen dataclasses that are pytrees, each field declared once with unit, meaning and valid range.

Code that declares a record imports everything from this module, also the functions of `core.quantity`.

JAX computes in float64: states are integrated and time is counted in 64 bits everywhere. Importing this module sets
float64. A module that computes without importing this module must set float64 itself.
"""

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import (
    Declaration,
    Option,
    Part,
    Quantity,
    Scalar,
    absent_parts,
    children,
    declarations,
    imperfection,
    is_record,
    leaves,
    option,
    part,
    period,
    quantity,
    switch,
)
from trimtab.core.suggestions import closest
from trimtab.core.time import as_time, format_time
from trimtab.core.units import parse_amount

__all__ = [
    "FAST_COMPILE_OPTIONS",
    "Option",
    "Part",
    "Quantity",
    "Scalar",
    "absent_parts",
    "children",
    "declarations",
    "imperfection",
    "is_record",
    "leaves",
    "option",
    "part",
    "period",
    "quantity",
    "record",
    "replace",
    "switch",
    "to_arrays",
    "tree_where",
    "with_child",
    "with_leaf",
    "with_part_of",
]

jax.config.update("jax_enable_x64", True)

T = TypeVar("T")
FAST_COMPILE_OPTIONS: Any = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
if jax.__version_info__ < (0, 11):
    # XLA's older code for loops compiles in half the time. Code in one piece compiles faster than in the usual 32.
    FAST_COMPILE_OPTIONS |= {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}
"""Options for jax.jit(…, compiler_options=…) of code that runs once, so that it compiles in less time."""


@dataclass_transform(frozen_default=True, field_specifiers=(quantity, part, option, period))
def record(cls: type[T]) -> type[T]:
    """Make a class a record: a frozen dataclass, and for JAX a pytree with the field names as path.

    >>> from trimtab import quantity, record
    >>> @record
    ... class Tank:
    ...     level: float = quantity("m", "Level of the water.", default=1.0, low=0)
    >>> Tank(level="150 cm").level
    1.5

    A number may be given as a text with its unit, ``mass="3 kg"``, a period as ``"20 ms"``. The fields, with units and
    meanings, are appended to the class's docstring, so ``help`` shows them.
    """
    _accept_texts(cls)
    try:
        frozen: Any = dataclasses.dataclass(frozen=True, eq=False)(cls)
    except TypeError as error:  # a field without annotation, or a field without default after a field with default
        fix = 'name: float = quantity("m", "Meaning of the field.", default=0.0); fields without a default come first'
        raise InputError(f"record {cls.__name__}", str(error), fix=fix) from None
    _explain_changes(frozen)
    for f in dataclasses.fields(frozen):
        if "declared" not in f.metadata:
            problem = f"{f.name!r} has no declaration of its unit and meaning"
            fix = (
                f'{f.name}: float = quantity("m", "Meaning of the field.", default=0.0), or part(), option(), period()'
            )
            raise InputError(f"record {cls.__name__}", problem, fix=fix)
    _register_pytree(frozen)
    frozen.__doc__ = f"{inspect.cleandoc(cls.__doc__ or cls.__name__)}\n\n{_describe_fields(frozen)}".rstrip()
    return frozen


def _explain_changes(cls: Any) -> None:
    """Make an assignment to a field of a record raise an error that says what to write instead."""

    def __setattr__(self: Any, name: str, value: Any) -> None:
        kind = type(self).__name__.lower()
        problem = f"cannot assign to field {name!r}: records are immutable"
        raise dataclasses.FrozenInstanceError(f"{problem}; write {kind} = replace({kind}, {name}=…), from trimtab")

    cls.__setattr__ = __setattr__


def _accept_texts(cls: Any) -> None:
    """Make the constructor of a class convert texts such as "3 kg" to numbers, before its own __post_init__."""
    after = getattr(cls, "__post_init__", None)

    def __post_init__(self: Any) -> None:
        for name, value in list(self.__dict__.items()):
            if type(value) is str:
                object.__setattr__(self, name, _parse_text(type(self).__name__, name, value, declarations(self)[name]))
            elif type(value) is float and getattr(declarations(self)[name], "kind", "") == "period":
                as_time(f"{type(self).__name__}.{name}", value)
        if after is not None:
            after(self)

    cls.__post_init__ = __post_init__


def _parse_text(owner: str, name: str, text: str, declared: Declaration) -> Any:
    if isinstance(declared, Option):
        return as_time(f"{owner}.{name}", text) if declared.kind == "period" else text
    if not isinstance(declared, Quantity):
        return text
    try:
        return parse_amount(f"{owner}.{name}", text, declared.unit)
    except InputError as error:
        number = "1.0" if declared.unit == "1" else f'"1 {declared.unit}"'
        fix = f'{name}="{error.fix}"' if error.choices else f"{name}={number}"
        raise InputError(error.part, error.problem, choices=error.choices, fix=fix) from None


def _describe_fields(cls: Any) -> str:
    """Return a line for each field: name, unit, meaning, and its default."""
    lines = []
    for f in dataclasses.fields(cls):
        declared = f.metadata["declared"]
        unit = f" [{declared.unit}]" if isinstance(declared, Quantity) and declared.unit != "1" else ""
        default = ""
        if isinstance(f.default, int | float | str | bool) and not isinstance(declared, Part):
            is_time = isinstance(declared, Option) and declared.kind == "period" and isinstance(f.default, int)
            default = f" Default: {format_time(int(f.default)) if is_time else f.default}."
        choices = getattr(declared, "choices", ())
        offered = f" One of {', '.join(map(str, choices))}." if choices else ""
        lines.append(f"    {f.name}{unit}: {declared.doc}{offered}{default}")
    return "\n".join(["Fields:", *lines]) if lines else ""


def _register_pytree(cls: Any) -> None:
    """Register a record as a pytree: quantities and parts are children, options belong to the structure."""
    declared = declarations(cls)
    dynamic = tuple(n for n, d in declared.items() if not isinstance(d, Option))
    static = tuple(n for n, d in declared.items() if isinstance(d, Option))
    keys = tuple(jax.tree_util.GetAttrKey(n) for n in dynamic)

    def aux(r: Any) -> tuple[Any, ...]:
        return tuple(getattr(r, n) for n in static)

    def flatten(r: Any) -> tuple[Any, Any]:
        return [getattr(r, n) for n in dynamic], aux(r)

    def flatten_with_keys(r: Any) -> tuple[Any, Any]:
        return [(k, getattr(r, n)) for k, n in zip(keys, dynamic, strict=True)], aux(r)

    def unflatten(meta: Any, children: Any) -> Any:
        r = object.__new__(cls)
        for n, v in zip(dynamic, children, strict=True):
            object.__setattr__(r, n, v)
        for n, v in zip(static, meta, strict=True):
            object.__setattr__(r, n, v)
        return r

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)


def replace(r: T, /, **changes: Any) -> T:
    """Return a copy of a record with some fields changed.

    >>> from trimtab import build, replace
    >>> replace(build("hovercraft/spin").world.vehicle, mass="3000 g").mass
    3.0
    """
    known = list(declarations(r)) if is_record(r) else []
    for name in changes:
        if known and name not in known:
            near = closest(name, known, 3) or known
            fix = f"replace({type(r).__name__.lower()}, {near[0]}=…)"
            raise InputError(f"{type(r).__name__}.{name}", "the record has no such field", choices=near, fix=fix)
    copy: Any = dataclasses.replace(r, **changes)  # pyright: ignore[reportArgumentType, reportUnknownVariableType, reportCallIssue]
    return copy


def with_leaf(value: Any, path: str, change: Callable[[Any, Quantity | Option], Any]) -> Any:
    """Return a copy of a tree of records. The leaf at a dotted path is replaced by change(old value, declaration).

    Raises KeyError with the path if the leaf does not exist.
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


def with_part_of(value: T, path: str) -> T:
    """Return a tree of records in which each optional part along a dotted path is present, not None."""
    for where, declared in absent_parts(value):
        below = path.removeprefix(f"{where}.").partition(".")[0]
        if path.startswith(f"{where}.") and below in declarations(declared.optional):
            return with_child(value, where, declared.optional)
    return value


def with_child(value: Any, path: str, child: Any) -> Any:
    """Return a copy of a tree of records with a new child at a dotted path. A mapping may get a new key."""
    head, _, rest = path.partition(".")
    if not rest:
        return _replace_child(value, head, child)
    below = next(c for name, c, _ in children(value) if name == head)
    return _replace_child(value, head, with_child(below, rest, child))


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


def tree_where(condition: Any, a: T, b: T) -> T:
    """Return a where the condition is true, else b, for two trees of numbers with the same structure."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def to_arrays(tree: T) -> T:
    """Return the tree with each quantity as a numpy array of its declared type, so that equal programs compile once."""

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

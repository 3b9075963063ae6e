"""Imperfections: effects, such as noise, that can be switched off in a part.

An imperfection is declared at each field that the imperfection changes: `off=` states the field's value while the
imperfection is switched off. `imperfection()` and `switch()` declare a size or a flag that belongs to one imperfection.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from trimtab.core.errors import InputError
from trimtab.core.record import children, is_record, replace

T = TypeVar("T")


def imperfections(tree: Any, path: str = "") -> dict[str, list[str]]:
    """Return the paths of the records in a tree that declare each imperfection, keyed by the imperfection's name."""
    names: dict[str, list[str]] = {}
    for name in [name for field in fields(tree) for name in field.metadata["off"]] if is_record(tree) else ():
        names[name] = [path]
    for child_name, child, _ in children(tree):
        for name, paths in imperfections(child, f"{path}.{child_name}" if path else child_name).items():
            names.setdefault(name, []).extend(paths)
    return names


def without(tree: T, name: str) -> T:
    """Return a copy of a tree of records with an imperfection switched off in all records that declare it.

    Raises:
        InputError: if no record declares this imperfection.
    """
    known = imperfections(tree)
    if name not in known:
        fix = "write one of the choices" if known else "do not switch anything off: the part has no imperfections"
        raise InputError(type(tree).__name__, f"the part has no imperfection {name!r}", choices=known, fix=fix)
    return _switch_off(tree, name)


def without_any(tree: T) -> T:
    """Return a copy of a tree of records with every imperfection in it switched off."""
    for name in imperfections(tree):
        tree = without(tree, name)
    return tree


def _switch_off(tree: Any, name: str) -> Any:
    if is_record(tree):
        changes: dict[str, Any] = {}
        for field in fields(tree):
            own, off = getattr(tree, field.name), field.metadata["off"]
            if name in off:
                changes[field.name] = off[name](tree) if callable(off[name]) else off[name]
            elif name in imperfections(own):
                changes[field.name] = _switch_off(own, name)
        return replace(tree, **changes)
    if isinstance(tree, Mapping):
        return {key: _switch_off(value, name) for key, value in tree.items()}
    if isinstance(tree, tuple):
        return tuple(_switch_off(value, name) for value in tree)
    return tree

"""Construction of a scenario's parts from their names, as used in scenario files and settings.

A valid name is the name of a record class of the package, e.g. ``ForwardMomentum``, or of a class method without
arguments that describes a commercial product, e.g. ``Imu.microstrain_3dm_gx1``. No module is imported to look up a
name.

Source: docs page, Scenario files.
"""

import dataclasses
import functools
import importlib
import inspect
import re
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import Declaration, Part, children, declarations, is_record
from trimtab.core.record import with_child
from trimtab.core.suggestions import closest

FOLDERS = ("core", "environment", "vehicles", "sensors", "links", "estimators", "laws", "actuators", "loop")
DEFINITION = re.compile(r"^@record\nclass ([A-Z]\w*)", re.MULTILINE)
NOTHING = "none"
"""Value of a setting that removes a part or a sensor from the scenario."""
UNSET = object()

LeafParser = Callable[[str, str, Any, Any], Any]
"""Function (path, text, old value, declaration) that returns the value of a quantity or option. The old value is UNSET
if the field has no value yet."""


@functools.cache
def part_modules() -> Mapping[str, str]:
    """Return the name of a record class -> name of its module, for all classes in FOLDERS.

    The modules are searched as text and not imported.
    """
    root = Path(__file__).parents[1]
    files = [file for folder in FOLDERS for file in sorted((root / folder).rglob("*.py"))]
    names: dict[str, str] = {}
    for file in files:
        module = ".".join(("trimtab", *file.relative_to(root).with_suffix("").parts))
        names |= dict.fromkeys(DEFINITION.findall(file.read_text(encoding="utf-8")), module)
    return MappingProxyType(names)


def find_class(where: str, name: str) -> Any:
    """Return the record class with this name. Raise InputError if the package has no such class."""
    modules = part_modules()
    if name not in modules:
        near = closest(name, modules, 6)
        fix = f"{where}={near[0]}" if near else "trimtab list SCENARIO --toml  shows the parts of a scenario by name"
        raise InputError(where, f"unknown part {name!r}", choices=near, fix=fix)
    return getattr(importlib.import_module(modules[name]), name)


def presets(kind: Any) -> dict[str, Callable[[], Any]]:
    """Return the class methods of a record class that need no arguments and return a record of this class, by name."""
    found = {}
    for name, method in inspect.getmembers(kind, inspect.ismethod):
        arguments = inspect.signature(method).parameters.values()
        needed = [p for p in arguments if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
        gives = str(inspect.signature(method).return_annotation).strip("\"'")
        if not name.startswith("_") and not needed and gives in (kind.__name__, str(kind), "typing.Self"):
            found[name] = method
    return found


def is_name(text: str) -> bool:
    """Return True if a text has the form of a part's name, e.g. Wire or Imu.microstrain."""
    return re.fullmatch(r"\s*[A-Za-z]\w*(\.\w+)?\s*", text) is not None


def is_part(tree: Any, path: str) -> bool:
    """Return True if a path is that of a part, or of a field to which a part can be added.

    A part is a record or a container of records.
    """
    above, _, name = path.rpartition(".")
    tree = functools.reduce(_child, filter(None, above.split(".")), tree)
    below = {n: (child, declared) for n, child, declared in children(tree)}
    if name not in below:
        return isinstance(tree, Mapping)
    child, declared = below[name]
    return isinstance(declared, Part) or (declared is None and (is_record(child) or child is None))


def _child(tree: Any, name: str) -> Any:
    return {n: child for n, child, _ in children(tree)}.get(name)


def with_part(tree: Any, path: str, settings: dict[str, str], parse: LeafParser) -> Any:
    """Return a copy of a tree of records in which the part at a path is replaced by the part named in `settings`.

    An old part of the same class is kept. The setting of the path, and the settings of the new part's fields, are
    removed from `settings`.

    Raises: InputError for an unknown name of a part, and for a field that has neither a default nor a setting.
    """
    text = settings.pop(path).strip()
    above, _, name = path.rpartition(".")
    owner = functools.reduce(_child, filter(None, above.split(".")), tree)
    old, declared = {n: (c, d) for n, c, d in children(owner)}.get(name, (None, None))
    if text.lower() == NOTHING:
        return _without_part(tree, path, owner, declared)
    if type(old).__name__ == text:
        return tree
    return with_child(tree, path, make_part(path, text, settings, parse))


def _without_part(tree: Any, path: str, owner: Any, declared: Declaration | None) -> Any:
    above, _, name = path.rpartition(".")
    if isinstance(owner, Mapping):
        rest: Any = {n: v for n, v in owner.items() if n != name}  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
        return with_child(tree, above, rest)
    default = _default(owner, name) if isinstance(declared, Part) else UNSET
    if default is not None and default != ():
        raise InputError(
            argument_name("settings", path),
            "this part can't be left out",
            fix=f"set another part: {argument('settings', type(_child(owner, name)).__name__, path)}",
        )
    return with_child(tree, path, default)


def make_part(path: str, text: str, settings: dict[str, str], parse: LeafParser) -> Any:
    """Return a part of the class named in `text`.

    The part's fields are set from `settings`, and the settings that were used are removed from the dictionary.
    """
    where, (name, _, preset) = argument_name("settings", path), text.partition(".")
    kind = find_class(where, name)
    if preset:
        known = presets(kind)
        if preset not in known:
            raise InputError(
                where, f"{name} has no product {preset!r}", choices=known, fix=argument("settings", name, path)
            )
        return known[preset]()
    fields: dict[str, Any] = {}
    for field, declared in declarations(kind).items():
        own, default = f"{path}.{field}", _default(kind, field)
        if own in settings and isinstance(declared, Part):
            text_of_part = settings.pop(own)
            empty = text_of_part.lower() == NOTHING
            fields[field] = default if empty else make_part(own, text_of_part, settings, parse)
        elif own in settings:
            old = default if default is not UNSET else _example(kind, field)
            fields[field] = parse(own, settings.pop(own), old, declared)
        elif default is UNSET:
            raise _missing_field_error(name, own, declared)
    return kind(**fields)


def _default(kind: Any, field: str) -> Any:
    own = next(f for f in dataclasses.fields(kind) if f.name == field)
    if own.default_factory is not dataclasses.MISSING:
        return own.default_factory()
    return UNSET if own.default is dataclasses.MISSING else own.default


def _example(kind: Any, field: str) -> Any:
    """Return an example value (zero, False or "") for a field of type int, bool, str or float, else UNSET."""
    hint = typing.get_type_hints(kind if isinstance(kind, type) else type(kind)).get(field)
    return hint() if hint in (int, bool, str, float) else UNSET


def _missing_field_error(name: str, path: str, declared: Declaration) -> InputError:
    problem = f"{name} needs {path.rpartition('.')[2]!r}: {declared.doc[:1].lower()}{declared.doc[1:]}"
    if isinstance(declared, Part):
        return InputError(
            argument_name("settings", path), problem, fix=f"{argument('settings', 'NAME', path)}, the class of a part"
        )
    unit = getattr(declared, "unit", "1")
    return InputError(
        argument_name("settings", path),
        problem,
        fix=argument("settings", f"NUMBER{'' if unit == '1' else ' ' + unit}", path),
    )

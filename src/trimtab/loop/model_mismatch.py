"""Check that all vehicle models inside an autopilot are equal, and report of their differences from the true vehicle.

Each record of the vehicle's class in the autopilot is a vehicle model, e.g. the `craft` of a filter or the `model` of a
law. Models that differ from each other by mistake would make the flight wrong without a message. Therefore different
models are an error unless the setting `mismatch` names the difference. Models that all differ from the true vehicle are
allowed, because campaigns need such model errors. The log reports these differences.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import leaves, records

SHOWN = 6
"""Maximum number of differences between model and true vehicle that the report lists."""


class Mismatch(NamedTuple):
    """Parameter of the vehicle that differs between an autopilot's vehicle model and the true vehicle.

    path: path of the parameter in the vehicle, or in the autopilot if the autopilot's models differ.  assumed: value in
    the model, as text.  actual: value in the true vehicle, as text. For a part that only one of
    them has, the texts are "there" and "none".
    """

    path: str
    assumed: str
    actual: str


def vehicle_copies(autopilot: Any, vehicle: Any) -> dict[str, Any]:
    """Return the vehicle models in an autopilot, by path. A model is a record of the same class as the vehicle."""
    return {path: copy for path, copy in records(autopilot, "autopilot") if type(copy) is type(vehicle)}


def check_models(autopilot: Any, vehicle: Any, named: Iterable[str] = ()) -> None:
    """Raise InputError if parts of an autopilot use different models of the vehicle.

    named: paths of the models, or of single parameters of models, that may differ.
    """
    named = tuple(named)
    copies = vehicle_copies(autopilot, vehicle)
    for path in named:
        if not any(_is_below(path, copy) for copy in copies):
            problem = f"{path!r} is not the path of a vehicle model in the autopilot"
            raise InputError(
                argument_name("settings", "mismatch"),
                problem,
                choices=copies,
                fix=argument("settings", "PATH[,PATH…]", "mismatch"),
            )
    if not copies:
        return
    first, *others = copies
    for other in others:
        for below, a, b in _differences(copies[first], copies[other]):
            one, two = f"{first}.{below}", f"{other}.{below}"
            if not any(_is_below(path, name) for path in (one, two) for name in named):
                problem = f"two parts have different models of the vehicle: this value is {b}, but {one} is {a}"
                alike = " ".join(argument("settings", b, f"{c}.{below}") for c in copies if c != other)
                raise InputError(
                    two,
                    problem,
                    fix=f"{alike}; or, if they are meant to differ, {argument('settings', two, 'mismatch')}",
                )


def model_mismatches(autopilot: Any, vehicle: Any) -> list[Mismatch]:
    """Return the parameters that differ between the autopilot's vehicle models and the true vehicle.

    If the models differ from each other, the path of a parameter includes the path of the model.
    """
    copies = vehicle_copies(autopilot, vehicle)
    by_copy = {path: _differences(copy, vehicle) for path, copy in copies.items()}
    told: dict[str, Mismatch] = {}
    for path, differences in by_copy.items():
        for below, assumed, actual in differences:
            shared = all((below, assumed, actual) in others for others in by_copy.values())
            name = below if shared else f"{path}.{below}"
            told[name] = Mismatch(name, assumed, actual)
    return list(told.values())


def describe_mismatches(mismatches: Iterable[Mapping[str, str]]) -> str:
    """Return the differences in one line, e.g. "model ≠ world: mass 2.6 vs 3 (intended)", or "" if there are no
    differences."""
    parts = [f"{m['path']} {m['assumed']} vs {m['actual']}" for m in mismatches]
    more = f" and {len(parts) - SHOWN} more" if len(parts) > SHOWN else ""
    return f"model ≠ world: {', '.join(parts[:SHOWN])}{more} (intended)" if parts else ""


def _differences(one: Any, other: Any) -> list[tuple[str, str, str]]:
    """Return the differences between two records. Each difference consists of path, first value and second value.

    A part that is missing in one record is one difference. Values that are not finite are skipped, because
    `loop.checks` reports them.
    """
    a, b = ({path: value for path, value, _ in leaves(craft)} for craft in (one, other))
    parts = [{path for path, _ in records(craft)} for craft in (one, other)]
    lacking = parts[0] ^ parts[1]
    whole = [p for p in lacking if not any(_is_below(p, q) for q in lacking if q != p)]
    there = {True: "there", False: "none"}
    differences = [(p, there[p in parts[0]], there[p in parts[1]]) for p in whole]
    for path in a.keys() & b.keys():
        x, y = (np.asarray(v) for v in (a[path], b[path]))
        if not np.array_equal(x, y) and all(v.dtype.kind not in "fc" or np.isfinite(v).all() for v in (x, y)):
            differences.append((path, _as_text(a[path]), _as_text(b[path])))
    return sorted(differences)


def _as_text(value: Any) -> str:
    return f"{float(value):.6g}" if np.ndim(value) == 0 and not isinstance(value, str) else str(value)


def _is_below(path: str, above: str) -> bool:
    return path == above or path.startswith(f"{above}.")

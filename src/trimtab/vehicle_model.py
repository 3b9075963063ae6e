"""Trim and linear model of any vehicle: the Python functions of ``trimtab trim`` and ``trimtab linearise``."""

from collections.abc import Iterable, Mapping
from typing import Any

from trimtab.core.errors import InputError
from trimtab.core.explain_call import explain_call
from trimtab.design.linearise import LinearModel
from trimtab.design.trim import Trim
from trimtab.loop.scenario import Scenario
from trimtab.run.design_point import find_point, linearise_at
from trimtab.run.plant import Plant, load_plant, plant_of_vehicle

At = Mapping[str, float | str]


@explain_call()
def trim(vehicle: str | Scenario, at: At | None = None, *, settings: Mapping[str, str] | None = None) -> Trim:
    """Return a trim: states and inputs at which a vehicle is in equilibrium.

    >>> from trimtab import trim
    >>> point = trim("hovercraft/forward", {"surge_velocity": "3.6 km/h", "yaw_rate": 0})
    >>> bool(point.is_found), round(float(point.x[0]), 6)
    (True, 1.0)

    Args:
        vehicle: a scenario, or the name of a scenario or of a model, or ``file.py:function``.
        at: name of a state, input or output -> number in the vehicle's unit, text with a unit, "free", "fixed" or
            "LOW..HIGH". A name with ' is the time derivative: {"yaw'": 0.3}. ``trimtab trim --at``
            accepts the same values.
        settings: path -> value, as for ``--set``. Settings are only valid for a vehicle given by name.

    Raises: InputError for an unknown name. If no trim exists, no error is raised, but the field `why` of the result
        contains the reasons.
    """
    return find_point(_find_plant(vehicle, settings), _words(at))


@explain_call()
def linearise(
    vehicle: str | Scenario,
    at: At | None = None,
    *,
    states: Iterable[str] = (),
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    settings: Mapping[str, str] | None = None,
) -> LinearModel:
    """Return the linear model A, B, C, D of a vehicle about a trim, with signal names and a method `modes()`.

    >>> from trimtab import linearise
    >>> linear = linearise("hovercraft/forward", {"surge_velocity": "1 m/s"}, states=["surge_velocity", "yaw_rate"])
    >>> linear.A.shape, linear.inputs
    ((2, 2), ('FX', 'FY'))

    Args:
        vehicle, at, settings: as for `trim`.
        states, inputs, outputs: names of the states, inputs and outputs to keep. An empty list keeps all.

    Raises: InputError with the reasons if no trim is found.
    """
    plant = _find_plant(vehicle, settings)
    linear = linearise_at(plant, find_point(plant, _words(at)).require_trim("trim"))
    return linear.part(tuple(states) or None, tuple(inputs) or None, tuple(outputs) or None)


def _find_plant(vehicle: Any, settings: Mapping[str, str] | None) -> Plant:
    if isinstance(vehicle, Scenario):
        neutral = vehicle.world.actuators.neutral().u
        return plant_of_vehicle(vehicle.name, vehicle.world.vehicle, vehicle.initial, neutral)
    if not isinstance(vehicle, str):
        problem = f"must be a Scenario or the name of a scenario or model, got a {type(vehicle).__name__}"
        raise InputError("vehicle", problem, fix='pass a Scenario, or a name, e.g. "hovercraft/forward"')
    return load_plant(vehicle, settings)


def _words(at: At | None) -> tuple[str, ...]:
    return tuple(f"{name}={value}" for name, value in (at or {}).items())

"""Vehicles for the design commands, found by name: the vehicle of a scenario, a model of the package, or a user's
file."""

import importlib
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.core.quantity import records
from trimtab.core.record import to_arrays
from trimtab.core.suggestions import closest
from trimtab.design.coordinates import error_model, error_names, flight_names, trim_model
from trimtab.design.local_flight import LocalFlightState, fly_locally
from trimtab.design.model import StateSpaceModel, real_leaves
from trimtab.loop.linear_laws import describe_vehicle
from trimtab.loop.scenario import Scenario
from trimtab.loop.settings import with_settings
from trimtab.loop.structure import zeros_of
from trimtab.run.blocks import refuse_stepped_vehicle
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

FUNCTIONS = ("system", "scenario")
"""Function names that are tried, in this order, if the user names a Python file without a function."""


class Plant(NamedTuple):
    """Vehicle for trim and linearisation.

    name: name that the user typed.  model: model of the vehicle for a trim search.  error: function that returns, for a
    trim (x, u), the model of deviations from this trim.  units: name of a state, input or output -> unit.  places:
    names of the states that are positions, whose derivatives may have any value in a trim.  flight: function that
    returns the names of speed, climb, sideslip, roll and yaw in this model (`flight_names`).  scenario: scenario of the
    vehicle, or None.  about: class and units of the vehicle (`loop.linear_laws`).
    """

    name: str
    model: StateSpaceModel
    error: Callable[[Any, Any], StateSpaceModel]
    units: Mapping[str, str]
    places: frozenset[str]
    flight: Callable[[], dict[str, str]] = dict
    scenario: Scenario | None = None
    about: Mapping[str, str] = MappingProxyType({})


def load_plant(name: str, settings: Mapping[str, str] | None = None, assumed: Mapping[str, str] | None = None) -> Plant:
    """Return the vehicle for a name: that of a scenario, a model of the package, or the result of a user's function.

    settings: settings of the scenario.  assumed: settings of the vehicle model for the design, applied after
    `settings`.
    """
    settings = settings or {}
    own: Any = None
    if name in _model_names():
        own = importlib.import_module(f"trimtab.scenarios.{name}._models").model()
    elif ":" in name or name.endswith(".py"):
        name = _own_function(name)
        own = catalogue.load_scenario(name, settings)[0]
    elif not name.endswith((".toml", ".fmu")) and name not in catalogue.scenario_names():
        known = [*_model_names(), *catalogue.scenario_names()]
        near = closest(name, known, 1) or ["hypersonic"]
        fix = f"trimtab trim {near[0]}; for a vehicle of your own, name its function:  trimtab trim my_boat.py:scenario"
        raise InputError(f"vehicle {name!r}", "unknown vehicle or scenario", choices=known, fix=fix)
    if own is None or isinstance(own, Scenario):
        scenario = build(name, settings)
        refuse_stepped_vehicle(scenario)
        u = scenario.world.actuators.neutral().u
        vehicle = with_settings(scenario.world.vehicle, assumed or {})
        return plant_of_vehicle(name, vehicle, scenario.initial, u)._replace(scenario=scenario)
    if settings or (assumed and not isinstance(own, tuple)):
        fix = f"leave {argument_name('settings')} out, or use the name of a scenario, whose parts have settings"
        raise InputError(argument_name("settings"), f"{name} is a model, which has no settings", fix=fix)
    return _plant_of_own(name, own, assumed or {})


def _plant_of_own(name: str, own: Any, assumed: Mapping[str, str]) -> Plant:
    if isinstance(own, StateSpaceModel):
        return plant_of_model(name, own)
    if isinstance(own, tuple):
        parts: tuple[Any, ...] = own  # pyright: ignore[reportUnknownVariableType]
        if len(parts) == 3 and hasattr(parts[0], "dynamics"):
            return plant_of_vehicle(name, with_settings(parts[0], assumed), parts[1], parts[2])
    problem = f"the function must return a scenario, a vehicle or a model, got a {type(own).__name__}"
    fix = "return a Scenario, (vehicle, x, u), or model_of_functions(f, states, inputs, h=h) (docs, Any vehicle)"
    raise InputError(f"vehicle {name!r}", problem, fix=fix)


def plant_of_model(name: str, model: StateSpaceModel) -> Plant:
    """Return a model as a plant. The units are those that the model's records declare, if the model has records."""
    units: dict[str, str] = {}
    for own, names in ((model.state_record, model.states), (model.input_record, model.inputs)):
        units |= {} if own is None else _units_by_name(own, names)
    units |= {n: units[n] for n in model.outputs if n in units}
    return Plant(name, model, lambda x, u: model._replace(x0=np.asarray(x), u0=np.asarray(u)), units, frozenset())


def plant_of_vehicle(name: str, vehicle: Any, x: Any, u: Any) -> Plant:
    """Return a vehicle as a plant, near state x and input u.

    The states of a flight over the earth are converted to states relative to a local frame.
    """
    about = describe_vehicle(vehicle, x, u)
    vehicle, x = fly_locally(to_arrays(vehicle), x)
    zeros_of("world.vehicle", "the state and the input", vehicle.dynamics, 0.0, to_arrays(x), to_arrays(u))
    model = trim_model(vehicle, x, u)
    units = _units_by_name(x, model.states) | _units_by_name(u, model.inputs)
    units |= {n: "rad" if d.shape == (4,) else d.unit for path, _, d in real_leaves(x) for n in error_names(x, path)}
    units |= {"speed": "m/s", "angle_of_attack": "rad", "sideslip": "rad", "climb": "rad"}
    places = {n for p, _, d in real_leaves(x) for n in model.states if _is_place(p, d, n)}
    places |= _local_places(x)

    def error(xs: Any, us: Any) -> StateSpaceModel:
        return error_model(vehicle, model.state(xs), model.input(us))

    flight = partial(flight_names, vehicle, model)
    return Plant(name, model, error, units, frozenset(places), flight, about=about)


def _units_by_name(record: Any, names: tuple[str, ...]) -> dict[str, str]:
    units: dict[str, str] = {}
    for path, _, d in real_leaves(record):
        for name in names:
            own = name.removeprefix("u.")
            if own == path or own.startswith((f"{path}[", f"{path}.")):
                units[name] = "rad" if d.shape == (4,) and len(d.frame) == 2 else d.unit
    return units


def _is_place(path: str, d: Any, name: str) -> bool:
    """Return True if a state is an element of a three-dimensional position vector."""
    return d.unit == "m" and d.shape == (3,) and name.startswith(f"{path}[")


def _local_places(x: Any) -> set[str]:
    where = [path for path, own in records(x) if isinstance(own, LocalFlightState)]
    return {f"{path}.{n}" if path else n for path in where for n in ("latitude", "longitude", "height")}


def _model_names() -> list[str]:
    return sorted(file.parent.name for file in catalogue.FOLDER.glob("*/_models.py"))


def _own_function(name: str) -> str:
    """Return "file.py:function". If the name contains no function, the first name in FUNCTIONS that the file defines is
    used."""
    if ":" in name:
        return name
    for function in FUNCTIONS[:-1]:
        try:
            catalogue.load_function(f"{name}:{function}")
        except InputError as error:
            if "no function" not in error.problem:
                raise
        else:
            return f"{name}:{function}"
    return f"{name}:{FUNCTIONS[-1]}"

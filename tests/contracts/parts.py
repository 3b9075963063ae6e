"""Finds every public record of a folder, makes one of each, and gives it inputs: what the contract tests stand on.

Nothing is registered. A module that lies in the folder is found; a part is made from its defaults, and where a field
has none, from what the field declares; an input is made from the interface that the folder speaks.
"""

import dataclasses
import functools
import importlib
import inspect
import itertools
import math
import pkgutil
import typing
from dataclasses import MISSING, fields
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Option, Part, Quantity, declarations, quantity, record, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import (
    STICK_MODES,
    Estimate,
    Frame,
    Motion,
    Peers,
    PeerView,
    PlanarForce,
    PlanarState,
    Sample,
    Stick,
    new_sample,
)
from trimtab.core.time import ms
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.planar_pose import PlanarPoseState

FOLDERS = ("vehicles", "sensors", "links", "estimators", "laws", "actuators")
UNFIT = (AttributeError, KeyError, TypeError, IndexError, ValueError, InputError)


def modules(folder: str) -> list[ModuleType]:
    """Every public module of trimtab.<folder> and of the folders in it."""
    package = importlib.import_module(f"trimtab.{folder}")
    below = pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    names = [m.name for m in below if not m.ispkg and not m.name.rpartition(".")[2].startswith("_")]
    return [importlib.import_module(name) for name in names]


def records(folder: str) -> list[type]:
    """Every public record class defined in the folder."""
    return [
        cls
        for module in modules(folder)
        for name, cls in vars(module).items()
        if isinstance(cls, type)
        and cls.__module__ == module.__name__
        and not name.startswith("_")
        and getattr(cls, "__dataclass_fields__", None) is not None
        and all("declared" in f.metadata for f in fields(cls))
    ]


def blocks(folder: str) -> list[type]:
    """The records that the loop steps: with a step(), and an init() that takes a key; a law says what it reads."""
    found = [cls for cls in records(folder) if folder != "laws" or hasattr(cls, "reads")]
    return [cls for cls in found if hasattr(cls, "step") and "key" in _parameters(getattr(cls, "init", None))]


def _parameters(function: Any) -> list[str]:
    return list(inspect.signature(function).parameters) if function else []


def every(find: Any, folders: tuple[str, ...] = FOLDERS) -> list[Any]:
    """What find gives for each folder, as pytest parameters named folder.name."""
    import pytest

    def name(found: Any) -> str:
        return found.__name__.rsplit(".", 1)[-1]

    return [pytest.param(folder, found, id=f"{folder}.{name(found)}") for folder in folders for found in find(folder)]


@functools.cache
def made(cls: type) -> Any:
    """One of a class, out of defaults and, where there are none, of declared ranges; numeric as in a run."""
    hints = typing.get_type_hints(cls)
    missing = [f.name for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING]
    choices = [_values(cls, name, declarations(cls)[name], hints[name]) for name in missing]
    errors = []
    for values in itertools.product(*choices):
        one = cls(**dict(zip(missing, values, strict=True)))
        try:
            getattr(one, "check", lambda: None)()
        except UNFIT as error:
            errors.append(str(error))
            continue
        return to_arrays(one)
    raise AssertionError(f"{cls.__name__} can't be made from what its fields declare; give them defaults: {errors}")


def _values(cls: type, name: str, declared: Quantity | Part | Option, hint: Any) -> list[Any]:
    if isinstance(declared, Quantity):
        low = declared.low if declared.low is not None else declared.above
        value = 0.04 if low is None or low < 0.04 else low + 1.0
        value = value if declared.high is None else min(value, declared.high)
        value = value if declared.kind in ("real", "angle") else 0
        exact = np.asarray(value, declared.dtype())
        return [np.full(declared.shape, exact)] if declared.shape else [exact, np.full(3, exact)]
    if isinstance(declared, Option):
        if declared.kind == "period":
            return [max(declared.low or 1, ms(20))]
        return [*declared.choices] or [{int: 2, bool: False}[hint]]
    if isinstance(hint, type) and hasattr(hint, "__dataclass_fields__"):
        return [made(hint)]
    assert hint is Any, f"{cls.__name__}.{name} has no default and no record as its type"
    return [PlanarForce(0.0, 0.0), PlanarState(0.0, 0.0, 0.0, 0.0)]


def key(run: Any) -> Key:
    """The key of a run."""
    return Key(np.uint32(7), jnp.asarray(run, np.uint32), 12345)


def planar_state(t: Any) -> PlanarState:
    """A planar state that differs at each instant, near which nothing is singular."""
    s = t * 1e-7
    return PlanarState(0.4 + 0.3 * jnp.sin(s), 0.2 * jnp.cos(3 * s), 0.7 * jnp.sin(2 * s + 1), 0.5 + jnp.sin(s))


def planar_force(t: Any) -> PlanarForce:
    """A force that turns round and changes sign."""
    s = t * 1e-7
    return PlanarForce(0.9 * jnp.cos(7 * s), 0.5 * jnp.sin(5 * s))


def motion(t: Any) -> Motion:
    """A motion in space that differs at each instant."""
    s = t * 1e-7
    vectors = [jnp.array([0.3, -0.2, 0.1]) * jnp.sin(s + k) + 0.05 * k for k in range(6)]
    return Motion(t, *vectors)


def held_stick(t: Any) -> Sample:
    """A pilot's stick that moves, through all its modes, 10 ms of each."""
    s = t * 1e-7
    return new_sample(t, Stick(jnp.sin(30 * s), jnp.cos(40 * s), (t // ms(10) % len(STICK_MODES)).astype(np.int32)))


def vehicle_input(cls: type, t: Any) -> Any:
    """An input of a vehicle's input class."""
    return planar_force(t) if cls is PlanarForce else to_arrays(_of(cls)(t))


def _of(cls: type) -> Any:
    """A function of time that gives records of a class of numbers, e.g. a vehicle's state."""

    def field(t: Any, i: int, declared: Any) -> Any:
        shape = getattr(declared, "shape", ()) or np.shape(defaults.get(i))
        from_centre = getattr(declared, "frame", "") == "I" and declared.unit == "m"  # of the earth
        some = 0.1 * jnp.cos(t * 1e-7 + i + jnp.arange(math.prod(shape)).reshape(shape))
        if getattr(declared, "kind", "") == "flag":
            return some > 0
        return some + jnp.array([6.4e6, 0.0, 0.0]) if from_centre else some

    of_field = {f.name: None if f.default is MISSING else f.default for f in fields(cls)}
    defaults = {i: of_field[n] for i, n in enumerate(declarations(cls))}
    return lambda t: cls(**{n: field(t, i, d) for i, (n, d) in enumerate(declarations(cls).items())})


@functools.cache
def states() -> list[Any]:
    """Functions of time, one for each state that some vehicle or message has."""
    found = [typing.get_type_hints(cls.dynamics)["x"] for cls in vehicles()]
    sensors = sorted(blocks("sensors"), key=lambda cls: _feels(cls) != "state")
    told = [typing.get_type_hints(cls.measure)["return"] for cls in sensors]
    told = [cls for cls in told if dataclasses.is_dataclass(cls)]
    return [planar_state, peer_view, *(_of(cls) for cls in (*found, *told))]


def peer_view(t: Any) -> PeerView:
    """What one of three craft of a swarm knows: itself, and messages of the others that are a second old."""
    north, east = np.array([0.0, 3.0, -2.0]), np.array([0.0, 1.0, 2.5])
    stamps = jnp.full(3, t - ms(1000), np.int64)
    return PeerView(_of(PlanarPoseState)(t), Peers((stamps, north, east, 0.1 * np.ones(3), np.zeros(3))))


def vehicles() -> list[type]:
    """The records with dynamics; one that a host steps, an FMU, has none to look into (tests/vehicles/test_fmu.py)."""
    return [cls for cls in records("vehicles") if hasattr(cls, "dynamics") and "is_stepped" not in declarations(cls)]


def commands() -> list[Any]:
    """Functions of time, one for each kind of command that some allocation gives, and one for each vehicle's input."""
    found = []
    for cls in blocks("actuators"):
        one = made(cls)
        if not hasattr(one, "neutral"):
            found.append(lambda t, one=one: one.step(t, one.init(key(0)), planar_force(t))[1])
    inputs = dict.fromkeys(typing.get_type_hints(cls.dynamics)["u"] for cls in vehicles())
    return [planar_force, *found, *(_of(cls) for cls in inputs if dataclasses.is_dataclass(cls))]


@record
class Everything:
    """What all sensors and the actuators of a vehicle tell, in one. Source: this test."""

    angular_rate: Any = quantity("rad/s", "Rate.", shape=(3,))
    specific_force: Any = quantity("m/s^2", "Force per mass.", shape=(3,))
    gyro_saturated: Any = quantity("1", "Whether the gyro is at its limit.", kind="flag")
    accelerometer_saturated: Any = quantity("1", "Whether an accelerometer is at its limit.", kind="flag")
    heading: Any = quantity("rad", "Heading.", kind="angle")
    north: Any = quantity("m", "North.")
    east: Any = quantity("m", "East.")
    range: Any = quantity("m", "To four beacons.", shape=(4,))
    arrived: Any = quantity("1", "Which of them replied.", kind="flag", shape=(4,))
    unit: Any = quantity("1", "Which unit pinged.", kind="count")
    altitude: Any = quantity("m", "Altitude.")
    climb: Any = quantity("m/s", "Its rate.")
    speed: Any = quantity("m/s", "Along the path.")
    alpha: Any = quantity("rad", "Angle of attack.", kind="angle")
    pitch_rate: Any = quantity("rad/s", "Nose up.")
    pitch_acceleration: Any = quantity("rad/s^2", "Nose up.")
    Phi: Any = quantity("1", "Fuel ratio.")
    delta_e: Any = quantity("rad", "Elevator.", kind="angle")
    distance: Any = quantity("m", "Way driven.")
    turn: Any = quantity("rad", "Angle turned.", kind="angle")
    position: Any = quantity("m", "North, east, down.", shape=(3,))
    velocity: Any = quantity("m/s", "North, east, down.", shape=(3,))
    airspeed: Any = quantity("m/s", "Through the air.")
    beta: Any = quantity("rad", "Angle of sideslip.", kind="angle")


def everything(t: Any) -> Everything:
    """Measurements that differ at each instant."""
    s = t * 1e-7
    three = np.arange(3.0)
    felt = 0.3 * jnp.cos(s + three), 0.3 * jnp.sin(s + three), jnp.asarray(False), jnp.asarray(False)
    ranges = 3.4 + 0.01 * jnp.sin(s + np.arange(4.0)), jnp.asarray([True] * 4), jnp.int32(0)
    flight = 26e3 + jnp.sin(s), jnp.cos(s), 2350.0 + jnp.sin(s), 0.03 + 0.01 * jnp.sin(s)
    rest = (0.01 * jnp.cos(s + k) for k in range(4))
    driven = 0.8 * s, 0.2 * s
    fix = 0.3 * jnp.sin(s + three), 0.3 * jnp.cos(s + three)
    air = 150.0 + jnp.sin(s), 0.02 * jnp.cos(s)
    return Everything(*felt, *(0.3 * jnp.cos(s + k) for k in range(3)), *ranges, *flight, *rest, *driven, *fix, *air)


def _feels(cls: type) -> str:
    return getattr(cls, "FEELS", "motion")


def felt(one: Any) -> Any:
    """A function of time that gives what a sensor feels: a motion, or what its FEELS names."""
    feels = _feels(type(one))
    if feels == "motion":
        return motion
    if feels == "input":
        return planar_force
    state = typing.get_type_hints(type(one).measure)["x"]
    return planar_state if state is Any else _of(state)


@functools.cache
def sensed() -> list[Any]:
    """Functions of time, one for each kind of measurement that some sensor gives."""
    sensors = [made(cls) for cls in blocks("sensors")]
    return [planar_state, *(lambda t, one=one: one.measure(felt(one)(t)) for one in sensors), everything]


@functools.cache
def known() -> list[tuple[Any, set[str]]]:
    """Functions of time and the names of what they give: states, and measurements, which an estimator may pass on."""
    return [(f, set(declarations(jax.eval_shape(f, np.int64(0))))) for f in (*states(), *sensed())]


def example(folder: str, one: Any) -> Any:
    """A function of time that gives inputs for a block."""
    if folder == "sensors":
        return felt(one)
    if folder == "links":
        return lambda t: new_sample(t, planar_state(t))
    if folder == "laws":
        fits = [f for f, names in known() if set(one.reads) <= names]
        assert fits, f"{type(one).__name__} reads {one.reads}, which no state known here has"
        hand = held_stick if optional_member(one, "stick") else lambda t: None

        def estimate(t: Any, f: Any) -> Estimate:
            return Estimate(t=t, age=0.01, fresh=True, valid=True, state=f(t), stick=hand(t), dt=1e-3)

        state = jax.eval_shape(lambda: one.init(key(0)))
        chosen = next(f for f in fits if _is_taken(one, lambda t, f=f: estimate(t, f), state))
        return lambda t: estimate(t, chosen)

    def takes(wrap: Any, candidates: list[Any]) -> Any:
        state = jax.eval_shape(lambda: one.init(key(0)))

        def shaped(candidate: Any) -> Any:
            return lambda t: wrap(t, candidate(t))

        for candidate in candidates:
            if _is_taken(one, shaped(candidate), state):
                return shaped(candidate)
        raise AssertionError(f"{type(one).__name__}: no input that the contract tests know fits its step()")

    if folder == "estimators":
        return takes(lambda t, v: Frame(t, {name: new_sample(t, v) for name in one.listens}), sensed())
    if hasattr(one, "neutral"):
        return takes(new_sample, commands())
    wanted = [*typing.get_type_hints(type(one).step).values()][2]
    demands = [_of(wanted)] if dataclasses.is_dataclass(wanted) else []
    return takes(lambda t, v: v, [*demands, planar_force, *states()])


def _is_taken(one: Any, given: Any, state: Any) -> bool:
    """Whether a block's step works with these inputs. state: shapes of its first state."""
    try:
        jax.eval_shape(lambda t, state: one.step(t, state, given(t)), np.int64(0), state)
    except UNFIT:
        return False
    return True


def first_state(folder: str, one: Any, given: Any, run: Any) -> Any:
    """The state that a run starts from."""
    now = np.int64(0)
    state = one.init(key(run), given(now)) if folder == "links" else one.init(key(run))
    return strengthen_types(state)


def period(one: Any) -> int:
    """How often a block steps: its own period, or the autopilot's 1 ms."""
    return getattr(one, "period", ms(1))


def rollout(folder: str, one: Any, given: Any, run: Any, n: int, note: Any = None) -> tuple[Any, Any]:
    """Last state and all outputs of n steps, as the loop makes them: scanned, inputs numeric.

    Where note is given, tracing calls note(state, next state) for a step.
    """

    def body(state: Any, t: Any) -> Any:
        state_type = jax.tree.map(jnp.result_type, state)
        new, out = one.step(t, state, strengthen_types(given(t)))
        if note:
            note(state, new)
        return jax.tree.map(jnp.asarray, new, state_type), out

    instants = jnp.arange(n, dtype=np.int64) * period(one)
    return jax.lax.scan(body, first_state(folder, one, given, run), instants)

"""Every row of the hovercraft's study that holds fails on at least one perturbed model.

For each group the worlds in which its rows are computed again: a heavier vehicle, another fan, late or quiet sensors, a
law with another gain. A row that holds in all of them would say nothing.
"""

import dataclasses
import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from studies.hovercraft2006 import _flights, _rig
from trimtab.actuators.rudder import RudderGeometry
from trimtab.core.record import replace
from trimtab.loop.settings import with_settings
from trimtab.study import list_groups
from trimtab.vehicles.hovercraft import Friction

CACHED = (
    _flights.fly_real,
    _flights.fly_ideal,
    _flights.fly_random_starts,
    _rig.fly_rig,
    _rig.navigation_errors,
    _rig.two_unit_errors,
    _rig.network_errors,
)


@dataclasses.dataclass(frozen=True)
class Patch:
    """What stands at `name` of a module of the study becomes `change` of it."""

    module: str
    name: str
    change: Callable[[Any], Any]

    def apply(self, monkeypatch):
        module = importlib.import_module(self.module if "." in self.module else f"studies.hovercraft2006.{self.module}")
        monkeypatch.setattr(module, self.name, self.change(getattr(module, self.name)))


def craft(module, **changes):
    """The group's vehicle with fields times a factor, or friction."""
    factors = {name: value for name, value in changes.items() if not isinstance(value, Friction)}
    given = {name: value for name, value in changes.items() if isinstance(value, Friction)}
    return Patch(module, "CRAFT", lambda c: replace(c, **given, **{n: getattr(c, n) * f for n, f in factors.items()}))


def fresh_copy(module, name):
    """Return a copy of the function, so that its compiled version is not reused."""
    return Patch(module, name, lambda f: lambda *args: f(*args))


def flights(*modules, only="", **settings):
    """Change settings of every flight, or of flights with a word in their name; two underscores stand for a dot."""
    paths = {path.replace("__", "."): str(value) for path, value in settings.items()}

    def change(load):
        return lambda name, chosen=(): with_settings(load(name, chosen), paths if only in name else {})

    return [Patch(module, "load_scenario", change) for module in modules or ("_flights",)]


def unlimited():
    """Remove the limits of fan and rudder."""

    def change(load):
        return lambda name, chosen=(): load(name, chosen).without("saturation")

    return [Patch("_flights", "load_scenario", change)]


def rig(only="", **settings):
    """Change settings of the platform's flights."""
    paths = {path.replace("__", "."): str(value) for path, value in settings.items()}

    def change(load):
        return lambda name, chosen=(): with_settings(load(name, chosen), paths if only in name else {})

    return [Patch("_rig", "load_rig", change)]


def forced(**choices):
    """Choices of a scenario of the platform in place of those asked for."""

    def change(load):
        return lambda name, chosen=(): load(name, tuple({**dict(chosen), **choices}.items()))

    return [Patch("_rig", "load_rig", change)]


def scaled(module, name, gain=1.0, about=None):
    """Scale the result of a function, or its deviation from the mean, by `gain`."""

    def change(function):
        def call(*args, **kwargs):
            y = function(*args, **kwargs)
            return y * gain if about is None else np.mean(y) + gain * (y - np.mean(y))

        return call

    return [Patch(module, name, change)]


QUIET = {
    "world__sensors__navigation__accelerometer_bias": 0,
    "world__sensors__navigation__gyro_bias": 0,
    "world__sensors__navigation__gyro_noise": 0,
}
LATENCIES = {"heading": 0.098, "position": 0.2, "unit_a": 0.19, "unit_b": 0.19}
LATE = {f"world__sensors__{name}__timing__latency": value for name, value in LATENCIES.items()}
SHAPES = "trimtab.actuators.lookup"
READINGS = "trimtab.sensors.navigation_errors"

WORLDS: dict[str, dict[str, list[Patch]]] = {
    "control-laws": {
        "mass +10 %": [craft("control_laws", mass=1.1), *flights(world__vehicle__mass=2.86)],
        "inertia +10 %": [craft("control_laws", inertia=1.1)],
        "arm +10 %": [craft("control_laws", arm=1.1)],
        "friction in yaw": [craft("control_laws", friction=Friction(torque_viscous=0.05))],
    },
    "stabilisability": {
        "a torque of its own": [Patch("stabilisability", "INPUTS", lambda n: n + 1)],
        "arm +10 %": [craft("stabilisability", arm=1.1), fresh_copy("stabilisability", "_turning_dynamics")],
        "on a rail": [Patch("stabilisability", "_f2", lambda f: lambda x1, x2: f(x1, x2).at[2].set(0.0))],
    },
    "rudder-and-thrust": {
        "rudder ratio +10 %": [Patch("rudder_and_thrust", "GEOMETRY", lambda g: replace(g, ratio=1.1 * g.ratio))],
        "rudder ratio -10 %": [Patch("rudder_and_thrust", "GEOMETRY", lambda g: replace(g, ratio=0.9 * g.ratio))],
        "fan -40 %": [Patch("rudder_and_thrust", "FAN", lambda f: replace(f, coefficient=0.6 * f.coefficient))],
        "reverse +10 %": [Patch("rudder_and_thrust", "FAN", lambda f: replace(f, reverse_ratio=1.1 * f.reverse_ratio))],
        "coarser tables": [Patch(SHAPES, "FORCE_STEP", lambda step: 2 * step)],
        "another fan's table": [
            Patch(
                "rudder_and_thrust",
                "thrust_table",
                lambda table: lambda fan: table(replace(fan, coefficient=1.1 * fan.coefficient)),
            )
        ],
    },
    "inertia": {
        "arm +10 %": [craft("inertia", arm=1.1)],
        "inertia +10 %": [craft("inertia", inertia=1.1)],
        "rudder ratio +10 %": [Patch("inertia", "PSI", lambda _: RudderGeometry(ratio=1.54).force_angle)],
    },
    "radio-links": {
        "packets +10 %": scaled("radio_links", "_draw_latencies", 1.1),
        "packets spread less": scaled("radio_links", "_draw_latencies", 0.4, about="mean"),
        "a step more": flights("radio_links", world__downlink__steps=7),
    },
    "ultrasonic-cone": {
        "no error off the axis": scaled("ultrasonic_cone", "range_ratio", 0.999),
        "ranges as they come": [
            Patch("ultrasonic_cone", "compensate_range", lambda _: lambda ranges, height: (ranges, None, None))
        ],
        "angles +10 %": [
            Patch("ultrasonic_cone", "fit_range_ratio", lambda fit: lambda angle, ratio: fit(1.1 * angle, ratio))
        ],
        "noisier ranges": [Patch("ultrasonic_cone", "RangeErrors", lambda errors: lambda: errors(noise=0.008))],
    },
    "gyro-compensation": {
        "normalised": [Patch("gyro_compensation", "GyroCompensator", lambda c: lambda normalised: c(normalised=True))],
        "samples 10 % apart": [Patch("gyro_compensation", "TICK", lambda tick: round(1.1 * tick))],
        "a slower gyro": [Patch("gyro_compensation", "DelayedGyro", lambda gyro: lambda: gyro(bandwidth=15.0))],
    },
    "simulated-autopilot": {
        "mass +50 %": flights(world__vehicle__mass=3.9),
        "inertia +50 %": flights(world__vehicle__inertia=0.144),
        "quiet navigation": flights(**QUIET),
        "no limits": unlimited(),
        "links eight times as late": flights(world__downlink__steps=48, world__uplink__steps=16),
        "friction in yaw": flights(world__vehicle__friction__torque_viscous=0.055),
        "readings exchanged": [Patch(READINGS, "READINGS", lambda r: dict.fromkeys("ABC", r["C"]))],
    },
    "simulated-heading": {
        "inertia +50 %": flights(world__vehicle__inertia=0.144),
        "mass +50 %": flights(world__vehicle__mass=3.9),
        "quiet navigation": flights(**QUIET),
        "a hasty gain": flights(only="proportional", autopilot__law__k=4),
        "a turn half as fast": flights(only="bang-bang", autopilot__law__turn_rate=0.6),
        "a third of the turn, quietly": flights(autopilot__law__target=0.3, **QUIET),
        "a tolerance of 20 deg": flights(autopilot__law__tolerance=0.35),
        "a floor below the reference": flights(only="proportional", autopilot__law__form="floored"),
        "friction in yaw": flights(world__vehicle__friction__torque_viscous=0.055),
    },
    "hardware-flights": {
        "no friction": [Patch("hardware_flights", "FRICTION", lambda _: ())],
        "drag": [
            Patch("hardware_flights", "FRICTION", lambda f: (*f, ("world.vehicle.friction.force_viscous", "0.2")))
        ],
        "a lazy gain": flights(only="proportional", autopilot__law__k=0.3),
        "a bang-bang that lets the heading be": flights(only="bang-bang", autopilot__law__tolerance=0.35),
    },
    "heading-filter": {
        "later fixes": rig("cricket", **LATE),
        "a poorer compass": rig("magnetometer", world__sensors__heading__magnetometer__noise=0.05),
        "units closer": [Patch("_rig", "BASE", lambda base: 2 * base)],
    },
    "velocity-position-filter": {
        "upright": rig("encoder", world__vehicle__tilt=0),
        "later fixes": rig("cricket", **LATE),
    },
    "gyro-square-wave": {
        "never compensated": forced(compensated="no"),
        "a slower motor": rig(world__vehicle__time_constant=0.2),
    },
}
LONG = (
    "control-laws",
    "stabilisability",
    "simulated-autopilot",
    "simulated-heading",
    "hardware-flights",
    "heading-filter",
    "velocity-position-filter",
    "gyro-square-wave",
)
GROUPS = list_groups("hovercraft2006")
CASES = [pytest.param(g, id=g.name, marks=[pytest.mark.thorough] if g.name in LONG else []) for g in GROUPS]


def holding_rows(group):
    """Return the ids of the rows that hold with the current patches."""
    for function in CACHED:
        function.cache_clear()
    return {row.id for row in group.rows() if row.holds}


def test_every_group_has_perturbed_models():
    assert set(WORLDS) == {group.name for group in GROUPS}


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("group", CASES)
def test_every_row_fails_on_some_perturbed_model(group, monkeypatch):
    always = holding_rows(group)
    assert always
    for patches in WORLDS[group.name].values():
        with monkeypatch.context() as patch:
            for p in patches:
                p.apply(patch)
            always &= holding_rows(group)
    for function in CACHED:
        function.cache_clear()
    assert sorted(always) == []

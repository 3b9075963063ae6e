"""Identity of a scenario: the settings that must be equal on autopilot and vehicle before a flight, as text by path.

The identity does not contain law and supervisor, which only the autopilot uses; the links, which the real link
replaces; and faults, which only the vehicle uses.
Source: docs page, Fly.
"""

from typing import Any

from trimtab import __version__
from trimtab.core.record import Option, Quantity, leaves, replace
from trimtab.core.time import to_seconds
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.station.identity import format_value
from trimtab.links.wire import Wire
from trimtab.loop.faults import FaultyPart
from trimtab.loop.scenario import Scenario

SCENARIO = "scenario"


def scenario_identity(scenario: Scenario, dialect: Dialect) -> dict[str, str]:
    """Return the identity of a scenario. Vehicle and autopilot compute the same identity."""
    world = scenario.world
    sensors = {name: _without_fault(sensor) for name, sensor in world.sensors.items()}
    bare = replace(world, sensors=sensors, actuators=_without_fault(world.actuators), uplink=Wire(), downlink=Wire())
    numbers = {f"world.{path}": format_setting(value, declared) for path, value, declared in leaves(bare)}
    if scenario.failsafe is not None:
        numbers |= {f"failsafe.{path}": format_setting(v, d) for path, v, d in leaves(scenario.failsafe)}
    return numbers | {
        SCENARIO: scenario.name,
        "version": __version__,
        "messages": dialect.fingerprint.hex(),
        "autopilot.period": repr(to_seconds(scenario.autopilot.period)),
    }


def format_setting(value: Any, declared: Quantity | Option) -> str:
    """Return the value of a setting as text for `--set`: periods in seconds, integers without a decimal point."""
    if isinstance(declared, Option) and declared.kind == "period":
        return repr(float(to_seconds(value)))
    return str(value) if isinstance(declared, Option) and isinstance(value, int) else format_value(value)


def identity_path(path: str) -> str:
    """Return the path of a setting in the identity, from its path in a scenario in which every part has an inactive
    fault."""
    return path.replace(".inner.", ".")


def setting_path(path: str) -> str | None:
    """Return the path of a parameter's setting, from its path in a scenario with inactive faults, or None for a
    parameter of a fault."""
    return None if ".fault." in path else identity_path(path)


def _without_fault(part: Any) -> Any:
    while isinstance(part, FaultyPart):
        part = part.inner
    return part

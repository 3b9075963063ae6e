"""A scenario: one flyable combination, checked whole before anything runs."""

from typing import Any

from trimtab.actuators.direct import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.record import children, is_record, option, part, period, record, replace
from trimtab.core.time import seconds, to_seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.checks import check_part, check_values
from trimtab.loop.world import World
from trimtab.sensors.navigation_errors import PlanarNavigation


@record
class Scenario:
    """World, autopilot, first state and duration: all that a run needs.

    Source: docs page, Scenarios.
    """

    world: World = part("The vehicle and what surrounds it.")
    autopilot: Autopilot = part("What flies it.")
    initial: Any = part("First state of the vehicle.")
    duration: int = period("Length of a run.", default=seconds(15))
    targets: Any = part("Where signals should go, for the metrics.", default=())
    failsafe: Any = part("What the vehicle does when nobody commands it, in flight; none in a simulation.", default=())
    truth_sensor: Any = part("What the ideal twin measures instead of the sensors.", default=PlanarNavigation())
    name: str = option("Name in the catalogue.", default="scenario")
    choices: Any = part("How it was built from the catalogue, as `scenarios.build` notes it for logs.", default=())

    def ideal(self) -> "Scenario":
        """The twin without faults: the same law on the true state, no delay, no limits, its demand acts as it is."""
        neutral = self.world.actuators.neutral().u
        tick = self.autopilot.period
        world = replace(
            self.world,
            sensors={"truth": replace(self.truth_sensor, period=tick)},
            downlink=Wire(period=tick),
            uplink=Wire(period=tick),
            actuators=DirectActuation(neutral_input=neutral, period=tick),
        )
        autopilot = replace(
            self.autopilot, estimator=Passthrough("truth"), allocation=DirectAllocation(), supervisor=None
        )
        choices = {**self.choices, "ideal": True} if self.choices else ()
        return replace(self, world=world, autopilot=autopilot, choices=choices)

    def imperfections(self) -> dict[str, list[tuple[str, str]]]:
        """Name of each fault that can be switched off -> where it is: (path of the part, its own name for it)."""
        found: dict[str, list[tuple[str, str]]] = {}
        for path, owner in _parts(self):
            link = path.split(".")[1] if f"{path}.".startswith(("world.uplink.", "world.downlink.")) else ""
            for own in getattr(owner, "IMPERFECTIONS", ()):
                name = f"{link}-{own}" if link else own
                found.setdefault(name, []).append((path, own))
        return found

    def without(self, name: str) -> "Scenario":
        """The same scenario with one fault switched off, e.g. ``without("navigation-error")``."""
        known = self.imperfections()
        if name not in known:
            problem = f"there is no imperfection {name!r} to switch off"
            raise InputError(f"scenario {self.name!r}", problem, choices=known, fix="--without one of the choices")
        changed: Any = self
        for path, own in known[name]:
            changed = _with_part(changed, path.split("."), own)
        return changed

    def check(self) -> None:
        """Refuse values that cannot be flown; the walk refuses parts that don't fit each other."""
        check_values(self)
        for path, owner in _parts(self):
            covers = getattr(owner, "check_duration", None)
            if covers is not None:
                check_part(path, lambda covers=covers: covers(to_seconds(self.duration)))


def _parts(value: Any, path: str = "") -> list[tuple[str, Any]]:
    found = [(path, value)] if is_record(value) else []
    for name, child, declared in children(value):
        if declared is None or is_record(child) or children(child):
            found += _parts(child, f"{path}.{name}" if path else name)
    return found


def _with_part(value: Any, path: list[str], own: str) -> Any:
    if not path:
        return value.without(own)
    if isinstance(value, dict):
        return {n: _with_part(v, path[1:], own) if n == path[0] else v for n, v in value.items()}
    return replace(value, **{path[0]: _with_part(getattr(value, path[0]), path[1:], own)})

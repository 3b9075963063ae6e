"""A scenario: one flyable combination, checked whole before anything runs."""

from typing import Any

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections as find_imperfections
from trimtab.core.imperfections import without
from trimtab.core.interfaces import optional_member
from trimtab.core.quantity import records
from trimtab.core.record import option, part, period, record, replace
from trimtab.core.time import seconds, to_seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.beliefs import check_beliefs
from trimtab.loop.checks import check_part, check_values
from trimtab.loop.vehicle_limits import VehicleLimits
from trimtab.loop.world import World
from trimtab.sensors.navigation_errors import PlanarNavigation

LINKS = ("uplink", "downlink")


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
    limits: VehicleLimits = part("What the vehicle watches of itself, in flight.", default=VehicleLimits())
    truth_sensor: Any = part("What the ideal twin measures instead of the sensors.", default=PlanarNavigation())
    name: str = option("Name in the catalogue.", default="scenario")
    mismatch: Any = part("Paths of the autopilot's copies of the vehicle that are meant to differ.", default=())
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

    def imperfections(self) -> dict[str, list[str]]:
        """Name of each imperfection that can be switched off -> paths of the parts that have it.

        Those of a link bear its name, e.g. "uplink-delay".
        """
        names: dict[str, list[str]] = {}
        for own, paths in find_imperfections(self).items():
            for path in paths:
                link = next((name for name in LINKS if f"{path}.".startswith(f"world.{name}.")), "")
                names.setdefault(f"{link}-{own}" if link else own, []).append(path)
        return names

    def without(self, name: str) -> "Scenario":
        """The same scenario with one imperfection switched off, e.g. ``without("navigation-error")``."""
        known = self.imperfections()
        if name not in known:
            problem = f"there is no imperfection {name!r} to switch off"
            raise InputError(f"scenario {self.name!r}", problem, choices=known, fix="--without one of the choices")
        link = known[name][0].removeprefix("world.").partition(".")[0]
        if link in LINKS:
            channel = without(getattr(self.world, link), name.removeprefix(f"{link}-"))
            return replace(self, world=replace(self.world, **{link: channel}))
        links = {link: getattr(self.world, link) for link in LINKS}
        changed = without(replace(self, world=replace(self.world, **dict.fromkeys(LINKS, ()))), name)
        return replace(changed, world=replace(changed.world, **links))

    def check(self) -> None:
        """Refuse values that cannot be flown; the walk refuses parts that don't fit each other."""
        check_beliefs(self.autopilot, self.world.vehicle, self.mismatch)
        check_values(self)
        for path, owner in records(self):
            covers: Any = optional_member(owner, "check_duration")
            check_part(path, lambda covers=covers: covers(to_seconds(self.duration)))

"""Scenario: a complete control loop that can be simulated or flown. All values are checked before a run."""

import textwrap
from typing import TYPE_CHECKING, Any, Generic

import jax
import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError, argument, command
from trimtab.core.html_table import html_table
from trimtab.core.imperfections import imperfections as find_imperfections
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Actuators, Allocation, Channel, Estimator, Law, Sensor, optional_member
from trimtab.core.quantity import records
from trimtab.core.record import children, declarations, leaves, option, part, period, record, replace, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarState
from trimtab.core.suggestions import closest, missing_member
from trimtab.core.time import format_time, seconds, to_seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.checks import check_part, check_values
from trimtab.loop.model_mismatch import check_models
from trimtab.loop.structure import check_members, check_record
from trimtab.loop.summary import NOTE, summarise_scenario
from trimtab.loop.vehicle_limits import VehicleLimits
from trimtab.loop.walk import start
from trimtab.loop.world import World
from trimtab.sensors.flight_state import TrueState
from trimtab.sensors.navigation_errors import PlanarNavigation
from trimtab.sensors.planar_pose import PlanarPose, PlanarPoseState
from trimtab.vehicles.vehicle_type import mav_type

LINKS = ("uplink", "downlink")
LINE_WIDTH = 130
"""Maximum length of a text line in the printed summary of a scenario, in characters."""
if TYPE_CHECKING:  # default of a type parameter, which needs Python 3.13
    from typing_extensions import TypeVar

    V = TypeVar("V", default=Any)
else:
    from typing import TypeVar

    V = TypeVar("V")


@record
class Scenario(Generic[V]):
    """Scenario: everything that a run needs, i.e. world, autopilot, initial state and duration.

    >>> from trimtab import build
    >>> scenario = build("hovercraft/spin")
    >>> scenario.name, sorted(scenario.imperfections())[0]
    ('hovercraft/spin', 'braking')

    Source: docs page, Scenarios.
    """

    world: World[V] = part("World: vehicle, sensors, links and actuators.")
    autopilot: Autopilot = part("Autopilot: estimator, law and allocation.")
    initial: Any = part("Initial state of the vehicle.")
    duration: int = period("Duration of a run.", default=seconds(15))
    targets: Any = part("Target values of signals, used by the metrics.", default=())
    failsafe: Any = part(
        "Failsafe of the vehicle, used in a real flight only. Empty: the default failsafe for this vehicle.", default=()
    )
    limits: VehicleLimits = part("Limits that the vehicle checks on board in a real flight.", default=VehicleLimits())
    truth_sensor: Any = part(
        "Sensor of the true state. The ideal twin of the scenario uses this sensor instead of the scenario's sensors.",
        default=PlanarNavigation(),
    )
    name: str = option("Name of the scenario in the catalogue.", default="scenario")
    mismatch: Any = part("Paths of the vehicle models in the autopilot that may differ from each other.", default=())
    words: Any = part(
        "Number that selects the random numbers of each group of noise sources. Empty: the run number is used for all "
        "groups.",
        default=(),
    )
    choices: Any = part(
        "Arguments of `scenarios.build` from which the scenario was built. They are recorded in logs.", default=()
    )

    def __post_init__(self) -> None:
        several: Any = self.targets if isinstance(self.targets, tuple | list) else (self.targets,)
        if several is not self.targets or any(not hasattr(target, "band") for target in several):
            fix = 'write targets=(Target("truth.NAME", 1.0, band=0.1),), with a comma before the last bracket'
            raise InputError("Scenario.targets", f"must be a tuple of Target, got {self.targets!r:.80}", fix=fix)

    def __repr__(self) -> str:
        rows = summarise_scenario(self)
        wide = max(len(what) for what, _ in rows)
        width = min(100, LINE_WIDTH - wide - 4)
        rows = [(what, textwrap.shorten(text, width, placeholder=" …")) for what, text in rows]
        lines = [f"Scenario {self.name}, {format_time(self.duration)}"]
        return "\n".join([*lines, *(f"  {what:<{wide}}  {text}" for what, text in rows), NOTE])

    def __getattr__(self, name: str) -> Any:
        raise missing_member(self, name, "" if name in declarations(self) else _other_spelling(self, name))

    def _repr_html_(self) -> str:
        return html_table(f"{self.name}, {format_time(self.duration)}", (), summarise_scenario(self), NOTE)

    def ideal(self) -> "Scenario":
        """Return the ideal twin of the scenario, i.e. the scenario without imperfections.

        The law reads the true state, and its demand acts directly on the vehicle, without delay and limits. If the
        demand and the vehicle's input are records of different classes, allocation and actuators are kept, but without
        imperfections. If the default truth sensor lacks fields that the law reads, the law reads the vehicle's state or
        a planar pose, whichever has these fields. A pilot's stick and an observer are not changed.

        Raises: InputError if the truth sensor does not measure a signal that the law reads.
        """
        neutral = self.world.actuators.neutral().u
        tick = self.autopilot.period
        is_direct = _have_one_structure(self._demand_structure(), neutral)
        actuators = DirectActuation(neutral_input=neutral, period=tick)
        stick = optional_member(self.autopilot.law, "stick")
        sensors = self.world.sensors.items()
        kept = {n: s for n, s in sensors if n == stick or optional_member(s, "OBSERVES")}
        world = replace(
            self.world,
            sensors={"truth": replace(self._twin_sensor(), period=tick), **kept},
            downlink=Wire(period=tick),
            uplink=Wire(period=tick),
            actuators=actuators if is_direct else self._without_its_own(self.world.actuators),
        )
        allocation = DirectAllocation() if is_direct else self._without_its_own(self.autopilot.allocation)
        autopilot = replace(
            self.autopilot,
            estimator=Passthrough("truth"),
            allocation=allocation,
            supervisor=None,
            predictor=None,
            monitor=None,
        )
        choices = {**self.choices, "ideal": True} if self.choices else ()
        twin = replace(self, world=world, autopilot=autopilot, choices=choices)
        twin._check_truth_sensor()
        return twin

    def _check_truth_sensor(self) -> None:
        """Raise InputError if the truth sensor of this ideal twin does not measure a signal that the law reads."""
        try:
            self._demand_structure()
        except InputError as error:
            if error.part != "autopilot.law":
                raise
            law, sensor = (type(part).__name__ for part in (self.autopilot.law, self.world.sensors["truth"]))
            lacking = " and ".join(repr(name) for name in self.autopilot.law.reads if name not in error.choices)
            problem = f"in the ideal twin, {law} reads {lacking}, which the sensor {sensor} does not measure"
            sensor_fix = "write Scenario(…, truth_sensor=…) with a sensor that measures this without error"
            without_twin = command("trimtab run SCENARIO --no-ideal", "simulate(scenario)")
            fix = f"{sensor_fix}, or fly without the ideal twin: {without_twin}"
            raise InputError("truth_sensor", problem, choices=error.choices, fix=fix) from None

    def _without_its_own(self, one: Any) -> Any:
        """Return a part without its imperfections.

        The imperfections of a vehicle model in the part are kept, because the true vehicle has them too.
        """
        for name in find_imperfections(one).keys() - find_imperfections(self.world.vehicle).keys():
            one = without(one, name)
        return one

    def _demand_structure(self) -> Any:
        """Return the structure (shapes and data types) of the law's demand, without computing a demand."""
        key = Key(np.uint32(0), np.uint32(0))
        free = to_arrays(replace(self.autopilot, supervisor=None))
        _, state = jax.eval_shape(lambda: start(to_arrays(self.world), free, to_arrays(self.initial), key))
        return state.output.demand

    def _twin_sensor(self) -> Any:
        """Return the truth sensor or, if the default lacks fields that the law reads, a sensor that measures them."""
        needed = set(self.autopilot.law.reads)
        if not isinstance(self.truth_sensor, PlanarNavigation) or needed <= set(declarations(PlanarState)):
            return self.truth_sensor
        if needed <= {name for name, _, _ in children(self.initial)}:
            return TrueState()
        return PlanarPose() if needed <= set(declarations(PlanarPoseState)) else self.truth_sensor

    def imperfections(self) -> dict[str, list[str]]:
        """Return the imperfections that can be switched off: name -> paths of the parts with this imperfection.

        The imperfection of a link has a name that starts with the link's name, e.g. "uplink-delay".
        """
        names: dict[str, list[str]] = {}
        for own, paths in find_imperfections(self).items():
            for path in paths:
                link = next((name for name in LINKS if f"{path}.".startswith(f"world.{name}.")), "")
                names.setdefault(f"{link}-{own}" if link else own, []).append(path)
        return names

    def without(self, name: str) -> "Scenario":
        """Return the scenario with one imperfection switched off, e.g. ``without("navigation-error")``."""
        known = self.imperfections()
        if name not in known:
            problem = f"has no imperfection {name!r} that can be switched off"
            near = closest(name, known, 1) or [*known, "NAME"]
            raise InputError(f"scenario {self.name!r}", problem, choices=known, fix=argument("without", [near[0]]))
        link = known[name][0].removeprefix("world.").partition(".")[0]
        if link in LINKS:
            channel = without(getattr(self.world, link), name.removeprefix(f"{link}-"))
            autopilot = self.autopilot
            if name in find_imperfections(autopilot):  # in the predictor's model of the link
                autopilot = without(autopilot, name)
            return replace(self, world=replace(self.world, **{link: channel}), autopilot=autopilot)
        links = {link: getattr(self.world, link) for link in LINKS}
        changed = without(replace(self, world=replace(self.world, **dict.fromkeys(LINKS, ()))), name)
        return replace(changed, world=replace(changed.world, **links))

    def check(self) -> None:
        """Raise InputError for an invalid value, with which the scenario cannot run.

        This method does not check that the parts fit each other. `loop.walk.start` checks that.
        """
        self._check_interfaces()
        mav_type(self.world.vehicle)
        check_models(self.autopilot, self.world.vehicle, self.mismatch)
        check_values(self)
        for path, owner in records(self):
            covers: Any = optional_member(owner, "check_duration")
            check_part(path, lambda covers=covers: covers(to_seconds(self.duration)))

    def _check_interfaces(self) -> None:
        """Raise InputError for a part that lacks a method or field that the loop needs."""
        world, autopilot = self.world, self.autopilot
        check_record("world.vehicle", world.vehicle)
        if self.initial is not None:
            check_record("initial", self.initial)
        for name, sensor in world.sensors.items():
            check_members(f"world.sensors.{name}", sensor, Sensor, ("measure",))
        for name in LINKS:
            check_members(f"world.{name}", getattr(world, name), Channel)
        check_members("world.actuators", world.actuators, Actuators)
        for name, interface in (("estimator", Estimator), ("law", Law), ("allocation", Allocation)):
            check_members(f"autopilot.{name}", getattr(autopilot, name), interface)


def _other_spelling(scenario: Scenario, name: str) -> str:
    """Return what to write instead of an attribute that a scenario does not have.

    This is a function of the package or the path of a field with this name, or "" if nothing is found.
    """
    calls = {
        "plot": "plot_run(simulate(scenario))",
        "replace": "replace(scenario, …)",
        "settings": "settings(scenario)",
    }
    calls |= dict.fromkeys(("run", "simulate", "fly"), "simulate(scenario)")
    if name in calls or name.startswith("_"):
        return calls.get(name, "")
    paths = [f"{part}.{own}" for part in ("world", "autopilot") for own in declarations(getattr(scenario, part))]
    paths += [path for path, _, _ in leaves(scenario)]
    return next((f"scenario.{path}" for path in paths if path.endswith(f".{name}")), "")


def _have_one_structure(a: Any, b: Any) -> bool:
    """Return True if two trees of records have the same classes of records and the same shapes of numbers."""
    shapes = [[np.shape(v) for v in jax.tree.leaves(tree)] for tree in (a, b)]
    return jax.tree.structure(a) == jax.tree.structure(b) and shapes[0] == shapes[1]

"""Linearisation of a scenario's complete loop about the loop's equilibrium, with all parts sampled as in flight.

The step of the loop, without noise, is differentiated at each instant of the period T, the common multiple of the
periods of all parts. No part is replaced by a simplified model. In the resulting map (`design.loop_map`), z contains
all real numbers of the loop's state, including samples in transit. c is the command that the autopilot issues. v is the
command that enters the uplink.

Source: docs page, Time, for the order of computation.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.imperfections import imperfections, without, without_any
from trimtab.core.interfaces import optional_member
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import format_time, seconds, to_seconds
from trimtab.design.loop_map import LoopMap
from trimtab.links.fifo import required_slots
from trimtab.loop.scenario import Scenario
from trimtab.run.loop_rest import SETTLE_MAX, SETTLE_TIMES, find_rest, side_name
from trimtab.run.loop_step import LoopStep

MOST_INSTANTS = 4000
"""Maximum number of instants in the common multiple of the periods of all parts of the loop."""
RANDOM = ("jitter", "loss")
"""Random imperfections of radio links, which are switched off for the linearisation."""
STEPWISE = ("speed-steps",)
"""Imperfections of actuators that are step functions. They are switched off for the linearisation, because a step has
no derivative."""
FINE = 1e-12
"""Tolerance of an integration with variable steps. Its errors must be small compared with the displacements from rest
at which corners are searched."""


def linearise_loop(
    scenario: Scenario,
    *,
    x: Any = None,
    direct: bool = False,
    off: Iterable[str] = (),
    settle: float | None = None,
    round_time: float | None = None,
) -> LoopMap:
    """Return the linear map of a loop about its equilibrium, or about a closed path that the vehicle flies.

    Random effects are switched off. Supervisor and monitor are left out.

    Args:
        scenario: scenario whose loop comes to rest. It must not have a predictor.
        x: initial state of the vehicle. Default: the law's equilibrium, or else the scenario's initial state.
        direct: True if the law's demand acts directly, without allocation and actuators.
        off: further imperfections to switch off, see `Scenario.imperfections`.
        settle: flight time before the linearisation (s), in which the loop comes to rest, at most SETTLE_MAX. Default:
            SETTLE_TIMES, one after the other, until the loop is at rest.
        round_time: time of one lap of the closed path that the law follows (s). If given, the map covers one lap.

    Raises: InputError if the common multiple of the periods is too long, if the loop does not come to rest, or if its
    slopes at rest differ on both sides.
    """
    if settle is not None and not 0 <= settle <= SETTLE_MAX:
        problem = f"must be between 0 and {SETTLE_MAX:g} s, got {settle:g} s"
        raise InputError(argument_name("settle"), problem, fix=argument("settle", int(SETTLE_TIMES[1])))
    loop = _prepare_loop(scenario, direct, tuple(off))
    tick, count, slowest = _find_period(loop)
    if round_time is not None:
        count = _count_round(tick, count, round_time)
    rest = optional_member(loop.autopilot.law, "equilibrium")
    first = x if x is not None else rest() if rest is not None else loop.initial
    first = _fit_state(first, loop.initial)
    run = LoopStep(loop, tick)
    times = SETTLE_TIMES if settle is None else (settle,)
    s, a, _, idle, (A, B, C) = find_rest(run, *run.start(first), count, times)
    names = tuple(side_name(n) for n in run.coordinates((s, a)).names((s, a)))
    commands = tuple(n.removeprefix("a.command.value.") for n in names if n.startswith("a.command.value"))
    found = LoopMap(A, B, C, to_seconds(tick), names, commands, idle, to_seconds(slowest))
    if np.array_equal(found.transition(), found.transition(gain=0.0)):
        problem = "commands have no effect on the loop at rest, e.g. because of a dead zone, an end stop or zero thrust"
        raise InputError(
            "linearise",
            problem,
            fix=f"leave out the actuators with {argument_name('direct')}, or imperfections with "
            f"{argument_name('without')}",
        )
    return found


def _prepare_loop(scenario: Scenario, direct: bool, off: tuple[str, ...]) -> Scenario:
    if scenario.autopilot.predictor is not None:
        raise InputError(
            "linearise",
            "the loop must not have a predictor",
            fix=f"switch it off:  {argument('settings', 'off', 'predictor')}",
        )
    for name in off:
        scenario = scenario.without(name)
    world, autopilot = scenario.world, scenario.autopilot
    links = {n: _without_chance(getattr(world, n)) for n in ("uplink", "downlink")}
    world = replace(world, sensors={n: without_any(own) for n, own in world.sensors.items()}, **links)
    for name in STEPWISE:
        if name in imperfections(world.actuators):
            world = replace(world, actuators=without(world.actuators, name))
    if (fine := world.integration) is not None:
        tolerances = {name: np.minimum(getattr(fine, name), FINE) for name in ("relative", "absolute")}
        world = replace(world, integration=replace(fine, **tolerances))
    autopilot = replace(autopilot, supervisor=None, monitor=None)
    if direct:
        neutral = world.actuators.neutral().u
        period = world.actuators.period
        world = replace(world, actuators=DirectActuation(neutral_input=neutral, period=period))
        autopilot = replace(autopilot, allocation=DirectAllocation())
    return replace(scenario, world=to_arrays(world), autopilot=to_arrays(autopilot))


def _without_chance(link: Any) -> Any:
    for name in RANDOM:
        if name in imperfections(link):
            link = without(link, name)
    if hasattr(link, "capacity") and hasattr(
        link, "latency"
    ):  # the shortest buffer, because each slot is a state of the map
        needed = required_slots(float(np.max(link.latency)), link.send_period, link.period)
        link = replace(link, capacity=needed)
    return link


def _fit_state(x: Any, like: Any) -> Any:
    """Return a state with the fields of `like`. Fields that x also has are set to the values in x."""
    changes = {n: getattr(x, n) for n in like.__dataclass_fields__ if hasattr(x, n)}
    return to_arrays(replace(like, **changes))


def _find_period(loop: Scenario) -> tuple[int, int, int]:
    """Return the time step, the number of steps in the loop's period, and the longest period of a part.

    The loop's period is the common multiple of the periods of its parts. All times are in 100 ns.
    """
    world = loop.world
    own = [*world.periods(), loop.autopilot.period, optional_member(world.actuators, "frame")]
    own += [optional_member(getattr(world, n), "send_period") for n in ("uplink", "downlink")]
    periods = [p for p in own if p]
    tick = math.gcd(*periods)
    tick = (
        tick // -(-tick // world.max_step) if tick % -(-tick // world.max_step) == 0 else math.gcd(tick, world.max_step)
    )
    count = math.lcm(*periods) // tick
    if count > MOST_INSTANTS:
        text = ", ".join(sorted({format_time(p) for p in periods}))
        problem = f"the common multiple of the loop's periods, {text}, is too long: it contains {count} instants"
        raise InputError("linearise", problem, fix="set periods of sensors and links that are multiples of one another")
    return tick, count, max(periods)


def _count_round(tick: int, count: int, round_time: float) -> int:
    """Return the number of instants in one lap of a closed path.

    Raise InputError if a lap is not a whole number of periods of the loop.
    """
    rounds = round(seconds(round_time) / (tick * count)) if math.isfinite(round_time) else 0
    if rounds < 1 or rounds * tick * count != seconds(round_time):
        problem = f"must be a multiple of the loop's period of {to_seconds(tick * count):g} s, got {round_time:g} s"
        raise InputError(argument_name("round"), problem, fix="use the time of several laps that is such a multiple")
    if rounds * count > MOST_INSTANTS:
        problem = f"{round_time:g} s are {rounds * count} instants, but must be at most {MOST_INSTANTS} instants"
        raise InputError(
            argument_name("round"), problem, fix="fly a shorter path, or choose a longer period of the loop"
        )
    return rounds * count

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

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.imperfections import imperfections, without, without_any
from trimtab.core.interfaces import optional_member
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace, to_arrays
from trimtab.core.rng import Key
from trimtab.core.time import Instant, format_time, seconds, to_seconds
from trimtab.design.loop_map import STABLE, LoopMap
from trimtab.links.fifo import Fifo, required_slots
from trimtab.links.wire import DelayLine
from trimtab.loop.scenario import Scenario
from trimtab.loop.structure import cast_like, step_if
from trimtab.loop.walk import start
from trimtab.run.loop_coordinates import LoopCoordinates, is_real
from trimtab.run.loop_corners import find_loop_corner

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
REST = 1e-7
"""Tolerance for a loop at rest: largest change of a state over one period of the loop, relative to max(1, |state|)."""


def linearise_loop(
    scenario: Scenario,
    *,
    x: Any = None,
    direct: bool = False,
    off: Iterable[str] = (),
    settle: float = 10.0,
    round_time: float | None = None,
) -> LoopMap:
    """Return the linear map of a loop about its equilibrium, or about a closed path that the vehicle flies.

    Random effects are switched off. Supervisor and monitor are left out.

    Args:
        scenario: scenario whose loop comes to rest. It must not have a predictor.
        x: initial state of the vehicle. Default: the law's equilibrium, or else the scenario's initial state.
        direct: True if the law's demand acts directly, without allocation and actuators.
        off: further imperfections to switch off, see `Scenario.imperfections`.
        settle: flight time before the linearisation (s), in which the loop comes to rest.
        round_time: time of one lap of the closed path that the law follows (s). If given, the map covers one lap.

    Raises: InputError if the common multiple of the periods is too long, if the loop does not come to rest, or if its
    slopes at rest differ on both sides.
    """
    loop = _prepare_loop(scenario, direct, tuple(off))
    tick, count, slowest = _find_period(loop)
    if round_time is not None:
        count = _count_round(tick, count, round_time)
    rest = optional_member(loop.autopilot.law, "equilibrium")
    first = x if x is not None else rest() if rest is not None else loop.initial
    first = _fit_state(first, loop.initial)
    run = _Tick(loop, tick)
    s, a = run.start(first)
    t = 0
    s, a, t = run.fly(s, a, t, count * max(1, round(seconds(settle) / (tick * count))))
    s, a, t, idle, matrices = _find_rest(run, s, a, t, count)
    A, B, C = matrices
    names = tuple(_side_name(n) for n in run.coordinates((s, a)).names((s, a)))
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
        tolerances = {name: jnp.minimum(getattr(fine, name), FINE) for name in ("relative", "absolute")}
        world = replace(world, integration=replace(fine, **tolerances))
    autopilot = replace(autopilot, supervisor=None, monitor=None)
    if direct:
        neutral = world.actuators.neutral().u
        period = world.actuators.period
        world = replace(world, actuators=DirectActuation(neutral_input=neutral, period=period))
        autopilot = replace(autopilot, allocation=DirectAllocation())
    return replace(scenario, world=world, autopilot=autopilot)


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


class _Tick:
    """Step of a loop by one instant, and the derivatives of this step.

    The report of the integration is not a state of the loop: each instant begins with the first report.
    """

    def __init__(self, loop: Scenario, tick: int) -> None:
        self.loop, self.tick = loop, tick
        self._report: Any = ()
        self._fly: Any = jax.jit(self._many, static_argnums=3, compiler_options=FAST_COMPILE_OPTIONS)
        self._slopes: Any = jax.jit(self._differentiate, static_argnums=3, compiler_options=FAST_COMPILE_OPTIONS)

    def coordinates(self, like: tuple[Any, Any]) -> LoopCoordinates:
        """Return the coordinates for states of world and autopilot. like: example of these states."""
        return LoopCoordinates(like)

    def start(self, x: Any) -> tuple[Any, Any]:
        """Return the initial states of world and autopilot. x: initial state of the vehicle."""
        s, a = start(self.loop.world, self.loop.autopilot, x, Key(np.uint32(0), np.uint32(0)))
        self._report = s.integrated
        return replace(s, integrated=()), a

    def fly(self, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, int]:
        """Return the states of world and autopilot, and the time (100 ns), after `count` instants."""
        s, a = self._fly(s, a, np.int64(t), count)
        return s, a, t + count * self.tick

    def slopes(self, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, Any, Any, Any]:
        """Return the states of world and autopilot after `count` instants, and the matrices A_j, B_j, C_j of instants
        j."""
        (s, a), (A, B, C) = self._slopes(s, a, np.int64(t), count)
        return s, a, np.array(A), np.array(B), np.array(C)

    def align(self, s: Any, a: Any, span: int) -> tuple[Any, Any]:
        """Return the states with the ring buffers of the links rotated back by a time `span` (100 ns).

        The slot in which a sample is stored depends on the time. Therefore the states of different periods can be
        compared only after this rotation.
        """
        world = self.loop.world
        down = {n: _roll_ring(world.downlink, own, span) for n, own in s.downlink.items()}
        return replace(s, downlink=down, uplink=_roll_ring(world.uplink, s.uplink, span)), a

    def _step(self, s: Any, a: Any, t: Any, v: Any = None) -> tuple[Any, Any, Any]:
        """Return the states after one instant, and the command that the autopilot issues.

        v: command (m,) that is sent instead of the issued command, or None.
        """
        world, autopilot, clock = self.loop.world, self.loop.autopilot, Instant(t)
        seen, frame = world.sense(clock, s)
        due = clock.due(autopilot.period)
        new = step_if(due, lambda: autopilot.step(t, a, frame)[0], lambda: autopilot.hold(t, a))
        c = _vector(new.command.value)
        command = new.command if v is None else replace(new.command, value=_like_vector(new.command.value, v))
        acted = replace(world.act(clock, seen, command, due), integrated=self._report)
        acted = replace(world.advance(t, acted, np.int64(self.tick)), integrated=())
        return cast_like(acted, s), cast_like(new, a), c

    def _many(self, s: Any, a: Any, t: Any, count: int) -> tuple[Any, Any]:
        def body(carry: Any, j: Any) -> tuple[Any, None]:
            s, a = carry
            return self._step(s, a, t + j * self.tick)[:2], None

        return jax.lax.scan(body, (s, a), jnp.arange(count))[0]

    def _differentiate(self, s: Any, a: Any, t: Any, count: int) -> Any:
        own = self.coordinates((s, a))
        zero = jnp.zeros(len(own.names((s, a))))

        def body(carry: Any, j: Any) -> tuple[Any, Any]:
            s, a = carry
            now = t + j * self.tick
            s1, a1, c = self._step(s, a, now)

            def issue(z: Any) -> Any:
                return self._step(*own.displace((s, a), z), now)[2]

            def go(z: Any, v: Any) -> Any:
                return own.deviation((s1, a1), self._step(*own.displace((s, a), z), now, v)[:2])

            A, B = jax.jacfwd(go, argnums=(0, 1))(zero, c)
            return (s1, a1), (A, B, jax.jacfwd(issue)(zero))

        return jax.lax.scan(body, (s, a), jnp.arange(count))


def _find_rest(run: _Tick, s: Any, a: Any, t: int, count: int) -> tuple[Any, Any, int, Any, Any]:
    """Return the states of the loop at rest, found by Newton's method, and the matrices at these states.

    A loop at rest is periodic: after one period, all states are unchanged, except clocks and states on which no command
    depends.
    """
    span, first, worst, own = count * run.tick, math.inf, "", run.coordinates((s, a))
    names = own.names((s, a))
    for _ in range(8):
        s1, a1, A, B, C = run.slopes(s, a, t, count)
        order = own.flatten(run.align(*own.place_indices((s, a)), span))
        A[-1], B[-1] = A[-1][order], B[-1][order]
        if not all(np.isfinite(M).all() for M in (A, B, C)):
            fix = f"leave out actuators with {argument('direct', True)}, or e.g. {argument('off', ['dead zone'])}"
            raise InputError("linearise", "the loop is not differentiable at rest", fix=fix)
        whole = np.eye(len(A[0]))
        for Aj, Bj, Cj in zip(A, B, C, strict=True):
            whole = Aj @ whole + Bj @ (Cj @ whole)
        change = np.asarray(own.deviation((s, a), run.align(s1, a1, span)))
        idle = _idle_states(A, C, whole) | _clocks(A, B, change)
        keep = ~idle
        change = np.where(keep, change, 0.0)
        relative = np.abs(change / np.maximum(1.0, own.sizes((s, a))))
        off, worst = float(relative.max(initial=0.0)), worst or names[int(relative.argmax())]
        first = off if math.isinf(first) else first
        if off <= REST:
            _refuse_corner(run, own, s, a, t, count, whole, keep)
            return s, a, t, idle, (A, B, C)
        M = whole[np.ix_(keep, keep)]
        new = np.zeros(len(keep))
        new[keep] = np.linalg.lstsq(np.eye(len(M)) - M, change[keep], rcond=1e-12)[0]
        s, a = own.displace((s, a), jnp.asarray(new))
        s, a, t = run.fly(s, a, t, count)
    problem = f"the loop does not come to rest: in {to_seconds(span):g} s, {_side_name(worst)} changes by {first:.3g}"
    name = run.loop.name or "SCENARIO"
    fix = f"set a constant reference (trimtab list {name}), or set the time of one lap of a closed path: "
    fix += argument("round", 5)
    raise InputError("linearise", problem, fix=fix)


def _refuse_corner(run: _Tick, own: LoopCoordinates, s: Any, a: Any, t: int, count: int, whole: Any, keep: Any) -> None:
    """Raise InputError if the loop has different slopes on both sides of rest."""

    def end(z: Any) -> Any:
        s1, a1, _ = run.fly(*own.displace((s, a), jnp.asarray(z)), t, count)
        return np.asarray(own.deviation((s, a), run.align(s1, a1, count * run.tick)))

    rest = end(np.zeros(len(keep)))
    names = [_side_name(name) for name in own.names((s, a))]
    size = np.maximum(1.0, np.asarray(own.sizes((s, a))))
    corner = find_loop_corner(lambda z: end(z) - rest, whole, size, keep, names)
    if corner is not None:
        fix = f"leave out actuators with {argument('direct', True)}, or e.g. {argument('off', ['dead zone'])}"
        raise InputError("linearise", f"the loop has no slope at rest: {corner}", fix=fix)


def _clocks(A: Any, B: Any, change: Any) -> Any:
    """Return a mask (n,) of clocks, i.e. states that grow independently of all other states, e.g. the time in a law.

    A loop can be at rest although its clocks advance.
    """
    alone = (np.array([np.eye(len(change))] * len(A)) == A).all(axis=(0, 2)) & (B == 0).all(axis=(0, 2))
    return alone & (np.abs(change) > 0)


def _count_round(tick: int, count: int, round_time: float) -> int:
    """Return the number of instants in one lap of a closed path.

    Raise InputError if a lap is not a whole number of periods of the loop.
    """
    rounds = round(seconds(round_time) / (tick * count))
    if rounds < 1 or rounds * tick * count != seconds(round_time):
        problem = f"must be a multiple of the loop's period of {to_seconds(tick * count):g} s, got {round_time:g} s"
        raise InputError(argument_name("round"), problem, fix="use the time of several laps that is such a multiple")
    if rounds * count > MOST_INSTANTS:
        problem = f"{round_time:g} s are {rounds * count} instants, but must be at most {MOST_INSTANTS} instants"
        raise InputError(
            argument_name("round"), problem, fix="fly a shorter path, or choose a longer period of the loop"
        )
    return rounds * count


def _side_name(name: str) -> str:
    """Return the path of a state, which begins with "s" for a state of the world and "a" for one of the autopilot."""
    return f"{'sa'[int(name[0])]}{name[1:]}"


def _idle_states(A: Any, C: Any, whole: Any) -> Any:
    """Return a mask (n,) of states on which no command depends, e.g. the position.

    If one of these states is unstable, all elements of the mask are False, so that the instability is not hidden.
    """
    matters = np.abs(C).max(axis=(0, 1)) > 0
    feeds = np.abs(A).max(axis=0) > 0
    while (more := matters | feeds[matters].any(axis=0)).sum() > matters.sum():
        matters = more
    idle = ~matters
    grows = np.abs(np.linalg.eigvals(whole[np.ix_(idle, idle)])).max(initial=0.0) > 1 + STABLE
    return np.zeros_like(idle) if grows else idle


def _roll_ring(link: Any, state: Any, span: int) -> Any:
    if isinstance(state, Fifo):
        slots = span // (optional_member(link, "send_period") or link.period)
        ring = ("values", "measured", "due", "serial")
    elif isinstance(state, DelayLine):
        slots, ring = span // link.period, ("values", "measured")
    else:
        return state
    rolled = {n: jax.tree.map(lambda v: jnp.roll(v, -slots, axis=0), getattr(state, n)) for n in ring}
    return replace(state, **rolled)


def _vector(tree: Any) -> Any:
    return jnp.concatenate([jnp.ravel(v) for v in jax.tree.leaves(tree) if is_real(v)])


def _like_vector(tree: Any, v: Any) -> Any:
    values, structure = jax.tree.flatten(tree)
    new, begin = [], 0
    for own in values:
        size = int(np.size(own))
        new.append(v[begin : begin + size].reshape(np.shape(own)) if is_real(own) else own)
        begin += size if is_real(own) else 0
    return jax.tree.unflatten(structure, new)

"""Predictor: the estimate carried over the delay of both links, in front of any law. An optional part of the Autopilot.

Source: docs page, Predictor.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError, argument_name
from trimtab.core.integrate import rk4
from trimtab.core.interfaces import optional_member
from trimtab.core.record import (
    Scalar,
    children,
    declarations,
    is_record,
    part,
    period,
    quantity,
    record,
    replace,
    tree_where,
)
from trimtab.core.rng import Key
from trimtab.core.rotation import wrap
from trimtab.core.signals import Command, Estimate, Sample
from trimtab.core.time import NEVER, UNITS_PER_SECOND, format_time, ms, to_seconds
from trimtab.links.fifo import empty_slots, read_slot, write_slot
from trimtab.links.latency import MeasuredLatency, mean_latency
from trimtab.links.latency_trace import LatencyTrace, mean_received_latency
from trimtab.links.wire import DelayChain, Wire
from trimtab.loop.beliefs import vehicle_copies
from trimtab.loop.structure import cast_like, strengthen_types, zeros_of

TICK = ms(10)
"""About as often as believed actuators act: a brake of 150 ms ends at a multiple of it."""


@record
class Prediction:
    """What the predictor says. Frames: those of the vehicle's state. Source: docs page, Predictor."""

    state: Any = part(
        "The vehicle's state when the command made now will act; fields that no estimate gives mean nothing."
    )
    valid: Scalar = quantity("1", "Whether it was made from a valid estimate.", kind="flag")
    horizon: Scalar = quantity("s", "Time over which it was predicted: from the measurement on.")
    limited: Scalar = quantity("1", "The command will act later than the longest horizon reaches.", kind="flag")
    innovation: Any = part("Newest measured state minus what had been predicted for that time; 0 where nothing had.")
    resets: Scalar = quantity(
        "1",
        "Times it began anew: after a gap longer than the horizon, or a measurement older than the last.",
        kind="count",
    )


@record
class SentInputs:
    """What acts on the vehicle, by the commands sent; a slot for each tick of the actuators. Source: docs page."""

    start: Scalar = quantity("100 ns", "From when on it acts; NEVER in an empty slot.", kind="time")
    u: Any = part("The vehicle's input.")


@record
class PastPredictions:
    """States predicted of late; a slot for each command. Source: docs page."""

    t: Scalar = quantity("100 ns", "For which time; NEVER in an empty slot.", kind="time")
    state: Any = part("The state.")


@record
class PredictorState:
    """What the predictor remembers. Source: docs page, Predictor."""

    inputs: SentInputs = part("What the commands sent so far do.")
    past: PastPredictions = part("What was predicted.")
    actuators: Any = part("State of the believed actuators, up to where the last command sent acts.")
    measured: Scalar = quantity("100 ns", "When the newest measurement was made.", kind="time")
    prediction: Prediction = part("The last one.")


@record
class Predictor:
    """Carries an estimate from the time of its measurement to the time at which the command made from it will act.

        from t - age, the estimate's state, over what acts on the vehicle, to  latch(t + uplink_delay)

    What acts is what the believed actuators make of each command that was sent, with their stops, tables and brake; it
    is known from the moment of sending on. Each measurement is a new anchor: an error of the model grows over one
    horizon, never longer. At each `period` a command leaves; between them prediction and demand stay.

    Known:   how old the measurement is, from the time that each sample carries; how long commands take, from
             `uplink_delay` alone.
    Not in:  jitter of the uplink and lost commands, which act as if they had come on time.
    Source:  O. J. M. Smith, "Closer control of loops with dead time", Chem. Eng. Prog. 53 (1957); A. Z. Manitius,
             A. W. Olbrot, "Finite spectrum assignment problem for systems with delays", IEEE TAC 24 (1979), for the
             prediction from a measured state over the inputs under way.
    """

    craft: Any = part("What it believes of the vehicle.")
    actuators: Any = part("What it believes of the actuators; they act once a tick, which is their period.")
    start: Any = part("A state of the vehicle; its fields stand in for those that the estimate has not.")
    uplink_delay: Scalar = quantity(
        "s", "From sending a command to its arrival at the actuators.", low=0, off={"uplink-delay": 0.0}
    )
    horizon: int = period("Longest time to predict over; what is beyond it is left to the loop.", default=ms(500))
    period: int = period("Time between two commands that are sent.", default=ms(20))

    def check(self) -> None:
        """Refuse ticks that are no part of the period, or miss the actuators' frames."""
        tick, frame = self.actuators.period, optional_member(self.actuators, "frame")
        if self.period % tick:
            problem = f"{format_time(tick)} is no part of the predictor's period, {format_time(self.period)}"
            raise InputError("actuators.period", problem, fix="make the period a multiple, e.g. 20 ms and 10 ms")
        if self.horizon < self.period:
            problem = f"{format_time(self.horizon)} is shorter than the time between commands"
            raise InputError("horizon", problem, fix=f"make it {format_time(self.period)} or more, e.g. 500 ms")
        if frame is not None and self.period % frame:
            problem = f"{format_time(self.period)} is no multiple of the actuators' frame of {format_time(frame)}"
            raise InputError("period", problem, fix="predict as often as a command is latched")

    def init(self, key: Key, estimate: Estimate) -> PredictorState:
        """Nothing sent, nothing measured, for estimates of this structure; refuses those that it can't predict."""
        self._check_estimate(estimate)
        state = strengthen_types(self.start)
        neutral = self.actuators.neutral()
        actuators = strengthen_types(self.actuators.init(key.at("actuators")))
        zero = jax.tree.map(jnp.zeros_like, state)
        commands = math.ceil(self.horizon / self.period) + 2
        ticks = commands * (self.period // self.actuators.period)
        u = strengthen_types(neutral.u)
        return PredictorState(
            inputs=SentInputs(
                start=np.full(ticks, NEVER, np.int64),
                u=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (ticks, *leaf.shape)), u),
            ),
            past=PastPredictions(t=np.full(commands, NEVER, np.int64), state=empty_slots(state, commands)),
            actuators=actuators,
            measured=np.int64(NEVER),
            prediction=Prediction(
                state=state,
                valid=np.bool_(False),
                horizon=np.float64(0),
                limited=np.bool_(False),
                innovation=zero,
                resets=np.int32(0),
            ),
        )

    def predict(self, t: Any, state: PredictorState, estimate: Estimate) -> tuple[PredictorState, Estimate]:
        """The estimate as the law reads it at integer time t."""
        # The time alone decides, so that a batch of runs has a real branch here.
        state = lax.cond(
            t % self.period == 0, lambda: cast_like(self._predict(t, state, estimate), state), lambda: state
        )
        made = state.prediction
        fields = {name: getattr(made.state, name) for name in self._shared_fields(estimate)}
        return state, replace(estimate, state=replace(estimate.state, **fields), valid=estimate.valid & made.valid)

    def note(self, t: Any, state: PredictorState, command: Command) -> PredictorState:
        """The state with what a command issued at integer time t will do, if it is sent."""
        return lax.cond(t % self.period == 0, lambda: cast_like(self._note(t, state, command), state), lambda: state)

    def _acting_time(self, t: Any) -> Any:
        """When a command issued at integer time t begins to act: on arrival, or at the actuators' next frame."""
        arrival = t + jnp.round(self.uplink_delay * UNITS_PER_SECOND).astype(np.int64)
        frame = optional_member(self.actuators, "frame")
        return arrival if frame is None else -(-arrival // frame) * frame

    def _note(self, t: Any, state: PredictorState, command: Command) -> PredictorState:
        start, tick, inputs, actuators = self._acting_time(t), self.actuators.period, state.inputs, state.actuators
        slots = inputs.start.shape[0]
        for k in range(self.period // tick):
            now = start + k * tick
            sample = Sample(command.value, command.t, to_seconds(now - command.t), np.bool_(k == 0), command.valid)
            actuators, acting = self.actuators.step(now, actuators, sample)
            slot = (t // tick + k) % slots
            inputs = write_slot(inputs, slot, SentInputs(start=now, u=acting.u))
        return replace(state, inputs=inputs, actuators=actuators)

    def _predict(self, t: Any, state: PredictorState, estimate: Estimate) -> PredictorState:
        measured = t - jnp.round(estimate.age * UNITS_PER_SECOND).astype(np.int64)
        acts = self._acting_time(t)
        end = jnp.minimum(acts, measured + self.horizon)
        shared = self._shared_fields(estimate)
        anchor = replace(self.start, **{name: getattr(estimate.state, name) for name in shared})
        x = self._integrate(t, state.inputs, anchor, measured, end)
        gap = measured - state.measured
        known = state.prediction.valid & estimate.valid
        anew = known & ((gap < 0) | (gap > self.horizon))
        missed = lax.cond(
            known & (gap > 0) & ~anew,
            lambda: cast_like(self._innovation(t, state, anchor, measured, shared), state.prediction.innovation),
            lambda: state.prediction.innovation,
        )
        prediction = Prediction(
            state=x,
            valid=estimate.valid,
            horizon=to_seconds(end - measured),
            limited=acts > end,
            innovation=missed,
            resets=state.prediction.resets + anew.astype(np.int32),
        )
        slot = t // self.period % state.past.t.shape[0]
        target = jnp.where(estimate.valid, end, NEVER)
        past = write_slot(state.past, slot, PastPredictions(t=target, state=x))
        return replace(state, past=past, measured=jnp.where(estimate.valid, measured, NEVER), prediction=prediction)

    def _integrate(self, t: Any, inputs: SentInputs, x: Any, begin: Any, end: Any) -> Any:
        """The vehicle's state at `end` from that at `begin`, over what acts in between."""
        slots = inputs.start.shape[0]
        oldest = t // self.actuators.period % slots

        def advance(x: Any, u: Any, now: Any, until: Any) -> tuple[Any, Any]:
            until = jnp.clip(until, now, jnp.maximum(end, now))
            x = rk4(lambda s, at: self.craft.dynamics(s, at, u), to_seconds(now), x, to_seconds(until - now))
            return x, until

        def through(carry: Any, k: Any) -> tuple[Any, None]:
            x, u, since, now = carry
            slot = read_slot(inputs, (oldest + k) % slots)
            x, now = advance(x, u, now, slot.start)
            later = slot.start > since  # else a command was never made: the slot is empty, or a turn of the ring old
            return (x, tree_where(later, slot.u, u), jnp.where(later, slot.start, since), now), None

        u = strengthen_types(self.actuators.neutral().u)
        carry = strengthen_types((x, u, np.int64(NEVER), begin))
        (x, u, _, now), _ = lax.scan(through, carry, np.arange(slots))
        return advance(x, u, now, end)[0]

    def _innovation(self, t: Any, state: PredictorState, measured: Any, when: Any, shared: tuple[str, ...]) -> Any:
        """A measured state minus what had been predicted for its time: the last state predicted before, carried on."""
        past = state.past
        later = jnp.sum(past.t > when)
        before = read_slot(past, (t // self.period - 1 - later) % past.t.shape[0])
        there = (before.t != NEVER) & (before.t <= when)
        expected = self._integrate(t, state.inputs, before.state, jnp.where(there, before.t, when), when)
        missed = {}
        for name, own, declared in children(measured):
            off = own - getattr(expected, name)
            off = wrap(off) if getattr(declared, "kind", "") == "angle" else off
            missed[name] = jnp.where(there, off, 0.0) if name in shared else jnp.zeros_like(off)
        return replace(measured, **missed)

    def _shared_fields(self, estimate: Estimate) -> tuple[str, ...]:
        """Fields of the vehicle's state that the estimate has."""
        given = declarations(estimate.state) if is_record(estimate.state) else ()
        return tuple(name for name in declarations(self.start) if name in given)

    def _check_estimate(self, estimate: Estimate) -> None:
        """Refuse an estimate that lacks what the change of its fields depends on."""
        shared = self._shared_fields(estimate)
        needed = _needed_fields(self, shared)
        lacking = [name for name in needed if name not in shared]
        if lacking or not shared:
            own = type(self.craft).__name__
            lacks = ", ".join(lacking or declarations(self.start))
            problem = f"the motion of {own} depends on {lacks}, which the estimate does not give"
            given = tuple(declarations(estimate.state)) if is_record(estimate.state) else ()
            fix = "fly with an estimator that gives it, or leave the predictor out"
            raise InputError("autopilot.predictor", problem, choices=given, fix=fix)


def _needed_fields(predictor: Predictor, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """Fields of the vehicle's state on which those wanted depend, in whatever time: read off the dynamics."""
    names = tuple(declarations(predictor.start))
    state = strengthen_types(predictor.start)
    derivative = zeros_of(
        "autopilot.predictor.craft", "its state", predictor.craft.dynamics, 0.0, state, predictor.actuators.neutral().u
    )
    if jax.tree.structure(derivative) != jax.tree.structure(state):
        problem = f"{type(predictor.craft).__name__} does not move a {type(predictor.start).__name__}"
        raise InputError("autopilot.predictor.start", problem, fix="give a state of that vehicle")
    closed = jax.make_jaxpr(lambda x: predictor.craft.dynamics(0.0, x, predictor.actuators.neutral().u))(state)
    jaxpr = closed.jaxpr
    owner = [n for n in names for _ in jax.tree.leaves(getattr(state, n))]
    needed = set(wanted)
    while True:
        live = {id(v) for n, v in zip(owner, jaxpr.outvars, strict=True) if n in needed}
        for equation in reversed(jaxpr.eqns):
            if any(id(v) in live for v in equation.outvars):
                live |= {id(v) for v in equation.invars}
        more = needed | {n for n, v in zip(owner, jaxpr.invars, strict=True) if id(v) in live}
        if more == needed:
            return tuple(n for n in names if n in needed)
        needed = more


def predictor_for(world: Any, autopilot: Any, start: Any) -> Predictor:
    """A predictor of what an autopilot believes, over the links and actuators of a world; start: the first state.

    Raises: InputError for an uplink of which no latency is known.
    """
    believed = vehicle_copies(autopilot, world.vehicle)
    frame = optional_member(world.actuators, "frame")
    sent = max(optional_member(world.uplink, "send_period") or world.uplink.period, autopilot.period)
    if frame is not None:
        sent = math.lcm(sent, frame)
    tick = TICK if sent % TICK == 0 and (frame or sent) % TICK == 0 else sent
    return Predictor(
        craft=next(iter(believed.values()), world.vehicle),
        actuators=replace(world.actuators, period=tick),
        start=jax.tree.map(np.zeros_like, start),
        uplink_delay=expected_latency(world.uplink),
        period=sent,
    )


def expected_latency(channel: Any) -> float:
    """The mean latency (s) of a channel.

    Raises: InputError for a channel of which none is known.
    """
    if isinstance(channel, Wire):
        return 0.0
    if isinstance(channel, DelayChain):
        return channel.delay()
    if isinstance(channel, MeasuredLatency):
        return mean_latency(channel.latency)
    if isinstance(channel, LatencyTrace):
        return mean_received_latency(channel)
    problem = f"of a {type(channel).__name__} no latency is known that a predictor could count on"
    raise InputError(
        argument_name("settings", "predictor"), problem, fix="leave the predictor out, or fly over another uplink"
    )

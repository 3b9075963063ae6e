"""Predictor that compensates the delay of downlink and uplink. An optional part of the Autopilot.

The predictor runs after the estimator and before the law: the law reads the predicted state instead of the estimate.

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
from trimtab.loop.model_mismatch import vehicle_copies
from trimtab.loop.structure import cast_like, strengthen_types, zeros_of

TICK = ms(10)
"""Period of the actuator model in a predictor, if it divides the time between two commands. The default brake time of
150 ms is a multiple of this period."""


@record
class Prediction:
    """Output of the predictor. Frames: those of the vehicle's state. Source: docs page, Predictor."""

    state: Any = part(
        "Predicted state of the vehicle at the time when the present command acts. Fields that the estimate lacks have "
        "no meaning."
    )
    valid: Scalar = quantity("1", "True if the estimate used for the prediction was valid.", kind="flag")
    horizon: Scalar = quantity(
        "s", "Time span of the prediction, from the measurement to the time when the command acts."
    )
    limited: Scalar = quantity(
        "1",
        "True if the prediction ends before the command acts, because its time span is limited to the maximum horizon.",
        kind="flag",
    )
    innovation: Any = part(
        "Newest measured state minus the state predicted for the time of the measurement. 0 if no prediction exists."
    )
    resets: Scalar = quantity(
        "1",
        "Number of restarts of the predictor, after a gap between measurements longer than the horizon, or after a "
        "measurement older than the previous one.",
        kind="count",
    )


@record
class SentInputs:
    """Ring buffer of the vehicle inputs that result from past commands, with one slot per period of the actuator model.

    Source:  docs page, Predictor.
    """

    start: Scalar = quantity("100 ns", "Time at which the input starts to act, or NEVER in an empty slot.", kind="time")
    u: Any = part("Input of the vehicle.")


@record
class PastPredictions:
    """Ring buffer of recent predicted states, with one slot per sent command. Source: docs page, Predictor."""

    t: Scalar = quantity("100 ns", "Time for which the state was predicted, or NEVER in an empty slot.", kind="time")
    state: Any = part("Predicted state.")


@record
class PredictorState:
    """State of the predictor. Source: docs page, Predictor."""

    inputs: SentInputs = part("Vehicle inputs that result from the sent commands.")
    past: PastPredictions = part("Past predictions.")
    actuators: Any = part("State of the actuator model at the time when the last sent command acts.")
    measured: Scalar = quantity("100 ns", "Time of the newest measurement.", kind="time")
    prediction: Prediction = part("Last prediction.")


@record
class Predictor:
    """Predictor of the vehicle's state at the time when the present command will act.

        The estimate, x(t - age), is integrated with the vehicle's inputs to the state x(latch(t + uplink_delay)).

    latch(t) is the time of the actuators' next frame, or t if the actuators have no frames. A model of the actuators,
    with stops, tables and brake, computes the inputs from all sent commands. Each prediction starts from the newest
    measurement, so that model errors do not accumulate beyond one horizon. A command is sent every `period`. Between
    two commands, prediction and demand do not change.

    Known:   age of the measurement (from the sample's time stamp), and mean delay of commands (`uplink_delay`).
    Not modelled: jitter of the uplink, and lost commands. Commands are assumed to arrive after the mean delay.
    Source:  O. J. M. Smith, "Closer control of loops with dead time", Chem. Eng. Prog. 53 (1957); A. Z. Manitius,
             A. W. Olbrot, "Finite spectrum assignment problem for systems with delays", IEEE TAC 24 (1979), for the
             prediction from a measured state over the inputs in transit.
    """

    craft: Any = part("Vehicle model used by the predictor.")
    actuators: Any = part(
        "Model of the actuators. Its period is the time between two changes of the vehicle's input in the prediction."
    )
    start: Any = part("State of the vehicle whose values are used for those fields that the estimate lacks.")
    uplink_delay: Scalar = quantity(
        "s", "Delay from sending a command to its arrival at the actuators.", low=0, off={"uplink-delay": 0.0}
    )
    horizon: int = period(
        "Maximum time span of a prediction. A longer delay is compensated only in part.", default=ms(500)
    )
    period: int = period("Time between two commands sent to the vehicle.", default=ms(20))

    def check(self) -> None:
        """Raise InputError for an invalid period or horizon.

        The predictor's period must be a multiple of the actuators' period and frame. The horizon must not be shorter
        than the period.
        """
        tick, frame = self.actuators.period, optional_member(self.actuators, "frame")
        if self.period % tick:
            problem = (
                f"the predictor's period, {format_time(self.period)}, must be a multiple of the actuators' period, "
                f"{format_time(tick)}"
            )
            raise InputError(
                "actuators.period",
                problem,
                fix="set e.g. the predictor's period to 20 ms and the period of its actuators to 10 ms",
            )
        if self.horizon < self.period:
            problem = f"must be at least as long as the predictor's period, got {format_time(self.horizon)}"
            raise InputError(
                "horizon", problem, fix=f"set the horizon to {format_time(self.period)} or more, e.g. 500 ms"
            )
        if frame is not None and self.period % frame:
            problem = f"{format_time(self.period)} must be a multiple of the actuators' frame of {format_time(frame)}"
            raise InputError(
                "period", problem, fix=f"set the predictor's period to {format_time(frame)}, or a multiple of that time"
            )

    def init(self, key: Key, estimate: Estimate) -> PredictorState:
        """Return the initial state. estimate: example of an estimate.

        Raise InputError if the estimate lacks a field of the state that is needed for a prediction.
        """
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
        """Return the predictor's state, and the predicted estimate that the law reads at time t (100 ns)."""
        # The condition depends on the time only, so a batch of runs has a real branch here instead of a select.
        state = lax.cond(
            t % self.period == 0, lambda: cast_like(self._predict(t, state, estimate), state), lambda: state
        )
        made = state.prediction
        fields = {name: getattr(made.state, name) for name in self._shared_fields(estimate)}
        return state, replace(estimate, state=replace(estimate.state, **fields), valid=estimate.valid & made.valid)

    def note(self, t: Any, state: PredictorState, command: Command) -> PredictorState:
        """Return the predictor's state after the command issued at integer time t.

        If the command is sent at this time, the vehicle inputs that result from it are stored.
        """
        return lax.cond(t % self.period == 0, lambda: cast_like(self._note(t, state, command), state), lambda: state)

    def _acting_time(self, t: Any) -> Any:
        """Return the time at which a command issued at integer time t starts to act.

        This is the command's time of arrival or, if the actuators have frames, the start of the next frame.
        """
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
        """Return the vehicle's state at time `end`, integrated from the state x at time `begin`.

        t: present time.  inputs: stored inputs of the vehicle. All times are in 100 ns.
        """
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
            later = slot.start > since  # False for an empty slot, or a slot written one turn of the ring ago
            return (x, tree_where(later, slot.u, u), jnp.where(later, slot.start, since), now), None

        u = strengthen_types(self.actuators.neutral().u)
        carry = strengthen_types((x, u, np.int64(NEVER), begin))
        (x, u, _, now), _ = lax.scan(through, carry, np.arange(slots))
        return advance(x, u, now, end)[0]

    def _innovation(self, t: Any, state: PredictorState, measured: Any, when: Any, shared: tuple[str, ...]) -> Any:
        """Return a measured state minus the state that was predicted for the time of the measurement.

        when: time of the measurement.  shared: names of the measured fields.
        """
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
        """Return the names of the fields of the vehicle's state that the estimate also has."""
        given = declarations(estimate.state) if is_record(estimate.state) else ()
        return tuple(name for name in declarations(self.start) if name in given)

    def _check_estimate(self, estimate: Estimate) -> None:
        """Raise InputError if the derivative of an estimated field depends on a field that the estimate lacks."""
        shared = self._shared_fields(estimate)
        needed = _needed_fields(self, shared)
        lacking = [name for name in needed if name not in shared]
        if lacking or not shared:
            own = type(self.craft).__name__
            lacks = ", ".join(lacking or declarations(self.start))
            problem = f"the motion of {own} depends on {lacks}, which the estimate does not contain"
            given = tuple(declarations(estimate.state)) if is_record(estimate.state) else ()
            fix = f"use an estimator that provides {lacks}, or leave the predictor out"
            raise InputError("autopilot.predictor", problem, choices=given, fix=fix)


def _needed_fields(predictor: Predictor, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the state's fields on which the motion of the fields `wanted` depends.

    The dependence is determined from the program code of the vehicle's dynamics.
    """
    names = tuple(declarations(predictor.start))
    state = strengthen_types(predictor.start)
    derivative = zeros_of(
        "autopilot.predictor.craft", "its state", predictor.craft.dynamics, 0.0, state, predictor.actuators.neutral().u
    )
    if jax.tree.structure(derivative) != jax.tree.structure(state):
        problem = f"must be a state of {type(predictor.craft).__name__}, got a {type(predictor.start).__name__}"
        raise InputError("autopilot.predictor.start", problem, fix="set start to a state record of that vehicle")
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
    """Return a predictor for the links and actuators of a world, with the vehicle model of an autopilot.

    start: initial state of the vehicle.

    Raises: InputError for an uplink without a known latency.
    """
    assumed = vehicle_copies(autopilot, world.vehicle)
    frame = optional_member(world.actuators, "frame")
    sent = max(optional_member(world.uplink, "send_period") or world.uplink.period, autopilot.period)
    if frame is not None:
        sent = math.lcm(sent, frame)
    tick = TICK if sent % TICK == 0 and (frame or sent) % TICK == 0 else sent
    return Predictor(
        craft=next(iter(assumed.values()), world.vehicle),
        actuators=replace(world.actuators, period=tick),
        start=jax.tree.map(np.zeros_like, start),
        uplink_delay=expected_latency(world.uplink),
        period=sent,
    )


def expected_latency(channel: Any) -> float:
    """Return the mean latency (s) of a channel.

    Raises: InputError for a channel without a known latency.
    """
    if isinstance(channel, Wire):
        return 0.0
    if isinstance(channel, DelayChain):
        return channel.delay()
    if isinstance(channel, MeasuredLatency):
        return mean_latency(channel.latency)
    if isinstance(channel, LatencyTrace):
        return mean_received_latency(channel)
    problem = f"a {type(channel).__name__} has no known latency, which a predictor needs"
    raise InputError(
        argument_name("settings", "predictor"),
        problem,
        fix="leave the predictor out, or use an uplink of class MeasuredLatency",
    )

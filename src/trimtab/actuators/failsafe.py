"""Failsafe: behaviour of the vehicle without commands, and selection of the source of commands.

The failsafe is a block of the firmware.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, leaves, part, period, quantity, record, replace, tree_where
from trimtab.core.signals import Sample
from trimtab.core.time import NEVER, ms, seconds

MODES = ("disarmed", "computer", "manual", "failsafe")
DISARMED, COMPUTER, MANUAL, FAILSAFE = range(4)
CAUSES = (
    "start",
    "arm request",
    "disarm request",
    "no command",
    "no command since arming",
    "takeover",
    "takeover ended",
    "pilot's radio lost",
    "fence",
    "envelope",
)
START, ARM, DISARM, SILENCE, NEVER_CAME, TAKEOVER, RELEASED, RADIO, FENCE, ENVELOPE = range(len(CAUSES))
BREACHES = ("none", "fence", "envelope")


@record
class FailsafeInput:
    """Input of the failsafe at one instant. Frames: those of the commands. Source: docs page, Failsafe."""

    command: Sample = part("Newest command received over the uplink.")
    manual: Any = part(
        "Command from the safety pilot's sticks, a record of the same class as the value of an uplink command."
    )
    takeover: Scalar = quantity(
        "1", "True if the safety pilot's mode switch is set to manual.", kind="flag", default=False
    )
    radio: Scalar = quantity(
        "1", "True while the signal of the safety pilot's transmitter is received.", kind="flag", default=False
    )
    arm: Scalar = quantity("1", "True to request arming.", kind="flag", default=False)
    disarm: Scalar = quantity(
        "1", "True to request disarming; has priority over a request to arm.", kind="flag", default=False
    )
    breach: Scalar = quantity(
        "1", "Limit that the vehicle has exceeded: none, fence or envelope.", kind="mode", modes=BREACHES, default=0
    )


@record
class FailsafeState:
    """State of the failsafe. Frames: those of the commands. Source: docs page, Failsafe."""

    mode: Scalar = quantity("1", "Authority: the present source of commands.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Cause of the last change of mode.", kind="mode", modes=CAUSES)
    latched: Scalar = quantity("1", "True if the failsafe has tripped since the last arming.", kind="flag")
    armed_at: Scalar = quantity("100 ns", "Time of the last arming.", kind="time")
    command_arrival: Scalar = quantity("100 ns", "Arrival time of the last good command since arming.", kind="time")
    newest: Scalar = quantity("100 ns", "Issue time of the newest good command since arming.", kind="time")
    value: Any = part("Value of the newest good command.")
    lift_until: Scalar = quantity("100 ns", "Time at which the lift fan stops.", kind="time")
    rejected: Scalar = quantity(
        "1",
        "Number of commands rejected since the start, because they were out of range, not finite or too old.",
        kind="count",
    )


@record
class FailsafeOutput:
    """Output of the failsafe. Frames: those of the commands. Source: docs page, Failsafe."""

    command: Sample = part(
        "Command for the actuators. If the actuators must stop, an invalid command with the value `safe`."
    )
    lift: Scalar = quantity("1", "True if the lift fan is switched on.", kind="flag")
    armed: Scalar = quantity("1", "True if a received command or the pilot can move the actuators.", kind="flag")
    mode: Scalar = quantity("1", "Authority: the present source of commands.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Cause of the last change of mode.", kind="mode", modes=CAUSES)
    rejected: Scalar = quantity("1", "Number of commands rejected since the start.", kind="count")


@record
class Failsafe:
    """Failsafe that passes commands to the actuators while they arrive, and stops the vehicle when they do not.

    Without a good command for `timeout`, the safe value acts at once, and the lift fan stops `lift_delay` later. The
    failsafe stays tripped until the next request to arm. It also trips if the vehicle leaves its fence or envelope.
    Once armed, the safety pilot can take over at any time, even without a link, after a trip, or outside fence and
    envelope. No command acts before arming, and commands received before arming are ignored. A good command is new,
    valid and finite, lies between `low` and `high`, and is at most `age_max` old. Other commands are counted and
    ignored, but an invalid command stops the vehicle at once.

    The failsafe works for any command: `safe`, `low` and `high` are records of the same class as the command's value.
    The docs page lists all rules.

    Frames:  those of the commands.    Not modelled: where requests come from.
    Source:  [1] chapter 5 (safety pilot's takeover, on the vehicle); time-outs are our own choice: docs page.
    """

    safe: Any = part("Safe command, at which the vehicle comes to rest.")
    low: Any = part("Smallest accepted value of each field of a command.")
    high: Any = part("Largest accepted value of each field of a command.")
    timeout: int = period(
        "Longest accepted time without a good command. After this time the failsafe trips.", default=ms(250)
    )
    lift_delay: int = period(
        "Delay from the trip of the failsafe to the stop of the lift fan.", default=seconds(1), low=0
    )
    patience: int = period(
        "Longest time from arming to the first command. After this time the vehicle disarms.", default=seconds(10)
    )
    age_max: Scalar = quantity("s", "Maximum age of an accepted command, by the vehicle's clock.", default=0.5, above=0)

    def check(self) -> None:
        """Raise InputError if the safe value is not between the limits, or the records have different fields."""
        own = [path for path, _, _ in leaves(self.safe)]
        for name, limit in (("low", self.low), ("high", self.high)):
            other = [path for path, _, _ in leaves(limit)]
            if own != other:
                problem = (
                    f"the record has the fields ({', '.join(other)}), but the record `safe` has the fields "
                    f"({', '.join(own)})"
                )
                raise InputError(name, problem, fix=f"give a record of class {type(self.safe).__name__}")
        for path, value, _ in leaves(self.safe):
            low, high = (np.asarray({p: v for p, v, _ in leaves(r)}[path]) for r in (self.low, self.high))
            if not ((low <= np.asarray(value)) & (np.asarray(value) <= high)).all():
                problem = f"the safe value {value} must lie between the limits low, {low}, and high, {high}"
                raise InputError(f"safe.{path}", problem, fix="change the limit or the safe value")

    def init(self) -> FailsafeState:
        """Return the initial state, disarmed."""
        never = np.int64(NEVER)
        return FailsafeState(
            mode=np.int32(DISARMED),
            cause=np.int32(START),
            latched=np.bool_(False),
            armed_at=never,
            command_arrival=never,
            newest=never,
            value=jax.tree.map(lambda v: jnp.asarray(v, np.float64), self.safe),
            lift_until=never,
            rejected=np.int32(0),
        )

    def step(self, t: Any, state: FailsafeState, input: FailsafeInput) -> tuple[FailsafeState, FailsafeOutput]:
        """Return the new state, and the output that acts from integer time t on.

        The times of successive calls must increase, but need not have a fixed period.
        """
        before = state.mode
        state = self._apply_requests(t, state, input)
        state = self._accept_command(t, state, input.command)
        pilot = input.radio & input.takeover & self._is_in_range(input.manual)
        state = self._next_mode(t, state, pilot, input)
        manual, computer = state.mode == MANUAL, state.mode == COMPUTER
        obeyed = computer & input.command.valid & (state.command_arrival != NEVER)
        value = tree_where(manual, input.manual, tree_where(obeyed, state.value, self.safe))
        turns = manual | (computer & (state.command_arrival != NEVER))
        tripped = (state.mode == FAILSAFE) & (before != FAILSAFE)
        state = replace(state, lift_until=jnp.where(turns | tripped, t + self.lift_delay, state.lift_until))
        output = FailsafeOutput(
            command=replace(input.command, value=value, valid=manual | obeyed),
            lift=turns | ((state.mode == FAILSAFE) & (t < state.lift_until)),
            armed=manual | computer,
            mode=state.mode,
            cause=state.cause,
            rejected=state.rejected,
        )
        return state, output

    def _apply_requests(self, t: Any, s: FailsafeState, input: FailsafeInput) -> FailsafeState:
        """Return the state after the requests to arm or disarm. Arming discards all commands received before."""
        arm = jnp.asarray(input.arm) & ~jnp.asarray(input.disarm) & ((s.mode == DISARMED) | s.latched)
        disarm = input.disarm & (s.mode != DISARMED)
        mode = jnp.where(arm & (s.mode != MANUAL), COMPUTER, s.mode)
        cause = jnp.where(arm, ARM, s.cause)
        return replace(
            s,
            mode=jnp.where(disarm, DISARMED, mode).astype(np.int32),
            cause=jnp.where(disarm, DISARM, cause).astype(np.int32),
            latched=s.latched & ~arm & ~disarm,
            armed_at=jnp.where(arm, t, s.armed_at),
            command_arrival=jnp.where(arm, NEVER, s.command_arrival),
            newest=jnp.where(arm, NEVER, s.newest),
        )

    def _accept_command(self, t: Any, s: FailsafeState, command: Sample) -> FailsafeState:
        """Return the state after the newest command, which is stored only if it is good."""
        came = command.fresh & command.valid
        good = came & self._is_in_range(command.value) & (abs(command.age) <= self.age_max) & (command.t > s.newest)
        return replace(
            s,
            command_arrival=jnp.where(good, t, s.command_arrival),
            newest=jnp.where(good, command.t, s.newest),
            value=tree_where(good, command.value, s.value),
            rejected=jnp.where(came & ~good & (s.rejected < 2**31 - 1), s.rejected + 1, s.rejected).astype(np.int32),
        )

    def _next_mode(self, t: Any, s: FailsafeState, pilot: Any, input: FailsafeInput) -> FailsafeState:
        """Return the state after the pilot's mode switch, the time-outs, and the limits of fence and envelope.

        If several rows of the table below apply, the last of these rows decides.
        """
        mode, cause = s.mode, s.cause
        radio, takeover = jnp.asarray(input.radio), jnp.asarray(input.takeover)
        came = s.command_arrival != NEVER
        silent = jnp.where(came, t - s.command_arrival, t - s.armed_at) >= jnp.where(came, self.timeout, self.patience)
        was_manual = mode == MANUAL
        released = was_manual & ~pilot
        lost = released & ~(radio & ~takeover)
        tripped = (mode == COMPUTER) & silent & came
        bored = (mode == COMPUTER) & silent & ~came
        takes = pilot & ((mode == COMPUTER) | (mode == FAILSAFE))
        stays = released & ~lost & ~s.latched & came & ~silent
        rows = (
            (stays, COMPUTER, RELEASED),
            (released & ~lost & ~stays, FAILSAFE, RELEASED),
            (lost, FAILSAFE, RADIO),
            (tripped, FAILSAFE, SILENCE),
            (bored, DISARMED, NEVER_CAME),
            ((mode == COMPUTER) & (input.breach == 1), FAILSAFE, FENCE),
            ((mode == COMPUTER) & (input.breach == 2), FAILSAFE, ENVELOPE),
            (takes, MANUAL, TAKEOVER),
        )
        for holds, to, why in rows:
            mode, cause = jnp.where(holds, to, mode), jnp.where(holds, why, cause)
        latched = s.latched | (mode == FAILSAFE)
        return replace(s, mode=mode.astype(np.int32), cause=cause.astype(np.int32), latched=latched)

    def _is_in_range(self, value: Any) -> Any:
        numbers = zip(leaves(self.low), leaves(value), leaves(self.high), strict=True)
        inside = [jnp.all((low[1] <= number[1]) & (number[1] <= high[1])) for low, number, high in numbers]
        return jnp.all(jnp.stack(inside)) if inside else jnp.asarray(True)

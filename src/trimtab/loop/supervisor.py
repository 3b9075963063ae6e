"""Supervisor, which decides whether the law's, the neutral or an invalid command is sent.

An optional part of the Autopilot. Source: docs page, Supervisor.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, leaves, option, part, period, quantity, record
from trimtab.core.signals import Estimate, Frame, Sample
from trimtab.core.suggestions import closest
from trimtab.core.time import FOREVER, format_time, ms, seconds
from trimtab.loop.supervisor_modes import (
    ARM,
    ARMED,
    AUTOMATIC,
    CAUSES,
    CHECKS,
    CLEAR,
    CLEARED,
    END,
    ENDED,
    ENDED_BY,
    FAULT,
    FENCE,
    FLYING,
    FOUND,
    HEALTH,
    HELD,
    HOLD,
    LINK,
    LOST,
    MODES,
    NO_ESTIMATE,
    NO_REQUEST,
    NOT_FINITE,
    REQUESTS,
    RESUME,
    RESUMED,
    SPEED,
    STALE,
    STANDBY,
    TO_HOLD,
    TOO_LONG,
)


@record
class PilotRequest:
    """Request of a pilot. Each new sample is a new request. Frames: none. Source: docs page, Supervisor."""

    request: Scalar = quantity("1", "Request of the pilot.", kind="mode", modes=REQUESTS)


@record
class SupervisorInput:
    """Input of the supervisor. Frames: the estimate's. Source: docs page, Supervisor."""

    estimate: Estimate = part("Output of the estimator at this instant.")
    arrived: Scalar = quantity("1", "True if a new sample of any sensor has arrived over the link.", kind="flag")
    finite: Scalar = quantity("1", "True if all numbers of the law's command are finite.", kind="flag")
    pilot: Any = part("Newest sample of the pilot's requests, or None without a pilot.", default=None)


@record
class SupervisorState:
    """State of the supervisor. Frames: none. Source: docs page, Supervisor."""

    mode: Scalar = quantity("1", "Mode of the supervisor.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Cause of the last change of mode.", kind="mode", modes=CAUSES)
    since: Scalar = quantity("100 ns", "Time at which the mode was entered.", kind="time")
    back: Scalar = quantity("1", "Mode to return to when the link or the estimate recovers.", kind="mode", modes=MODES)
    sample_arrival: Scalar = quantity("100 ns", "Time at which the last sample arrived over the link.", kind="time")
    refused: Scalar = quantity(
        "1", "Check that caused the refusal of the last refused request.", kind="mode", modes=CHECKS
    )
    refusals: Scalar = quantity("1", "Number of refused requests.", kind="count")
    transitions: Scalar = quantity("1", "Number of mode changes.", kind="count")


@record
class SupervisorOutput:
    """Output of the supervisor. Frames: none. Source: docs page, Supervisor."""

    mode: Scalar = quantity("1", "Mode of the supervisor.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Cause of the last change of mode.", kind="mode", modes=CAUSES)
    transitions: Scalar = quantity("1", "Number of mode changes.", kind="count")
    refused: Scalar = quantity(
        "1", "Check that caused the refusal of the last refused request.", kind="mode", modes=CHECKS
    )
    refusals: Scalar = quantity("1", "Number of refused requests.", kind="count")
    check: Scalar = quantity(
        "1",
        "Check that would refuse a request to arm at this instant. passed: no check would refuse the request.",
        kind="mode",
        modes=CHECKS,
    )
    law: Scalar = quantity("1", "True if the law's command is sent.", kind="flag")
    sends: Scalar = quantity(
        "1", "True if a valid command is sent: the law's command or the neutral command.", kind="flag"
    )


@record
class Limit:
    """Limit that the supervisor checks: bounds on a number of the estimated state, or on the length of a vector.

        low <= x <= high    for one field;    low <= sqrt(x^2 + y^2 + …) <= high    for several fields

    NaN counts as outside the bounds.

    Frames:  the estimate's.    Source:  docs page, Supervisor.
    """

    fields: tuple[str, ...] = option(
        "Fields of the estimated state to which the limit applies, e.g. ('north',) or ('north', 'east')."
    )
    low: Scalar = quantity(
        "1", "Smallest accepted value of the field, or length of the vector, in the unit of the fields.", default=-1e9
    )
    high: Scalar = quantity(
        "1", "Largest accepted value of the field, or length of the vector, in the unit of the fields.", default=1e9
    )
    kind: str = option("Kind of limit: envelope or geofence.", default="geofence", choices=("geofence", "envelope"))

    def check(self) -> None:
        """Raise InputError if no field is named, or if `low` is not below `high`."""
        if not self.fields:
            raise InputError(
                "fields", "must name at least one field of the estimate", fix="write e.g. fields=('north', 'east')"
            )
        if not float(self.low) < float(self.high):
            problem = f"low must be below high, got {float(self.low):g} and {float(self.high):g}"
            raise InputError("low", problem, fix="exchange low and high")

    def is_breached(self, state: Any) -> Any:
        """Return True if an estimated state is outside the bounds."""
        numbers = [jnp.asarray(getattr(state, name)) for name in self.fields]
        x = numbers[0] if len(numbers) == 1 else jnp.sqrt(sum(n * n for n in numbers))
        return ~((self.low <= x) & (x <= self.high))


@record
class Supervisor:
    """Supervisor between law and link. It sends the law's command, the neutral command, or an invalid command.

        standby  --arm request, if all checks pass-->  flying  <--hold, resume requests-->  hold (neutral command)
        flying, hold  --link lost or estimate too old-->  lost (first law's, then neutral command, then mode ended)
        flying, hold, lost  --limit exceeded-->  fault
        flying  --estimate not valid, sensor health, or command not finite-->  fault
        flying, hold, lost  --end request-->  ended
        fault, ended  --clear request-->  standby

    In the modes standby, fault and ended, no valid command is sent. The docs page has the complete table of
    transitions.

    Frames:  the estimate's.
    Not modelled: the battery.
    Source:  docs page, Supervisor; modes and times are our choice.
    """

    neutral: Any = part("Neutral command.")
    limits: tuple[Limit, ...] = part("Geofence and speed envelope.", default=())
    stale_age: Scalar = quantity("s", "Maximum age of the estimate in flight.", default=0.4, above=0)
    link_timeout: int = period(
        "Time without a new sample of any sensor after which the link counts as lost.", default=ms(200)
    )
    link_continue: int = period(
        "Time for which the law's command is still sent after the link is lost.", default=ms(300), low=0
    )
    link_end: int = period("Time from the loss of the link to the end of the flight.", default=seconds(5))
    stale_continue: int = period(
        "Time for which the law's command is still sent after the estimate becomes too old.", default=ms(300), low=0
    )
    stale_end: int = period(
        "Time from the moment at which the estimate becomes too old to the end of the flight.", default=seconds(5)
    )
    healthy: tuple[str, ...] = option(
        "Paths of flags and counters in the estimated state that must be zero for a flight.", default=()
    )
    pilot: str = option("Name of the sensor that provides the pilot's requests.", default="pilot")
    automatic: bool = option(
        "True: the supervisor arms by itself as soon as all checks pass.", default=False, choices=(True, False)
    )

    def check(self) -> None:
        """Raise InputError unless link_end exceeds link_continue and stale_end exceeds stale_continue."""
        for what in ("link", "stale"):
            goes_on, end = getattr(self, f"{what}_continue"), getattr(self, f"{what}_end")
            if end <= goes_on:
                problem = f"{format_time(end)} must be later than {what}_continue, {format_time(goes_on)}"
                raise InputError(
                    f"{what}_end", problem, fix="set a later time, so that the neutral command is sent in between"
                )

    def fit_neutral(self, estimate: Estimate, value: Any, frame: Frame) -> Any:
        """Return the neutral command, with the data types of the allocation's command.

        value: command of the allocation. Raise InputError if the autopilot's estimate, command or samples lack what
        this supervisor reads.
        """
        if self.pilot not in frame.samples and not self.automatic:
            problem = f"the supervisor can never be armed, because the world has no sensor {self.pilot!r} for requests"
            fix = f'add sensors={{"{self.pilot}": PilotScript(…)}} to the world, or set automatic=True'
            raise InputError("autopilot.supervisor.pilot", problem, choices=tuple(frame.samples), fix=fix)
        known = [path for path, _, _ in leaves(estimate.state)]
        for path in (*(name for limit in self.limits for name in limit.fields), *self.healthy):
            if path not in known:
                near = closest(path, known, 1) or known[:1]
                problem = f"the estimate has no {path!r}"
                raise InputError("autopilot.supervisor", problem, choices=known, fix=f"write {near[0]!r}")
        if jax.tree.structure(self.neutral) != jax.tree.structure(value):
            problem = (
                f"neutral is a {type(self.neutral).__name__}, but the allocation's command is a {type(value).__name__}"
            )
            raise InputError("autopilot.supervisor", problem, fix=f"set neutral={type(value).__name__}(…)")
        return jax.tree.map(lambda n, v: jnp.asarray(n, jnp.result_type(v)), self.neutral, value)

    def init(self) -> SupervisorState:
        """Return the initial state, in mode standby."""
        none, now = np.int32(0), np.int64(-FOREVER)
        return SupervisorState(
            mode=none,
            cause=none,
            since=now,
            back=none,
            sample_arrival=now,
            refused=none,
            refusals=none,
            transitions=none,
        )

    def step(self, t: Any, s: SupervisorState, input: SupervisorInput) -> tuple[SupervisorState, SupervisorOutput]:
        """Return the supervisor's new state, and its output, which acts from integer time t on."""
        sample_arrival = jnp.where(input.arrived, t, s.sample_arrival)
        silent = t - sample_arrival >= self.link_timeout
        stale = ~(input.estimate.age <= self.stale_age)
        sick = self._is_sick(input.estimate.state)
        check = self._first_failing_check(input.estimate, silent, stale, sick)
        asked = _pilot_request(input.pilot)
        mode, cause = self._next_mode(t, s, input, asked, silent, stale, sick, check)
        changed = mode != s.mode
        came = (s.mode == STANDBY) & (mode == FLYING)
        refused = ((asked == ARM) & ~came) | ((asked == RESUME) & ~((s.mode == HOLD) & (mode == FLYING)))
        sensible = jnp.where(asked == ARM, s.mode == STANDBY, s.mode == HOLD)
        lost = (mode == LOST) & changed
        back = jnp.where(lost, s.mode, jnp.where((mode == LOST) & (asked == TO_HOLD), HOLD, s.back))
        new = SupervisorState(
            mode=mode,
            cause=cause,
            since=jnp.where(changed, t, s.since),
            back=back.astype(np.int32),
            sample_arrival=sample_arrival,
            refused=jnp.where(refused, jnp.where(sensible, check, len(CHECKS) - 1), s.refused).astype(np.int32),
            refusals=(s.refusals + refused).astype(np.int32),
            transitions=(s.transitions + changed).astype(np.int32),
        )
        return new, self._output(t, new, check, input.estimate.valid)

    def _next_mode(
        self,
        t: Any,
        s: SupervisorState,
        input: SupervisorInput,
        asked: Any,
        silent: Any,
        stale: Any,
        sick: Any,
        check: Any,
    ) -> tuple[Any, Any]:
        """Return the mode after this instant, and the cause of the last change of mode.

        If several transitions in `rows` are possible, the last one in the list is used.
        """
        valid = jnp.asarray(input.estimate.valid)
        standby, flying, hold, lost = (s.mode == m for m in (STANDBY, FLYING, HOLD, LOST))
        under_way = flying | hold | lost
        ready = check == 0
        end = jnp.where(s.cause == LINK, self.link_end, self.stale_end)
        rows: list[tuple[Any, Any, Any]] = [
            (standby & ready & self.automatic, FLYING, AUTOMATIC),
            (standby & ready & (asked == ARM), FLYING, ARMED),
            (((s.mode == FAULT) | (s.mode == ENDED)) & (asked == CLEAR), STANDBY, CLEARED),
            (hold & ready & (asked == RESUME), FLYING, RESUMED),
            (flying & (asked == TO_HOLD), HOLD, HELD),
            (lost & ~silent & ~stale, jnp.where(asked == TO_HOLD, HOLD, s.back), FOUND),
            ((flying | hold) & stale, LOST, STALE),
            ((flying | hold) & silent, LOST, LINK),
            (lost & (silent | stale) & (t - s.since >= end), ENDED, TOO_LONG),
            (under_way & (asked == END), ENDED, ENDED_BY),
            (flying & sick, FAULT, HEALTH),
            (flying & ~valid, FAULT, NO_ESTIMATE),
            (under_way & valid & self._is_breached("envelope", input.estimate.state), FAULT, SPEED),
            (under_way & valid & self._is_breached("geofence", input.estimate.state), FAULT, FENCE),
            (flying & valid & ~jnp.asarray(input.finite), FAULT, NOT_FINITE),
        ]
        mode, cause = s.mode, s.cause
        for holds, to, why in rows:
            mode, cause = jnp.where(holds, to, mode), jnp.where(holds, why, cause)
        return mode.astype(np.int32), cause.astype(np.int32)

    def _output(self, t: Any, s: SupervisorState, check: Any, valid: Any) -> SupervisorOutput:
        goes_on = jnp.where(s.cause == LINK, self.link_continue, self.stale_continue)
        carried = (s.mode == LOST) & (s.back == FLYING) & (t - s.since < goes_on) & valid
        law = (s.mode == FLYING) | carried
        sends = (s.mode == FLYING) | (s.mode == HOLD) | (s.mode == LOST)
        return SupervisorOutput(
            mode=s.mode,
            cause=s.cause,
            transitions=s.transitions,
            refused=s.refused,
            refusals=s.refusals,
            check=check,
            law=law,
            sends=sends,
        )

    def _first_failing_check(self, estimate: Estimate, silent: Any, stale: Any, sick: Any) -> Any:
        """Return the index, in CHECKS, of the first check that fails, or 0 ("passed") if all checks pass."""
        outside = self._is_breached("envelope", estimate.state) | self._is_breached("geofence", estimate.state)
        failed = (~jnp.asarray(estimate.valid), stale, silent, outside, sick)
        first = jnp.asarray(0)
        for k in range(len(failed), 0, -1):
            first = jnp.where(failed[k - 1], k, first)
        return first.astype(np.int32)

    def _is_breached(self, kind: str, state: Any) -> Any:
        outside = jnp.asarray(False)
        for limit in self.limits:
            outside = outside | (limit.is_breached(state) if limit.kind == kind else False)
        return outside

    def _is_sick(self, state: Any) -> Any:
        sick = jnp.asarray(False)
        for path in self.healthy:
            sick = sick | jnp.any(jnp.asarray(functools.reduce(getattr, path.split("."), state)) != 0)
        return sick


def _pilot_request(pilot: Sample | None) -> Any:
    """Return the pilot's request at this instant, or NO_REQUEST if the sample is not new."""
    if pilot is None:
        return jnp.asarray(NO_REQUEST)
    known = (pilot.value.request >= 0) & (pilot.value.request < len(REQUESTS))
    return jnp.where(pilot.fresh & pilot.valid & known, pilot.value.request, NO_REQUEST)

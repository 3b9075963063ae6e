"""Supervisor: whether the autopilot may fly, what it does when it may not, and why. An optional part of the Autopilot.

Source: docs page, Supervisor.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.actuators.drive import DriveCommand
from trimtab.core.errors import InputError, closest
from trimtab.core.record import Scalar, leaves, option, part, period, quantity, record
from trimtab.core.signals import Estimate, Frame, Sample
from trimtab.core.time import FOREVER, ms, seconds, show
from trimtab.loop.flight_limit import Limit
from trimtab.loop.supervision import (
    ARM,
    ARMED,
    AUTOMATIC,
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
    SupervisorInput,
    SupervisorOutput,
    SupervisorState,
)


@record
class Supervisor:
    """Lets the law's command through, sends neutral instead, or no valid command at all.

        standby  --arm, checks passed-->  flying  <--hold, resume-->  hold  (neutral)
        flying, hold  --link or estimate too old-->  lost: go on, then neutral, then ended
        flying, hold, lost  --limit; flying: estimate, health, no number-->  fault       any of them  --end-->  ended
        fault, ended  --clear-->  standby

    Fault and ended send no valid command, and stay until somebody clears them. The whole table: docs page.

    Frames:  the estimate's.
    Not modelled: the battery.
    Source:  docs page, Supervisor; modes and times are this project's.
    """

    neutral: Any = part("Value of a command that holds still.", default=DriveCommand(1.5e-3, 0.0))
    limits: tuple[Limit, ...] = part("Geofence and speed envelope.", default=())
    stale_age: Scalar = quantity("s", "Oldest estimate that is flown on.", default=0.4, above=0)
    link_timeout: int = period("Longest silence of all sensors.", default=ms(200))
    link_continue: int = period("Link lost: for how long the law goes on.", default=ms(300), low=0)
    link_end: int = period("Link lost: after how long the flight is ended.", default=seconds(5))
    stale_continue: int = period("Estimate stale: for how long the law goes on.", default=ms(300), low=0)
    stale_end: int = period("Estimate stale: after how long the flight is ended.", default=seconds(5))
    healthy: tuple[str, ...] = option("Paths of flags and counters of the estimate that must be zero.", default=())
    pilot: str = option("Name of the sample with requests.", default="pilot")
    automatic: bool = option("Whether it arms by itself as soon as checks pass.", default=False, choices=(True, False))

    def check(self) -> None:
        """Refuse times that leave no room for neutral."""
        for what in ("link", "stale"):
            goes_on, end = getattr(self, f"{what}_continue"), getattr(self, f"{what}_end")
            if end <= goes_on:
                problem = f"{show(end)} is not later than {what}_continue, {show(goes_on)}"
                raise InputError(f"{what}_end", problem, fix="make it longer, so that neutral comes between")

    def fitted(self, estimate: Estimate, value: Any, frame: Frame) -> Any:
        """The neutral value in the types of the allocation's; refuses an autopilot that this supervisor doesn't fit."""
        if self.pilot not in frame.samples and not self.automatic:
            problem = f"nobody can ask it to arm: the frame has no sample {self.pilot!r}"
            fix = f'add sensors={{"{self.pilot}": PilotScript(…)}} to the world, or set automatic=True'
            raise InputError("autopilot.supervisor.pilot", problem, choices=tuple(frame.samples), fix=fix)
        known = [path for path, _, _ in leaves(estimate.state)]
        for path in (*(name for limit in self.limits for name in limit.fields), *self.healthy):
            if path not in known:
                near = closest(path, known, 1) or known[:1]
                problem = f"the estimate has no {path!r}"
                raise InputError("autopilot.supervisor", problem, choices=known, fix=f"write {near[0]!r}")
        if jax.tree.structure(self.neutral) != jax.tree.structure(value):
            problem = f"neutral is a {type(self.neutral).__name__}, the allocation gives a {type(value).__name__}"
            raise InputError("autopilot.supervisor", problem, fix=f"give neutral={type(value).__name__}(…)")
        return jax.tree.map(lambda n, v: jnp.asarray(n, jnp.result_type(v)), self.neutral, value)

    def init(self) -> SupervisorState:
        """On standby."""
        none, now = np.int32(0), np.int64(-FOREVER)
        return SupervisorState(
            mode=none, cause=none, since=now, back=none, heard=now, refused=none, refusals=none, transitions=none
        )

    def step(self, t: Any, s: SupervisorState, given: SupervisorInput) -> tuple[SupervisorState, SupervisorOutput]:
        """The mode from integer time t on."""
        heard = jnp.where(given.arrived, t, s.heard)
        silent = t - heard >= self.link_timeout
        stale = ~(given.estimate.age <= self.stale_age)
        sick = self._is_sick(given.estimate.state)
        check = self._check(given.estimate, silent, stale, sick)
        asked = _asked(given.pilot)
        mode, cause = self._next(t, s, given, asked, silent, stale, sick, check)
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
            heard=heard,
            refused=jnp.where(refused, jnp.where(sensible, check, len(CHECKS) - 1), s.refused).astype(np.int32),
            refusals=(s.refusals + refused).astype(np.int32),
            transitions=(s.transitions + changed).astype(np.int32),
        )
        return new, self._output(t, new, check, given.estimate.valid)

    def _next(
        self,
        t: Any,
        s: SupervisorState,
        given: SupervisorInput,
        asked: Any,
        silent: Any,
        stale: Any,
        sick: Any,
        check: Any,
    ) -> tuple[Any, Any]:
        """Mode and cause after this instant: the rows of the docs page's table; the last that holds counts."""
        valid = jnp.asarray(given.estimate.valid)
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
            (under_way & valid & self._breached("envelope", given.estimate.state), FAULT, SPEED),
            (under_way & valid & self._breached("geofence", given.estimate.state), FAULT, FENCE),
            (flying & valid & ~jnp.asarray(given.finite), FAULT, NOT_FINITE),
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

    def _check(self, estimate: Estimate, silent: Any, stale: Any, sick: Any) -> Any:
        """The first check that fails; 0 when all pass."""
        outside = self._breached("envelope", estimate.state) | self._breached("geofence", estimate.state)
        failed = (~jnp.asarray(estimate.valid), stale, silent, outside, sick)
        found = jnp.asarray(0)
        for k in range(len(failed), 0, -1):
            found = jnp.where(failed[k - 1], k, found)
        return found.astype(np.int32)

    def _breached(self, kind: str, state: Any) -> Any:
        found = jnp.asarray(False)
        for limit in self.limits:
            found = found | (limit.breached(state) if limit.kind == kind else False)
        return found

    def _is_sick(self, state: Any) -> Any:
        found = jnp.asarray(False)
        for path in self.healthy:
            value = state
            for name in path.split("."):
                value = getattr(value, name)
            found = found | jnp.any(jnp.asarray(value) != 0)
        return found


def _asked(pilot: Sample | None) -> Any:
    """The request of this instant; none from a sample that is not new."""
    if pilot is None:
        return jnp.asarray(NO_REQUEST)
    known = (pilot.value.request >= 0) & (pilot.value.request < len(REQUESTS))
    return jnp.where(pilot.fresh & pilot.valid & known, pilot.value.request, NO_REQUEST)

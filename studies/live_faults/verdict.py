"""Verdict on a vehicle's safety by its own log, every millisecond, without the firmware's code.

All times are those of the log, so a busy machine cannot change a verdict.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from trimtab.actuators.failsafe import CAUSES, MODES
from trimtab.logs.log import Log

DISARMED, COMPUTER, MANUAL, FAILSAFE = range(4)
SILENCE_S, LIFT_S, SERVO_S, ROW_S = 0.25, 1.0, 0.02, 0.0015
"""Longest time without a command before failsafe, time until the lift fan stops, servo frame, 1.5 log rows (s)."""
GAP_S = 0.01
"""Longest time between two rows of a log without a gap (s)."""
BOUNDS = {"truth.surge_velocity": 2.5, "truth.sway_velocity": 2.5, "truth.yaw_rate": 6.0}
"""Signal -> largest magnitude of a vehicle in flight, in m/s or rad/s."""
REASONS = {CAUSES.index(c) for c in ("arm request", "disarm request", "takeover", "no command since arming")}
"""Causes that may end failsafe, or an armed time without failsafe."""


def mode_stays(log: Log) -> list[tuple[int, int, int, int]]:
    """Return each interval with a constant mode: mode, cause, first row, row after the last."""
    mode, cause = log["firmware.mode"].astype(int), log["firmware.cause"].astype(int)
    edges = [0, *(np.flatnonzero(np.diff(mode) | np.diff(cause)) + 1).tolist(), len(mode)]
    return [(mode[a], cause[a], a, b) for a, b in pairwise(edges)]


def find_violations(log: Log, *, broken: tuple[float, float] | None = None, whole: bool = True) -> list[str]:
    """Return the violated rules (empty for a safe vehicle).

    Args:
        log: log of the vehicle.
        broken: start and end (s) of an injected fault of the actuators, during which they ignore commands.
        whole: True requires a complete log; False judges only the rows that exist.
    """
    found = [
        *_check_force(log, broken),
        *_check_commands(log),
        *_check_lift(log),
        *_check_latch(log),
        *_check_bounds(log),
    ]
    return [*found, *_check_gaps(log), *_check_end(log)] if whole else found


def _check_gaps(log: Log) -> list[str]:
    """Return the longest gap of the log, if it exceeds GAP_S."""
    steps = np.diff(log.t, prepend=log.t[0])
    return (
        [f"the log has a gap of {steps.max():.3f} s at {log.t[np.argmax(steps)]:.3f} s"] if steps.max() > GAP_S else []
    )


def _force_magnitude(log: Log) -> Any:
    return np.hypot(log["actuators.u.FX"], log["actuators.u.FY"])


def _check_force(log: Log, broken: tuple[float, float] | None) -> list[str]:
    """Return violations: forces without a command."""
    t, force = log.t, _force_magnitude(log)
    sound = np.ones(len(t), bool) if broken is None else (t < broken[0]) | (t > broken[1] + 2 * SERVO_S)
    found = []
    for mode, cause, a, b in mode_stays(log):
        if mode in (DISARMED, FAILSAFE):
            rows = np.arange(a, b)[(t[a:b] > t[a] + SERVO_S + ROW_S) & sound[a:b]]
            if len(rows) and force[rows].max() > 0:
                worst = rows[np.argmax(force[rows])]
                found.append(f"{force[worst]:.2f} N at {t[worst]:.3f} s, {MODES[mode]} ({CAUSES[cause]})")
    return found


def _check_commands(log: Log) -> list[str]:
    """Return violations: gaps of over 250 ms between accepted commands in flight."""
    steps = np.diff(log.t, prepend=log.t[0])
    seen = np.cumsum(np.where(steps > GAP_S, 0.0, steps))
    came = log["firmware.command.fresh"] & (np.diff(log["firmware.rejected"], prepend=0) == 0)
    found = []
    for mode, _, a, b in mode_stays(log):
        times = seen[a:b][came[a:b]]
        if mode == COMPUTER and len(times):
            gap = np.diff(np.append(times, seen[b - 1])).max()
            if gap > SILENCE_S + ROW_S:
                found.append(f"flew on through {gap * 1e3:.0f} ms without a command")
    return found


def _check_lift(log: Log) -> list[str]:
    """Return violations: lift that lasts over a second after a failsafe, or any lift after disarming."""
    t, lift, found, since = log.t, log["firmware.lift"], [], None
    for mode, _, a, b in mode_stays(log):
        since = (t[a] if since is None else since) if mode == FAILSAFE else None
        limit = t[a] if mode == DISARMED else None if since is None else since + LIFT_S
        if limit is not None and lift[a:b][t[a:b] > limit + ROW_S].any():
            found.append(f"the lift fan turned {t[a:b][lift[a:b]].max() - limit:.3f} s too long")
    return found


def _check_latch(log: Log) -> list[str]:
    """Return violations: ends of failsafe that no request caused."""
    found, before = [], None
    for mode, cause, a, _ in mode_stays(log):
        if before == FAILSAFE and mode != FAILSAFE and cause not in REASONS:
            found.append(f"left failsafe at {log.t[a]:.3f} s by {CAUSES[cause]}")
        before = mode
    return found


def _check_end(log: Log) -> list[str]:
    mode = int(log["firmware.mode"][-1])
    still = _force_magnitude(log)[-1] == 0 and not log["firmware.lift"][-1]
    return (
        []
        if mode in (DISARMED, FAILSAFE) and still
        else [f"at the end: {MODES[mode]}, {_force_magnitude(log)[-1]:.2f} N"]
    )


def _check_bounds(log: Log) -> list[str]:
    found = []
    for path, limit in BOUNDS.items():
        worst = float(np.abs(log[path]).max())
        if not worst <= limit:
            found.append(f"{path.removeprefix('truth.').replace('_', ' ')} reached {worst:.2f}")
    return found


def describe_course(log: Log) -> str:
    """Describe what the vehicle did."""
    said, t = [], log.t
    for mode, cause, a, b in mode_stays(log)[1:]:
        said.append(
            f"{MODES[mode]} ({CAUSES[cause]}) after {t[a] - _first_arming_time(log):.2f} s" if said else "armed"
        )
        if mode == FAILSAFE:
            lift = t[a:b][log["firmware.lift"][a:b]]
            if len(lift) and b - a > len(lift):
                said.append(f"lift fan off {lift[-1] - t[a]:.2f} s later")
    surge = np.abs(log["truth.surge_velocity"]).max()
    return f"{'; '.join(said) or 'never armed'}; surge speed at most {surge:.2f} m/s"


def _first_arming_time(log: Log) -> float:
    """Return the time of the first arming."""
    changed = mode_stays(log)
    return float(log.t[changed[1][2]]) if len(changed) > 1 else 0.0


def failsafe_causes(log: Log) -> list[str]:
    """Return the causes of the failsafes."""
    modes = [(mode, cause) for mode, cause, _, _ in mode_stays(log)]
    return [CAUSES[c] for (m, c), (p, _) in zip(modes[1:], modes, strict=False) if m == FAILSAFE and p != FAILSAFE]

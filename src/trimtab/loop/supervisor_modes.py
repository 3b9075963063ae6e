"""Names and numbers of the supervisor's modes, requests, causes and checks, and the requests possible in each mode.

This module needs no JAX, so that programs that only show a flight start fast.

Source: docs page, Supervisor; the modes are defined by trimtab.
"""

MODES = ("standby", "flying", "hold", "lost", "fault", "ended")
STANDBY, FLYING, HOLD, LOST, FAULT, ENDED = range(len(MODES))
REQUESTS = ("none", "arm", "hold", "resume", "end", "clear")
NO_REQUEST, ARM, TO_HOLD, RESUME, END, CLEAR = range(len(REQUESTS))
CAUSES = (
    "start",
    "arm request",
    "automatic",
    "hold request",
    "resume request",
    "end request",
    "clear request",
    "command not finite",
    "geofence",
    "speed envelope",
    "estimate not valid",
    "sensor health",
    "link lost",
    "estimate stale",
    "found again",
    "lost for too long",
)
(START, ARMED, AUTOMATIC, HELD, RESUMED, ENDED_BY, CLEARED, NOT_FINITE, FENCE, SPEED, NO_ESTIMATE, HEALTH) = range(12)
LINK, STALE, FOUND, TOO_LONG = range(12, len(CAUSES))
CHECKS = ("passed", "estimate not valid", "estimate stale", "link silent", "outside limits", "sensor health", "mode")
"""Checks that can refuse a request to arm or to resume. "mode" means that the request is not possible in this mode."""


def explain_requests(mode: int, check: int) -> dict[str, str]:
    """Return, for each request, the reason for which it would have no effect in a mode, or "" if it is possible.

    Args:
        mode: mode of the supervisor.
        check: number, in CHECKS, of the check that would refuse a request to arm.
    """
    objection = CHECKS[check] if check else ""
    name, under_way = MODES[mode], mode in (FLYING, HOLD, LOST)
    last = "send a clear request first" if mode in (FAULT, ENDED) else f"the mode is already {name}"
    return {
        "arm": objection if mode == STANDBY else last,
        "hold": "" if mode in (FLYING, LOST) else f"the mode is {name}, not flying",
        "resume": objection if mode == HOLD else f"the mode is {name}, not hold",
        "end": "" if under_way else f"the mode is {name}, not in flight",
        "clear": "" if mode in (FAULT, ENDED) else f"nothing to clear in mode {name}",
    }

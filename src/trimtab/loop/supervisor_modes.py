"""Supervisor's modes, requests, causes of mode changes and checks, as names and numbers.

The module also defines which requests are possible in each mode. It does not import JAX, so that programs that only
show a flight start fast.

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
"""Results of the checks before a request to arm or to resume. A result other than "passed" is the reason for a refusal.
"mode": the request is not possible in the present mode."""


def explain_requests(mode: int, check: int) -> dict[str, str]:
    """Return, for each request, the reason why the supervisor would refuse or ignore the request, or "" if possible.

    Args:
        mode: present mode of the supervisor, as an index in MODES.
        check: index, in CHECKS, of the check that would refuse a request to arm, or 0 if all checks pass.
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

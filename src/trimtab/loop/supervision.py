"""What a supervisor is asked, knows and says: modes, causes, requests and checks, and the records that carry them."""

from typing import Any

from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Estimate

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
"""What refused a request to arm or to resume; "mode": it makes no sense in this mode."""


@record
class PilotRequest:
    """What a pilot asks of the supervisor; a new sample is a new request. Frames: none. Source: docs page."""

    request: Scalar = quantity("1", "What to do.", kind="mode", modes=REQUESTS)


@record
class SupervisorInput:
    """What the supervisor judges. Frames: the estimate's. Source: docs page, Supervisor."""

    estimate: Estimate = part("The estimate of this instant.")
    arrived: Scalar = quantity("1", "Whether a new sample came over the link.", kind="flag")
    finite: Scalar = quantity("1", "Whether the command that the law asks for is a number.", kind="flag")
    pilot: Any = part("Sample of a PilotRequest; None where nobody asks.", default=None)


@record
class SupervisorState:
    """What the supervisor remembers. Frames: none. Source: docs page, Supervisor."""

    mode: Scalar = quantity("1", "What it does.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Why the mode was entered.", kind="mode", modes=CAUSES)
    since: Scalar = quantity("100 ns", "When the mode was entered.", kind="time")
    back: Scalar = quantity("1", "Where to go when what was lost is found.", kind="mode", modes=MODES)
    heard: Scalar = quantity("100 ns", "When a sample last came over the link.", kind="time")
    refused: Scalar = quantity("1", "Why the last request was refused.", kind="mode", modes=CHECKS)
    refusals: Scalar = quantity("1", "How many requests were.", kind="count")
    transitions: Scalar = quantity("1", "How often the mode has changed.", kind="count")


@record
class SupervisorOutput:
    """What the supervisor says. Frames: none. Source: docs page, Supervisor."""

    mode: Scalar = quantity("1", "What it does.", kind="mode", modes=MODES)
    cause: Scalar = quantity("1", "Why the mode was entered.", kind="mode", modes=CAUSES)
    transitions: Scalar = quantity("1", "How often the mode has changed.", kind="count")
    refused: Scalar = quantity("1", "Why the last request was refused.", kind="mode", modes=CHECKS)
    refusals: Scalar = quantity("1", "How many requests were.", kind="count")
    check: Scalar = quantity("1", "What would refuse to arm now.", kind="mode", modes=CHECKS)
    law: Scalar = quantity("1", "Whether the law's command is sent.", kind="flag")
    sends: Scalar = quantity("1", "Whether a command is sent at all: the law's, or neutral.", kind="flag")

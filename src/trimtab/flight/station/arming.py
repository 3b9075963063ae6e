"""Checks before arming, each with value, limit and advice, and the MAVLink messages by which an autopilot requests the
results.

The autopilot sends MAVLink's command MAV_CMD_RUN_PREARM_CHECKS (401). The vehicle acknowledges the command, reports
failing checks to ground stations, and sends the autopilot one TUNNEL message of a private type for each check:

    number of checks (2)  index (2)  flags (1)  value (8)  limit (8)  name, unit, advice (UTF-8, each ends with a 0)

Flags: 1 means that the value must be at least the limit (otherwise at most); 2 means that the check can pass by
waiting.
Source: https://mavlink.io/en/messages/common.html; docs page, Arming.
"""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.identity import TUNNEL, pack_tunnel

CHECK_TYPE = 0xF476
HEAD = struct.Struct("<HHBdd")
AT_LEAST, HEALS = 1, 2
MOST_TEXT = 128 - HEAD.size
MOST_CHECKS = 64
LONGEST_AGE = seconds(1)
"""Maximum age of the result of a check (100 ns)."""
ASK_PERIOD = ms(200)
MOST_ASKS = 10
"""Number of unanswered requests after which the vehicle is assumed to have no checks."""
UNBOUNDED = 1e9
"""Smallest magnitude that is shown as infinite, e.g. for the age of data that never arrived, or a limit that is not
set."""
CONFIRMATION = 21196
"""Value of the second parameter of the arming command by which MAVLink ground stations force arming.

For this vehicle, this value only means that the user confirms arming after a failsafe. The checks still have to pass.
"""


class ArmingCheck(NamedTuple):
    """Check before arming: `value` must be at most `limit`, or at least `limit` if `at_least` is True. A value that was
    not measured (NaN) passes.

    advice: what to do if the check fails.  heals: True if the check can pass by waiting, without any action.
    """

    name: str
    value: float
    limit: float
    unit: str = ""
    advice: str = ""
    at_least: bool = False
    heals: bool = True

    @property
    def passes(self) -> bool:
        """True if the check allows arming."""
        within = self.value >= self.limit if self.at_least else self.value <= self.limit
        return math.isnan(self.value) or within

    @property
    def value_text(self) -> str:
        """Text of the checked value and the value's unit."""
        return "not measured" if math.isnan(self.value) else _with_unit(self.value, self.unit)

    @property
    def limit_text(self) -> str:
        """Text of the check's limit and the limit's unit."""
        return f"at {'least' if self.at_least else 'most'} {_with_unit(self.limit, self.unit)}"

    @property
    def sentence(self) -> str:
        """Text of the problem and the advice, for pilot, ground station and log."""
        return f"{self.name}: {self.value_text}, {self.limit_text}; {self.advice}"

    @property
    def record(self) -> str:
        """Text of the check's result for a log, in one line."""
        return f"check {self.name}: {self.value_text}, {self.limit_text}: {'passed' if self.passes else 'refused'}"


def _with_unit(number: float, unit: str) -> str:
    if abs(number) >= UNBOUNDED:
        return f"{'-' * (number < 0)}∞ {unit}".rstrip()
    return f"{number:.3g} {unit}".rstrip() if abs(number) < 999.5 else f"{number:.0f} {unit}".rstrip()


def first_problem(checks: Sequence[ArmingCheck]) -> str:
    """Return the text of the first failing check, or "" if all checks pass. Checks that cannot pass by waiting are
    tried first."""
    failing = [c for c in checks if not c.passes]
    return min(failing, key=lambda c: c.heals).sentence if failing else ""


def pack_checks(endpoint: Endpoint, asker: Message, checks: Sequence[ArmingCheck]) -> list[bytes]:
    """Return a packet for each check, addressed to the sender of the request. asker: the request message."""
    packets = []
    for k, check in enumerate(checks):
        flags = AT_LEAST * check.at_least | HEALS * check.heals
        head = HEAD.pack(len(checks), k, flags, check.value, check.limit)
        text = b"".join(t.encode() + b"\0" for t in (check.name, check.unit, check.advice))[:MOST_TEXT]
        packets.append(pack_tunnel(endpoint, asker.system, asker.component, CHECK_TYPE, head + text))
    return packets


class RemoteChecks:
    """Results of the vehicle's checks that the autopilot has received, and timing of the requests for these results.

    Times `now` are by the autopilot's clock, in 100 ns.
    """

    def __init__(self) -> None:
        """Start without an answer of the vehicle."""
        self._checks: dict[int, tuple[ArmingCheck, int]] = {}
        self._count = self._asks = self._next = 0
        self.has_none = False
        """True if the vehicle reports no checks, because its firmware is older or it is already armed."""

    def is_due(self, now: int) -> bool:
        """Return True if the vehicle must be asked now for the results of its checks."""
        if self.has_none or now < self._next:
            return False
        self._next, self._asks = now + ASK_PERIOD, self._asks + 1
        self.has_none = not self._count and self._asks > MOST_ASKS
        return not self.has_none

    def handle_refusal(self) -> None:
        """Record that the vehicle refused to report the results of its checks."""
        self.has_none = not self._count

    def handle_message(self, message: Message, now: int) -> None:
        """Handle an answer of the vehicle. Other messages are ignored."""
        data = bytes(message.get("payload")[: message.get("payload_length")])
        if message.name != TUNNEL or message.get("payload_type") != CHECK_TYPE or len(data) < HEAD.size:
            return
        count, index, flags, value, limit = HEAD.unpack_from(data)
        if not 0 <= index < count <= MOST_CHECKS:
            return
        name, unit, advice, *_ = [*data[HEAD.size :].decode("utf-8", "replace").split("\0"), "", "", ""]
        self._count = count
        check = ArmingCheck(name, value, limit, unit, advice, bool(flags & AT_LEAST), bool(flags & HEALS))
        self._checks[index] = check, now

    def current(self, now: int) -> list[ArmingCheck]:
        """Return all checks of the vehicle, or an empty list while a check is missing or older than a second."""
        recent = [check for k, (check, t) in sorted(self._checks.items()) if k < self._count and now - t <= LONGEST_AGE]
        return recent if len(recent) == self._count else []

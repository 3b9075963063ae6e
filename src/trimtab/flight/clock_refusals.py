"""Answers of a vehicle to a peer with a wrong clock or a wrong signing key, and messages for the user.

If the vehicle refuses a frame because of its time stamp, it sends one TIMESYNC message to the frame's sender, at most
five times a second. A peer whose clock is behind can then correct its time stamps. A peer with the vehicle's own system
id gets the same answer if it asks for the time with another key or without a key, as `fly` does. The peer can then
report the problem. Peers whose frames are refused get no other message. Ground stations without the key get no message
at all.
Source: docs page, Signing.
"""

from collections.abc import Callable

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.endpoint import Endpoint, UntimelyMessage
from trimtab.flight.mavlink.time_sync import NS_PER_UNIT

ANSWER_PERIOD = ms(200)
REPORT_PERIOD = seconds(10)


class RefusalAnswers:
    """Sender of answers to frames that an endpoint refused. Times `now` are by the vehicle's clock, in 100 ns."""

    def __init__(self, endpoint: Endpoint, link: Link, tell: Callable[[str], None]) -> None:
        """tell: function that receives the messages for the user."""
        self._endpoint, self._link, self._tell = endpoint, link, tell
        self._answer_time = self._strangers = 0
        self._report_times: dict[tuple[str, int, int], int] = {}

    def handle_refusals(self, now: int) -> None:
        """Answer and report the frames that were refused since the last call. Call this after each `feed` of the
        endpoint."""
        endpoint, counts = self._endpoint, self._endpoint.counts
        for untimely in endpoint.untimely:
            message = untimely.message
            self._report(now, (describe_lead(untimely.lead), message.system, message.component), untimely)
            self._answer(now, message.get("ts1") if message.name == "TIMESYNC" and not message.get("tc1") else 0)
        strangers = counts.wrong_signature + counts.unsigned
        if strangers != self._strangers:
            self._strangers = strangers
            self._report(now, ("key", 0, 0))
            if endpoint.is_asked_by_stranger:
                self._answer(now, 0)

    def _answer(self, now: int, asked: int) -> None:
        if now >= self._answer_time:
            self._answer_time = now + ANSWER_PERIOD
            self._link.reply(self._endpoint.pack("TIMESYNC", {"tc1": now * NS_PER_UNIT or 1, "ts1": asked}))

    def _report(self, now: int, about: tuple[str, int, int], untimely: UntimelyMessage | None = None) -> None:
        if now < self._report_times.get(about, 0):
            return
        self._report_times = {k: t for k, t in self._report_times.items() if t > now} | {about: now + REPORT_PERIOD}
        what, system, component = about
        if untimely is None:
            self._tell(f"refused: {self._strangers} frames so far were unsigned or signed with another key")
        else:
            self._tell(
                f"refused: the clock of {system}/{component} is {abs(untimely.lead):.1f} s {what} this computer's clock"
            )


def describe_lead(lead: float) -> str:
    """Return "ahead of" if the lead of a clock (s) is positive, otherwise "behind"."""
    return "ahead of" if lead > 0 else "behind"

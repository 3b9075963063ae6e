"""Whom a vehicle's packets go to: samples to its autopilot alone, all else to everybody who was heard.

A ground station takes what it doesn't know for noise, and a gap in the numbers for loss. So on a line that tells its
peers apart it gets no samples, and what it gets is numbered apart from what the autopilot gets.
Source: docs page, Vehicle; https://mavlink.io/en/guide/packet_loss.html.
"""

from collections.abc import Iterable, Sequence

from trimtab.core.interfaces import Audience, Link
from trimtab.core.time import seconds
from trimtab.wire.definitions import Message
from trimtab.wire.mavlink import Endpoint

AUTOPILOT_TIMEOUT = seconds(10)
"""After which samples are not sent any more where no autopilot has been heard."""
AUTOPILOT_MESSAGES = ("HEARTBEAT", "TIMESYNC")
"""By these, of the vehicle's own system, and by commands, an autopilot is known."""


class Broadcast:
    """A vehicle's end of a link. Times `now` are the vehicle's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, link: Link, commands: Sequence[str]) -> None:
        """commands: names of the messages that carry a command."""
        self._endpoint, self._link = endpoint, link
        self._names = {*AUTOPILOT_MESSAGES, *commands}
        self._autopilot_time = -2 * AUTOPILOT_TIMEOUT

    def accept_sender(self, messages: Sequence[Message], now: int) -> None:
        """Take note of who sent what was heard last; nothing accepted, nobody noted."""
        if not messages:
            return
        own = self._endpoint.system
        is_autopilot = any(m.system == own and m.name in self._names for m in messages)
        if is_autopilot:
            self._autopilot_time = now
        self._link.accept_sender(is_private=is_autopilot)

    def has_autopilot(self, now: int) -> bool:
        """Whether there is somebody to send samples to."""
        return now - self._autopilot_time <= AUTOPILOT_TIMEOUT

    def send_private(self, packets: Iterable[bytes]) -> None:
        """Send what is for the autopilot alone."""
        for packet in packets:
            self._link.send(packet, Audience.PRIVATE)

    def forward(self, message: Message) -> None:
        """Pass a message of the autopilot on to all others."""
        if self._link.has_audience(Audience.PUBLIC):
            self._link.send(self._endpoint.forward(message), Audience.PUBLIC)

    def send(self, packet: bytes) -> bool:
        """Send to everybody; whether anybody got it."""
        is_taken = False
        if self._link.has_audience(Audience.PRIVATE):
            is_taken = self._link.send(packet, Audience.PRIVATE)
        if self._link.has_audience(Audience.PUBLIC):
            is_taken |= self._link.send(self._endpoint.repack(packet), Audience.PUBLIC)
        return is_taken

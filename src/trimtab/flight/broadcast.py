"""Receivers of a vehicle's packets: samples for its autopilot alone, everything else for all peers.

A ground station treats unknown messages as noise, and a gap in the sequence numbers as loss. So on a link that
distinguishes its peers it gets no samples, and its packets are numbered separately from the autopilot's.
Source: docs page, Vehicle; https://mavlink.io/en/guide/packet_loss.html.
"""

from collections.abc import Iterable, Sequence

from trimtab.core.interfaces import Audience, Link
from trimtab.core.time import seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint

AUTOPILOT_TIMEOUT = seconds(10)
"""Time without an autopilot after which samples are no longer sent."""
AUTOPILOT_MESSAGES = ("HEARTBEAT", "TIMESYNC")
"""Messages of the vehicle's own system that identify an autopilot, besides commands."""


class Broadcast:
    """Vehicle's end of a link. Times `now` are the vehicle's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, link: Link, commands: Sequence[str]) -> None:
        """commands: names of the messages that carry a command."""
        self._endpoint, self._link = endpoint, link
        self._names = {*AUTOPILOT_MESSAGES, *commands}
        self._autopilot_time = -2 * AUTOPILOT_TIMEOUT

    def accept_sender(self, messages: Sequence[Message], now: int) -> None:
        """Store the sender of the last messages, unless no message was accepted."""
        if not messages:
            return
        own = self._endpoint.system
        is_autopilot = any(m.system == own and m.name in self._names for m in messages)
        if is_autopilot:
            self._autopilot_time = now
        self._link.accept_sender(is_private=is_autopilot)

    def has_autopilot(self, now: int) -> bool:
        """Return whether there is an autopilot to send samples to."""
        return now - self._autopilot_time <= AUTOPILOT_TIMEOUT

    def send_private(self, packets: Iterable[bytes]) -> None:
        """Send packets to the autopilot alone."""
        for packet in packets:
            self._link.send(packet, Audience.PRIVATE)

    def forward(self, message: Message) -> None:
        """Forward a message of the autopilot to all other peers."""
        if self._link.has_audience(Audience.PUBLIC):
            self._link.send(self._endpoint.forward(message), Audience.PUBLIC)

    def send(self, packet: bytes) -> bool:
        """Send to all peers. Return whether any peer got the packet."""
        is_taken = False
        if self._link.has_audience(Audience.PRIVATE):
            is_taken = self._link.send(packet, Audience.PRIVATE)
        if self._link.has_audience(Audience.PUBLIC):
            is_taken |= self._link.send(self._endpoint.repack(packet), Audience.PUBLIC)
        return is_taken

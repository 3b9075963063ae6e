"""Distribution of a vehicle's packets: samples go to its autopilot only, all other packets to all peers of the link.

A ground station counts unknown messages as noise, and a gap in the sequence numbers as loss. So on a link that can send
to each peer separately, a ground station gets no samples, and the packets for ground stations are numbered separately.
Source: docs page, Vehicle; https://mavlink.io/en/guide/packet_loss.html.
"""

from collections.abc import Iterable, Sequence

from trimtab.core.interfaces import Audience, Link
from trimtab.core.time import seconds
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint

AUTOPILOT_TIMEOUT = seconds(10)
"""Time (100 ns) without a message from an autopilot after which samples are no longer sent."""
AUTOPILOT_MESSAGES = ("HEARTBEAT", "TIMESYNC")
"""Messages by which a vehicle recognises its autopilot. A sender counts as the autopilot if it uses the system id of
the vehicle, and sends one of these messages or a command."""


class Broadcast:
    """Distributor of a vehicle's packets to the peers of its link. Times `now` are by the vehicle's clock, in 100
    ns."""

    def __init__(self, endpoint: Endpoint, link: Link, commands: Sequence[str]) -> None:
        """commands: names of the messages that carry a command."""
        self._endpoint, self._link = endpoint, link
        self._names = {*AUTOPILOT_MESSAGES, *commands}
        self._autopilot_time = -2 * AUTOPILOT_TIMEOUT

    def accept_sender(self, messages: Sequence[Message], now: int) -> None:
        """Accept the sender of the given messages as a peer of the link. Without messages, do nothing."""
        if not messages:
            return
        own = self._endpoint.system
        is_autopilot = any(m.system == own and m.name in self._names for m in messages)
        if is_autopilot:
            self._autopilot_time = now
        self._link.accept_sender(is_private=is_autopilot)

    def has_autopilot(self, now: int) -> bool:
        """Return True if an autopilot has sent a message within AUTOPILOT_TIMEOUT. Otherwise no samples are sent."""
        return now - self._autopilot_time <= AUTOPILOT_TIMEOUT

    def send_private(self, packets: Iterable[bytes]) -> None:
        """Send packets to the autopilot only."""
        for packet in packets:
            self._link.send(packet, Audience.PRIVATE)

    def forward(self, message: Message) -> None:
        """Forward a message of the autopilot to all other peers."""
        if self._link.has_audience(Audience.PUBLIC):
            self._link.send(self._endpoint.forward(message), Audience.PUBLIC)

    def send(self, packet: bytes) -> bool:
        """Send a packet to all peers. Return True if it was sent to at least one peer."""
        is_taken = False
        if self._link.has_audience(Audience.PRIVATE):
            is_taken = self._link.send(packet, Audience.PRIVATE)
        if self._link.has_audience(Audience.PUBLIC):
            is_taken |= self._link.send(self._endpoint.repack(packet), Audience.PUBLIC)
        return is_taken

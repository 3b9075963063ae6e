"""What a link counts while it carries."""

from trimtab.core.interfaces import LinkStatistics


class Counts:
    """Counters of one link since it was opened."""

    def __init__(self) -> None:
        self.bytes_in = self.bytes_out = self.packets_in = self.packets_out = self.dropped = 0
        self.connections = 0

    def received(self, packet: bytes) -> bytes:
        """A packet came in; it is given back."""
        self.bytes_in += len(packet)
        self.packets_in += 1
        return packet

    def sent(self, size: int) -> bool:
        """A packet of this size went out: True."""
        self.bytes_out += size
        self.packets_out += 1
        return True

    def drop(self) -> bool:
        """A packet could not be sent: False."""
        self.dropped += 1
        return False

    def statistics(self, connected: bool) -> LinkStatistics:
        """All of it, as it stands; every connection after the first is a reconnection."""
        again = max(self.connections - 1, 0)
        into, out = (self.bytes_in, self.bytes_out), (self.packets_in, self.packets_out)
        return LinkStatistics(*into, *out, self.dropped, again, connected)

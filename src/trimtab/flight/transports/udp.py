"""Link over UDP datagrams, ``udp://HOST:PORT``. The listening end sends to all peers that were accepted in the last ten
seconds."""

import contextlib
import socket
from typing import Any, Protocol

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Audience, LinkStatistics
from trimtab.flight.transports.open_link import Address
from trimtab.flight.transports.reconnecting_stream import LinkCounters, configure_socket
from trimtab.flight.transports.tcp import bind_socket, resolve_host

HEARD_WITHIN = 10 * NS_PER_SECOND
"""Time (ns) after the last accepted packet of a peer for which the peer counts as connected and packets are sent to
it."""
MOST_PEERS = 16
"""Maximum number of peers. A new sender never evicts a known one."""
LARGEST = 65535


def open_udp(address: Address, *, listen: bool = False) -> "UdpLink":
    """Connect to one peer, and receive packets only from this peer. With `listen`, listen for peers. Only programs on
    this machine can send, unless the address has a host."""
    address.validate_options()
    family, place = resolve_host(address, socket.SOCK_DGRAM)
    if listen:
        return UdpLink(configure_socket(bind_socket(address, socket.socket(family, socket.SOCK_DGRAM), place)))
    connected = configure_socket(socket.socket(family, socket.SOCK_DGRAM))
    try:
        connected.connect(place)
    except OSError as error:
        connected.close()
        raise address.input_error(f"no route to this address ({error.strerror})") from None
    return UdpLink(connected, place)


class DatagramSocket(Protocol):
    """Interface of a datagram socket for UdpLink: a socket of the system's kernel, or of a virtual network."""

    def fileno(self) -> int:
        """Return the file descriptor, or -1 once the socket is closed."""
        ...

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        """Return the next packet and the address of the packet's sender. Raise BlockingIOError if no packet has
        arrived."""
        ...

    def send(self, packet: bytes, /) -> int:
        """Send a packet to the peer to which the socket is connected. Return the number of sent bytes."""
        ...

    def sendto(self, packet: bytes, address: Any, /) -> int:
        """Send a packet to an address. Return the number of sent bytes."""
        ...

    def close(self) -> None:
        """Close the socket."""
        ...


class UdpLink:
    """Link over UDP to one peer, or to all recently accepted peers. One thread receives, and another thread may send.

    Any machine can send packets to a listening socket. If a packet is valid, the caller accepts its sender by
    `accept_sender`. The link sends only to accepted peers, so that a stranger without the key gets no data.

    Args:
        endpoint: non-blocking socket, listening or connected to `peer`.
        peer: only peer of the link, or None to send to all accepted peers.
        clock: clock by which the link waits.
    """

    def __init__(self, endpoint: DatagramSocket, peer: Any = None, clock: Clock = SYSTEM_CLOCK) -> None:
        self._socket, self._counts, self._fixed = endpoint, LinkCounters(), peer is not None
        self._clock = clock
        self._heard: dict[Any, int] = {}
        self._private: dict[Any, int] = {}
        self._latest: Any = None
        self._sender: Any = None

    @property
    def statistics(self) -> LinkStatistics:
        """Return the statistics of the link. connected: True if a peer was accepted in the last ten seconds."""
        return self._counts.statistics(bool(self.peers))

    @property
    def peers(self) -> tuple[Any, ...]:
        """Return the addresses of peers accepted in the last ten seconds."""
        oldest = self._clock.monotonic_ns() - HEARD_WITHIN
        return tuple(peer for peer, at in list(self._heard.items()) if at >= oldest)

    @property
    def sender(self) -> Any:
        """Return the address of the sender of the last received packet, or None before the first packet."""
        return self._sender

    def receive(self, timeout: float) -> bytes | None:
        """Return the next packet, or None after `timeout` seconds without a packet."""
        deadline = self._clock.monotonic_ns() + timeout * NS_PER_SECOND
        while self._socket.fileno() >= 0:
            left = max((deadline - self._clock.monotonic_ns()) / NS_PER_SECOND, 0.0)
            with contextlib.suppress(OSError):
                if self._clock.wait(self._socket, left):
                    packet, peer = self._socket.recvfrom(LARGEST)
                    if packet:
                        self._latest = self._sender = peer
                        if self._fixed:  # the socket receives packets of this peer only
                            self.accept_sender()
                        return self._counts.count_received(packet)
            if self._clock.monotonic_ns() >= deadline:
                return None
        return None

    def send(self, packet: bytes, audience: Audience = Audience.ALL) -> bool:
        """Send a packet to the only peer, or to all accepted peers of the audience. Return False if the packet was sent
        to no peer."""
        taken = sum([self._send_to(packet, peer) for peer in self._peers_of(audience)])
        return self._counts.count_sent(len(packet)) if taken else self._counts.count_dropped()

    def has_audience(self, audience: Audience) -> bool:
        """Return True if a peer of the audience was accepted in the last ten seconds."""
        return bool(self._peers_of(audience))

    def _peers_of(self, audience: Audience) -> tuple[Any, ...]:
        """Return the addresses of the peers in an audience. The address None means the peer to which the socket is
        connected."""
        if self._fixed:
            return () if audience is Audience.PUBLIC else (None,)
        if audience is Audience.ALL:
            return self.peers
        oldest = self._clock.monotonic_ns() - HEARD_WITHIN
        private = {peer for peer, at in list(self._private.items()) if at >= oldest}
        return tuple(peer for peer in self.peers if (peer in private) == (audience is Audience.PRIVATE))

    def accept_sender(self, *, is_private: bool = False) -> None:
        """Accept the sender of the last received packet as a peer, unless MOST_PEERS peers are already connected."""
        peer, self._latest = self._latest, None
        if peer is None:
            return
        now, live = self._clock.monotonic_ns(), self.peers
        if peer not in live:
            if len(live) >= MOST_PEERS:
                return
            self._heard = {p: at for p, at in self._heard.items() if p in live}
            self._private = {p: at for p, at in self._private.items() if p in live}
            self._counts.connections += not live
        self._heard[peer] = now
        if is_private:
            self._private[peer] = now

    def reply(self, packet: bytes) -> bool:
        """Send a packet only to the sender of the last received packet, even if this sender is not accepted."""
        peer = self._sender
        if peer is None:
            return self._counts.count_dropped()
        taken = self._send_to(packet, None if self._fixed else peer)
        return self._counts.count_sent(len(packet)) if taken else self._counts.count_dropped()

    def fileno(self) -> int:
        """Return the file descriptor for select(), or -1 once the link is closed."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the transport."""
        self._socket.close()

    def _send_to(self, packet: bytes, peer: Any) -> bool:
        try:
            return (self._socket.send(packet) if peer is None else self._socket.sendto(packet, peer)) > 0
        except OSError:  # full buffer, no route, or the last packet was refused: in all cases the packet is lost
            return False

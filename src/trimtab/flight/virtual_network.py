"""Network in virtual time. Datagrams are delayed, lost, duplicated and reordered at random, reproducibly from one seed.

Source: docs page, Testing.
"""

import itertools
import random
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from trimtab.core.clock import NS_PER_SECOND
from trimtab.flight.virtual_time import PACKET, VirtualProgram, VirtualTime

MOST_WAITING = 256
"""Maximum number of packets in the receive queue of a socket, as for small packets in Linux. Further packets are
lost."""
FIRST_PORT = 40_000


class Host(NamedTuple):
    """Network address of a socket: host and port."""

    host: str
    port: int


class Path:
    """Network path from one host to another. All attributes may be changed while programs run."""

    def __init__(self, draw: random.Random) -> None:
        self.delay, self.jitter = 0.0002, 0.0
        """Constant delay of a packet (s), and width (s) of the random delay that is added."""
        self.loss = self.double = 0.0
        """Probability that a packet is lost, and probability that a packet is duplicated."""
        self.keeps_order = True
        """True if packets arrive in the order in which they were sent."""
        self.cut_until = 0
        """Virtual time (ns) until which all packets on this path are lost."""
        self._draw, self._last = draw, 0

    def transit(self, now: int) -> list[int]:
        """Return the times (ns) at which a packet that is sent now arrives. A lost packet has no time, a duplicated
        packet has two."""
        if now < self.cut_until or (self.loss and self._draw.random() < self.loss):
            return []
        copies = 2 if self.double and self._draw.random() < self.double else 1
        arrivals = []
        for _ in range(copies):
            delay = self.delay + (self._draw.uniform(0.0, self.jitter) if self.jitter else 0.0)
            at = now + round(delay * NS_PER_SECOND)
            if self.keeps_order:
                at = self._last = max(at, self._last)
            arrivals.append(at)
        return arrivals


class VirtualNetwork:
    """Network in virtual time: sockets of programs, and paths between their hosts."""

    def __init__(self, time: VirtualTime) -> None:
        self.time = time
        self.names: dict[int, str] = {}
        """Name of the host that listens on each port. It is used for local addresses such as 127.0.0.1."""
        self._sockets: dict[Host, VirtualSocket | _Answerer] = {}
        self._paths: dict[tuple[str, str], Path] = {}
        self._ports = itertools.count(FIRST_PORT)
        self._descriptors = itertools.count(10_000)

    def path(self, sender: str, receiver: str) -> Path:
        """Return the path from one host to another."""
        key = sender, receiver
        if key not in self._paths:
            self._paths[key] = Path(self.time.random(f"path {sender} to {receiver}"))
        return self._paths[key]

    def open_socket(
        self, program: VirtualProgram, host: str, port: int | None = None, peer: Host | None = None
    ) -> "VirtualSocket":
        """Open a datagram socket.

        Args:
            program: program that owns the socket.
            host: name of the machine on which the program runs.
            port: port to listen on, or None for any free port.
            peer: address that the socket is connected to, or None for a socket that receives from any address.

        Raises:
            OSError: another socket of this host uses the port.
        """
        address = Host(host, next(self._ports) if port is None else port)
        if address in self._sockets:
            raise OSError(f"{address} is taken")
        made = VirtualSocket(self, program, address, peer, next(self._descriptors))
        self._sockets[address] = made
        program.closers.append(made.close)
        return made

    def answer_at(self, address: Host, take: Callable[[bytes, Host], None]) -> None:
        """Call a function for each packet that arrives at an address, e.g. for a relay. The arguments are the packet
        and the address of the packet's sender."""
        self._sockets[address] = _Answerer(take)

    def connect_pair(self, near: VirtualProgram) -> tuple["VirtualPair", "VirtualPair"]:
        """Return the two ends of a packet connection without delay. The second end has no owner yet."""
        a, b = (VirtualPair(self.time, next(self._descriptors)) for _ in range(2))
        a.other, b.other = b, a
        a.give_to(near)
        return a, b

    def send(self, sender: Host, receiver: Host, packet: bytes) -> None:
        """Send a packet with a given sender's address, which may be forged, as an attacker does."""
        time = self.time
        time.note("packet", *sender, *receiver, packet)
        for at in self.path(sender.host, receiver.host).transit(time.now):
            self._deliver_at(at, sender, receiver, packet)

    def _deliver_at(self, at: int, sender: Host, receiver: Host, packet: bytes) -> None:
        def arrive() -> VirtualProgram | None:
            socket = self._sockets.get(receiver)
            return None if socket is None else socket.take_packet(packet, sender)

        known = self._sockets.get(receiver)
        self.time.add_event(at, PACKET, known.number if known else 0, arrive)

    def forget(self, socket: "VirtualSocket") -> None:
        """Remove a socket, so that its address can be used again."""
        if self._sockets.get(socket.address) is socket:
            del self._sockets[socket.address]


class _Answerer(NamedTuple):
    """Receiver of packets that calls a function and belongs to no program."""

    take: Callable[[bytes, Host], None]
    number: int = 0

    def take_packet(self, packet: bytes, sender: Host) -> None:
        self.take(packet, sender)


class VirtualSocket:
    """Datagram socket with the methods that a UdpLink uses. It never blocks."""

    def __init__(
        self, network: VirtualNetwork, program: VirtualProgram, address: Host, peer: Host | None, descriptor: int
    ) -> None:
        self._network, self.program, self.address, self._peer = network, program, address, peer
        self.number = program.number
        self._descriptor = descriptor
        self._waiting: deque[tuple[bytes, Host]] = deque()
        self.overflowed = 0
        """Number of packets that were lost because the receive queue of the socket was full."""

    def has_data(self) -> bool:
        """Return True if a packet has arrived and is not read yet."""
        return bool(self._waiting) or self._descriptor < 0

    def take_packet(self, packet: bytes, sender: Host) -> VirtualProgram | None:
        """Store a packet that arrives now. Return the program that the packet wakes up, or None."""
        if self._peer is not None and sender != self._peer:
            return None
        if len(self._waiting) >= MOST_WAITING:
            self.overflowed += 1
            return None
        self._waiting.append((packet, sender))
        time, program = self._network.time, self.program
        return time.wake(program) if time.is_blocked(program, self) else None

    def fileno(self) -> int:
        """Return a number that identifies this socket, or -1 once the socket is closed."""
        return self._descriptor

    def recvfrom(self, size: int, /) -> tuple[bytes, Host]:
        """Return the next packet and the address of the packet's sender. Raise BlockingIOError if no packet has
        arrived."""
        if not self._waiting:
            raise BlockingIOError
        packet, sender = self._waiting.popleft()
        return packet[:size], sender

    def send(self, packet: bytes, /) -> int:
        """Send a packet to the peer to which the socket is connected."""
        if self._peer is None:
            raise OSError("not connected")
        return self.sendto(packet, self._peer)

    def sendto(self, packet: bytes, address: Host, /) -> int:
        """Send a packet to an address. The packet is lost if no socket is bound to the address."""
        if self._descriptor < 0:
            raise OSError("closed")
        self._network.send(self.address, address, packet)
        return len(packet)

    def close(self) -> None:
        """Close the socket. Its address can then be used again."""
        self._descriptor = -1
        self._network.forget(self)


class VirtualPair:
    """End of a packet connection within a machine. Its methods never block."""

    other: "VirtualPair"

    def __init__(self, time: VirtualTime, descriptor: int) -> None:
        self._time, self._descriptor = time, descriptor
        self._program: VirtualProgram | None = None
        self._waiting: deque[bytes] = deque()

    def give_to(self, program: VirtualProgram) -> None:
        """Make a program the owner of this end. The end is closed when the program ends."""
        self._program = program
        program.closers.append(self.close)

    def has_data(self) -> bool:
        """Return True if a packet has arrived and is not read yet, or if the other end is closed."""
        return bool(self._waiting) or self.other.fileno() < 0 or self._descriptor < 0

    def fileno(self) -> int:
        """Return a number that identifies this end, or -1 once this end is closed."""
        return self._descriptor

    def send(self, packet: bytes, /) -> int:
        """Send a packet. Raise BlockingIOError if the buffer is full, or BrokenPipeError if the other end is closed."""
        other = self.other
        if self._descriptor < 0 or other.fileno() < 0:
            raise BrokenPipeError
        if len(other._waiting) >= MOST_WAITING:
            raise BlockingIOError
        other._waiting.append(packet)
        other._announce()
        return len(packet)

    def recv(self, size: int, /) -> bytes:
        """Return the next packet, or empty bytes if the other end is closed. Raise BlockingIOError if no packet has
        arrived."""
        if self._waiting:
            return self._waiting.popleft()[:size]
        if self.other.fileno() < 0:
            return b""
        raise BlockingIOError

    def close(self) -> None:
        """Close this end of the connection, and wake the owner of the other end."""
        if self._descriptor >= 0:
            self._descriptor = -1
            self.other._announce()

    def _announce(self) -> None:
        """Wake the program that owns this end, if the program waits for this end."""
        program, time = self._program, self._time
        if program is not None:

            def wake() -> VirtualProgram | None:
                return time.wake(program) if time.is_blocked(program, self) and self.has_data() else None

            time.add_event(time.now, PACKET, program.number, wake)

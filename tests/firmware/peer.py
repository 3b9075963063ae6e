"""The other end of the firmware's line: signs, sends, listens, over a socket or over a board of the host's own."""

import select
import socket
import time

from trimtab.wire.mavlink import Endpoint

ARM = 400


class Peer:
    """A ground station on a TCP socket."""

    def __init__(self, port, dialect, key, *, system=255, clock=None):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.end = Endpoint(dialect, system, 190, key, clock=clock)
        self.heard = []
        """(time of arrival, message)."""
        self.sent = []

    def send(self, name, **values):
        packet = self.end.pack(name, values)
        self.sent.append(packet)
        self.socket.sendall(packet)

    def raw(self, data):
        self.socket.sendall(data)

    def listen(self, seconds):
        """All messages that come in so many seconds."""
        until, found = time.monotonic() + seconds, []
        while (left := until - time.monotonic()) > 0:
            if select.select([self.socket], [], [], left)[0]:
                data = self.socket.recv(65536)
                if not data:
                    raise ConnectionError("the board hung up")
                found += [(time.monotonic(), m) for m in self.end.feed(data)]
        self.heard += found
        return [m for _, m in found]

    def wait_for(self, name, seconds=5.0, where=lambda m: True):
        """The first message of a name that holds; the others are kept."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            for m in self.listen(0.02):
                if m.name == name and where(m):
                    return m
        raise TimeoutError(f"no {name} in {seconds} s; heard {sorted({m.name for _, m in self.heard})}")

    def heartbeat(self):
        self.send("HEARTBEAT", type=6, autopilot=8, base_mode=0, custom_mode=0, system_status=4, mavlink_version=3)

    def arm(self, on=True):
        self.send("COMMAND_LONG", target_system=1, target_component=1, command=ARM, param1=float(on))

    def offset(self):
        """The board's clock (100 ns) less this process's, from the quickest of a few exchanges."""
        best = None
        for _ in range(8):
            before = time.monotonic_ns()
            self.send("TIMESYNC", tc1=0, ts1=before)
            answer = self.wait_for("TIMESYNC", where=lambda m, asked=before: m.get("ts1") == asked)
            after = time.monotonic_ns()
            if best is None or after - before < best[0]:
                best = after - before, (answer.get("tc1") - (before + after) // 2) // 100
        return best[1]

    def command(self, rudder_pulse, speed_rpm, offset, valid=True):
        now = time.monotonic_ns() // 100 + offset
        self.send("COMMAND", t=now, valid=valid, rudder_pulse=rudder_pulse, speed_rpm=speed_rpm)

    def close(self):
        self.socket.close()
        self.end.close()

"""The other end of the firmware's line, over a socket: signs, sends, listens."""

import select
import socket
import time

from trimtab.flight.mavlink.endpoint import Endpoint

ARM = 400


class Peer:
    """A ground station on a TCP socket."""

    def __init__(self, port, dialect, key, *, clock=None):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.end = Endpoint(dialect, 1, 191, key, clock=clock)
        self.heard = []
        """(time of arrival in ns, message)."""

    def send(self, name, **values):
        packet = self.end.pack(name, values)
        self.socket.sendall(packet)
        return packet

    def listen(self, seconds, until=lambda m: False):
        """Messages for so many seconds, or until one comes that holds."""
        end, found = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0:
            if select.select([self.socket], [], [], left)[0]:
                data = self.socket.recv(65536)
                if not data:
                    raise ConnectionError("the board hung up")
                now = time.monotonic_ns()
                new = [(now, m) for m in self.end.feed(data)]
                self.heard += new
                found += new
                if any(until(m) for _, m in new):
                    break
        return found

    def wait_for(self, name, seconds=5.0, where=lambda m: True):
        """Time and text of the first message of a name that holds."""

        def wanted(m):
            return m.name == name and where(m)

        for at, m in self.listen(seconds, wanted):
            if wanted(m):
                return at, m
        raise TimeoutError(f"no {name} in {seconds} s; heard {sorted({m.name for _, m in self.heard})}")

    def heartbeat(self):
        return self.send("HEARTBEAT", type=6, autopilot=8, system_status=4, mavlink_version=3)

    def arm(self, on=True):
        self.send("COMMAND_LONG", target_system=1, target_component=1, command=ARM, param1=float(on))
        return self.wait_for("COMMAND_ACK")[1]

    def offset(self):
        """The board's clock (100 ns) less this process's monotonic one, by the quickest of a few exchanges."""
        tries = []
        for _ in range(10):
            before = time.monotonic_ns()
            self.send("TIMESYNC", tc1=0, ts1=before)
            after, answer = self.wait_for("TIMESYNC", where=lambda m, asked=before: m.get("ts1") == asked)
            tries.append((after - before, (answer.get("tc1") - (before + after) // 2) // 100))
        return min(tries)[1]

    def command(self, rudder_pulse, speed_rpm, offset, valid=True):
        now = time.monotonic_ns() // 100 + offset
        return self.send("COMMAND", t=now, valid=valid, rudder_pulse=rudder_pulse, speed_rpm=speed_rpm)

    def close(self):
        self.socket.close()
        self.end.close()

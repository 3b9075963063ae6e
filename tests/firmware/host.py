"""The firmware on this computer, in a time of the test's own."""

import ctypes

import numpy as np

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.mavlink.stamps import EPOCH, PER_SECOND

KEY = passphrase_key("a-key-for-these-tests-only")
STAMP = 1_000_000
COUNTS = ("accepted", "unsigned", "forged", "replayed", "reflected", "broken", "skipped", "sent", "dropped")
COUNTS += ("stale", "leading", "foreign", "leading_commands")
MS = 10_000


class Host:
    """The firmware on this computer, in the test's own time; the other end of its line is an autopilot with the key."""

    def __init__(self, library, dialect, stored=0):
        self.library, self.dialect, self.now = library, dialect, 0
        library.host_begin(KEY.secret, ctypes.c_uint64(STAMP), ctypes.c_uint64(stored))
        self.buffer = ctypes.create_string_buffer(1 << 20)
        self.peer = self.other(system=1, component=191)

    def clock(self):
        """Unix time of the other end, which stands at the firmware's first stamp when the firmware starts."""
        return EPOCH + STAMP / PER_SECOND + 1.0 + self.now * 1e-7

    def other(self, **kinds):
        given = {"system": 255, "component": 190, "key": KEY, "clock": self.clock} | kinds
        return Endpoint(self.dialect, **given)

    def work(self, data=b""):
        assert self.library.host_work(ctypes.c_int64(self.now), data, ctypes.c_size_t(len(data))) == 0

    def run(self, ms, data=b""):
        """Give bytes, then go on for so many ms, one at a time; the messages that it sent."""
        found = []
        for _ in range(ms):
            self.now += MS
            self.work(data)
            data = b""
            found += self.sent()
        return found

    def sent(self):
        buffer = self.buffer
        n = self.library.host_sent(buffer, ctypes.c_size_t(len(buffer)))
        return self.peer.feed(ctypes.string_at(buffer, n))

    def counts(self):
        found = (ctypes.c_uint32 * len(COUNTS))()
        self.library.host_counts(found)
        return dict(zip(COUNTS, found, strict=True))

    def pulses(self, n=3):
        """Rudder, thrust and lift, or of other outputs the first n, in counts."""
        found = (ctypes.c_uint16 * n)()
        self.library.host_pulses(found)
        return list(found)

    def pack(self, name, **values):
        return self.peer.pack(name, values)

    def arm(self, on=True):
        return self.run(1, self.pack("COMMAND_LONG", target_system=1, command=400, param1=float(on)))

    def command(self, rudder_pulse=1.5e-3, speed_rpm=6000.0, valid=True):
        t = self.now
        return self.pack("COMMAND", t=t, valid=valid, rudder_pulse=rudder_pulse, speed_rpm=speed_rpm)


def values(messages, name, field):
    """A field of all messages of a name."""
    return np.array([m.get(field) for m in messages if m.name == name])

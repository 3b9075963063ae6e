"""Fuzzed bytes: the parsers accept only valid packets, never raise, and recover."""

import random

import pytest
from flight.mavlink.line import KEY, Clock
from flight.station.test_parameters import parameters

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.standard_services import Station

QUICK, LONG = 200_000, 10_000_000


class Attack:
    """A vehicle, its pilot, and an attacker between them without the key."""

    def __init__(self, dialect, seed, signed, datagrams) -> None:
        self.random = random.Random(seed)
        self.clock = Clock()
        how = {"clock": self.clock, "datagrams": datagrams}
        make = (
            (lambda s: Endpoint(dialect, s, 1, KEY, **how))
            if signed
            else (lambda s: Endpoint(dialect, s, 1, unsigned=True, **how))
        )
        self.vehicle, self.pilot = make(1), make(255)
        self.clock.now += 1
        self.station = Station(self.vehicle, parameters(), {0: "MANUAL"})
        self.names = list(dialect.definitions)
        self.sent, self.recorded, self.count = set(), [], 0
        self.before = len(self.hear(self.packet()))

    def packet(self):
        """A valid packet with unique values."""
        self.count += 1
        self.clock.now += 0.001
        name = self.random.choice(["SAMPLE_EVERY", "COMMAND", "SAMPLE_DOUBLE_WIDE_1"])
        packet = self.pilot.pack(name, {"t": self.count, "valid": 1})
        self.sent.add((name, self.count))
        self.recorded = [*self.recorded[-50:], packet]
        return packet

    def bad(self):
        """Noise, headers, or packets that are bit-flipped, truncated, wrongly joined or replayed."""
        packet, other = self.random.choice(self.recorded), self.random.choice(self.recorded)
        at = self.random.randrange(len(packet))
        kind = self.random.randrange(7)
        if kind == 0:
            return self.random.randbytes(self.random.randrange(1, 400))
        if kind == 1:
            return bytes([self.random.choice([0xFD, 0xFE, 0xA5])]) + self.random.randbytes(self.random.randrange(12))
        if kind == 2:
            return packet[:at] + bytes([packet[at] ^ 1 << self.random.randrange(8)]) + packet[at + 1 :]
        if kind == 3:
            return packet[:at]
        if kind == 4:
            return packet[:at] + other[at:]
        if kind == 5:
            return b"\xfd" * self.random.randrange(1, 300)
        return packet

    def hear(self, data):
        """Feed data to the vehicle and return the messages it accepted and handled."""
        taken = []
        pieces = [data] if self.vehicle._datagrams else self.cut(data)
        for piece in pieces:
            for message in self.vehicle.feed(piece):
                self.station.handle_message(message, self.count)
                taken.append(message)
        return taken

    def cut(self, data):
        at = self.random.randrange(len(data) + 1)
        return [data[:at], data[at:]]


def run(dialect, total, signed, datagrams):
    attack, heard, missed = Attack(dialect, total + signed, signed, datagrams), 0, 0
    heard, done = attack.before, 0
    while done < total:
        for _ in range(attack.random.randrange(4)):
            bad = attack.bad()
            done += len(bad)
            for message in attack.hear(bad):
                if signed:  # only the true packet of before can come out, late, behind what looked like a longer one
                    assert (message.name, message.values[0]) in attack.sent
                    heard += 1
        packets = [attack.packet() for _ in range(6)]
        done += sum(map(len, packets))
        got = [m for p in packets for m in attack.hear(p)]
        assert len(attack.vehicle._rest) <= 300
        assert all(m.is_signed == signed for m in got)
        newest = (got[-1].name, got[-1].values[0]) if got else None
        missed += newest is None or newest not in attack.sent
        heard += len(got)
    return attack, heard, missed


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("datagrams", [True, False])
def test_fuzzed_bytes_are_rejected_and_valid_packets_accepted(dialect, signed, datagrams):
    check(dialect, QUICK, signed, datagrams)


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("datagrams", [True, False])
def test_ten_million_fuzzed_bytes_are_handled(dialect, datagrams):
    """Some seconds each on an idle machine."""
    check(dialect, LONG, True, datagrams)


def check(dialect, total, signed, datagrams):
    attack, heard, missed = run(dialect, total, signed, datagrams)
    counts = attack.vehicle.counts
    assert missed == 0
    if signed:
        assert heard == counts.accepted <= attack.count
        assert counts.replayed > 0
        assert counts.garbage > 0
        assert counts.checksum > 0
    if datagrams:
        assert heard >= attack.count  # each true packet comes alone, and is taken
    else:
        assert heard > 0.9 * attack.count

"""Vectors are packed into messages and restored exactly."""

import numpy as np
import pytest
from flight.mavlink.line import Every, Wide
from run.stand_ins import dialect, ends, places

from trimtab.core.signals import Command
from trimtab.flight.exchange import MOST_INCOMPLETE, MessageGroup, command_group, sample_groups

RNG = np.random.default_rng(1)
WIDE = Wide(covariance=np.zeros((8, 9)), msg=np.zeros(5), after=Every(0.0, 0.0, 0, 0, 0, False, np.zeros(3)))
EVERY = Every(0.0, 0.0, np.int64(0), np.int32(0), np.uint32(0), False, np.zeros(3))
FRAME, DIALECT = dialect({"inertial-unit": EVERY, "filter": WIDE}, EVERY)
READS, SIZE = places(FRAME)
T = 123_456_789_012


def filled(path):
    """A vector of random numbers, each valid for its type."""
    vector = RNG.standard_normal(SIZE) * 1e3
    for p, at in READS.items():
        if p.endswith((".t", ".time", ".count", ".word")):
            vector[at] = RNG.integers(1, 2**31 - 1)
        elif p.endswith((".valid", ".flag", ".fresh")):
            vector[at] = 1.0
    vector[READS[f"{path}.t"]] = T
    return vector


def carried(path):
    """Slots sent over the link: time, validity, value. The receiver computes age and freshness."""
    every = np.arange(SIZE)
    slots = [
        np.atleast_1d(every[at])
        for p, at in READS.items()
        if p.startswith(f"{path}.") and not p.endswith((".age", ".fresh"))
    ]
    return np.concatenate(slots)


def through(group, packets, endpoint):
    return [taken for p in packets for m in endpoint.feed(p) if (taken := group.assemble(m)) is not None]


@pytest.mark.parametrize(("path", "parts"), [("samples.inertial-unit", 1), ("samples.filter", 3)])
def test_packed_sample_is_restored_to_its_slots_only(path, parts):
    both = ends(DIALECT)
    group = MessageGroup(DIALECT, path, lambda p: READS[p])
    sent = filled(path)
    packets = group.pack(both.there, sent)
    assert len(packets) == parts
    (taken,) = through(group, packets, both.here)
    assert taken.t == T
    received = np.full(SIZE, -7.0)
    taken.write(received)
    slots = carried(path)
    np.testing.assert_array_equal(received[slots], sent[slots])
    assert (np.delete(received, slots) == -7.0).all()


def test_time_shift_changes_only_the_time():
    both, path = ends(DIALECT), "samples.inertial-unit"
    group = MessageGroup(DIALECT, path, lambda p: READS[p])
    sent = filled(path)
    (taken,) = through(group, group.pack(both.there, sent, shift=1000), both.here)
    assert taken.t == T + 1000
    received = sent.copy()
    taken.write(received, shift=-400)
    assert received[READS[f"{path}.t"]] == T + 600
    received[READS[f"{path}.t"]] = T
    np.testing.assert_array_equal(received[carried(path)], sent[carried(path)])


def test_parts_of_different_samples_are_not_mixed():
    """A part of the first sample is late. The second sample is complete with its own parts, in any order."""
    both, path = ends(DIALECT, unsigned=True), "samples.filter"
    group = MessageGroup(DIALECT, path, lambda p: READS[p])
    first, second = filled(path), filled(path)
    second[READS[f"{path}.t"]] = T + 60_000
    late, later = group.pack(both.there, first), group.pack(both.there, second)
    assert through(group, [late[0], late[2]], both.here) == []
    for packets, sent in ((later[::-1], second), ([late[1]], first)):
        (taken,) = through(group, packets, both.here)
        received = np.zeros(SIZE)
        taken.write(received)
        np.testing.assert_array_equal(received[carried(path)], sent[carried(path)])


def test_parts_of_reordered_samples_are_reassembled():
    both, path = ends(DIALECT), "samples.filter"
    group = MessageGroup(DIALECT, path, lambda p: READS[p])
    sent = [filled(path) for _ in range(3)]
    for k, vector in enumerate(sent):
        vector[READS[f"{path}.t"]] = T + k * 60_000
    a, b, c = (group.pack(both.there, vector) for vector in sent)
    taken = through(group, [a[0], b[2], a[2], c[1], b[0], a[1], c[0], b[1], c[2]], both.here)
    assert [t.t for t in taken] == [T, T + 60_000, T + 120_000]
    for found, vector in zip(taken, sent, strict=True):
        received = np.zeros(SIZE)
        found.write(received)
        np.testing.assert_array_equal(received[carried(path)], vector[carried(path)])


def test_number_of_incomplete_samples_is_bounded():
    both, path = ends(DIALECT), "samples.filter"
    group, vector = MessageGroup(DIALECT, path, lambda p: READS[p]), filled("samples.filter")
    for k in range(3 * MOST_INCOMPLETE):
        vector[READS[f"{path}.t"]] = T + k
        assert through(group, group.pack(both.there, vector)[:2], both.here) == []
    assert len(group._parts) == MOST_INCOMPLETE


def test_groups_are_keyed_by_sensor_and_write_given_slots():
    groups = sample_groups(DIALECT, lambda p: READS[p])
    assert set(groups) == {"inertial-unit", "filter"}
    command = Command(t=np.int64(0), valid=False, value=EVERY)
    where, size = places(command, "command.")
    group = command_group(DIALECT, lambda p: where[p])
    moved = command_group(DIALECT, lambda p: where[p] + 5 if isinstance(where[p], int) else shifted(where[p]))
    both, vector = ends(DIALECT), np.arange(1.0, size + 1)
    vector[where["command.valid"]] = vector[where["command.value.flag"]] = 1
    (taken,) = through(moved, group.pack(both.here, vector), both.there)
    received = np.zeros(size + 5)
    taken.write(received)
    np.testing.assert_array_equal(received[5:], vector)


def shifted(at):
    return slice(at.start + 5, at.stop + 5)

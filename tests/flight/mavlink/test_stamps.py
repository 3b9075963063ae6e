import os

import pytest
from flight.mavlink.line import NOW, Clock, stamp_at
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.flight.mavlink.stamps import (
    LARGEST,
    LONGEST_LATENESS,
    MARGIN,
    MOST_LEAD,
    MOST_STREAMS,
    PER_SECOND,
    Refusal,
    Stamps,
)

STREAM = (9, 1, 0)


def is_new(stamps, stream, stamp, ordered=True):
    return stamps.find_refusal(stream, stamp, ordered) is None


def test_stamps_follow_the_clock_and_never_repeat(clock):
    stamps = Stamps(clock=clock)
    clock.now += 2
    assert stamps.next_stamp() == int(stamp_at(clock.now))
    assert [stamps.next_stamp() for _ in range(3)] == [stamp_at(clock.now) + k for k in (1, 2, 3)]
    clock.now -= 1000
    assert stamps.next_stamp() == stamp_at(NOW + 2) + 4


@settings(max_examples=40)
@given(st.lists(st.tuples(st.floats(-1e4, 1e4), st.integers(0, 4), st.booleans()), max_size=30))
def test_stamps_never_repeat_over_clock_jumps_and_restarts(tmp_path_factory, story):
    """In each chapter the clock jumps, some packets are sent, then the process is killed or closed."""
    store, clock, sent = tmp_path_factory.mktemp("s") / "a.time", Clock(), []
    for jump, packets, killed in story:
        clock.now += jump
        stamps = Stamps(store, clock)
        sent += [stamps.next_stamp() for _ in range(packets)]
        if killed:
            os.close(stamps._file)
        else:
            stamps.close()
    assert sent == sorted(set(sent))


def test_stamp_file_is_owner_only_and_rarely_written(tmp_path, clock, monkeypatch):
    store, writes, real = tmp_path / "a.time", [], os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda *a: writes.append(a) or real(*a))
    stamps = Stamps(store, clock)
    for _ in range(10_000):
        clock.now += 0.02
        stamps.next_stamp()
    assert store.stat().st_mode & 0o777 == 0o600
    assert 200 / 10 <= len(writes) <= 200 / 10 + 2
    stamps.close()


def test_storing_ahead_spares_packets_a_disk_write(tmp_path, clock, monkeypatch):
    stamps = Stamps(tmp_path / "a.time", clock)
    stamps.store_ahead()
    monkeypatch.setattr(stamps, "_write_store", lambda: pytest.fail("a packet waited"))
    for _ in range(9):
        clock.now += 1
        stamps.next_stamp()
    monkeypatch.undo()
    clock.now += 0.5
    stamps.next_stamp()
    ceiling = stamps._ceiling
    stamps.store_ahead()
    assert stamps._ceiling > ceiling
    stamps.close()


def test_stamps_continue_on_a_full_disk(tmp_path, clock, monkeypatch):
    stamps = Stamps(tmp_path / "a.time", clock)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    found = []
    for _ in range(300):
        clock.now += 1
        found.append(stamps.next_stamp())
    assert found == sorted(set(found))
    assert 0 < stamps.unsaved <= 300
    stamps.close()


def test_rejects_second_process_with_the_same_identity(tmp_path, clock):
    first = Stamps(tmp_path / "a.time", clock)
    with pytest.raises(InputError, match="another process uses this key"):
        Stamps(tmp_path / "a.time", clock)
    first.close()
    Stamps(tmp_path / "a.time", clock).close()


def test_rejects_file_without_a_stamp(tmp_path):
    store = tmp_path / "a.time"
    store.write_text("yesterday")
    with pytest.raises(InputError, match=r"rm '.*a\.time'"):
        Stamps(store)


def test_rejects_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="keep the key file in a folder that you can write"):
        Stamps(tmp_path / "file" / "a.time")


def test_replay_check_is_kept_per_stream(clock):
    stamps = Stamps(clock=clock)
    start = stamps.last
    assert not is_new(stamps, STREAM, start)
    assert is_new(stamps, STREAM, start + 1)
    assert is_new(stamps, STREAM, start + 1)  # asking changes nothing
    stamps.accept(STREAM, start + 5)
    assert [is_new(stamps, STREAM, start + k) for k in (4, 5, 6)] == [False, False, True]
    assert is_new(stamps, (9, 1, 1), start + 1)
    assert stamps.last == start + 5


def test_unordered_stamps_are_accepted_late_but_once(clock):
    stamps = Stamps(clock=clock)
    start = stamps.last
    stamps.accept(STREAM, start + LONGEST_LATENESS + 10, ordered=False)
    late = [start + k for k in (0, 9, 10, 11, LONGEST_LATENESS, LONGEST_LATENESS + 9)]
    assert [is_new(stamps, STREAM, s, ordered=False) for s in late] == [False, False, False, True, True, True]
    stamps.accept(STREAM, start + LONGEST_LATENESS, ordered=False)
    assert [is_new(stamps, STREAM, s, ordered=False) for s in late] == [False, False, False, True, False, True]
    other = (9, 1, 1)
    stamps.accept(other, start + 5, ordered=False)
    assert [is_new(stamps, other, start + k, ordered=False) for k in (-5, 0, 1, 5)] == [False, False, True, False]


def test_command_stamp_may_follow_later_data_not_later_commands(clock):
    stamps = Stamps(clock=clock)
    start = stamps.last
    stamps.accept(STREAM, start + 100, ordered=False)
    assert is_new(stamps, STREAM, start + 50)
    stamps.accept(STREAM, start + 50)
    assert [is_new(stamps, STREAM, start + k) for k in (49, 50, 51, 100)] == [False, False, True, False]
    assert is_new(stamps, STREAM, start + 49, ordered=False)


@given(st.lists(st.tuples(st.integers(1, 3 * LONGEST_LATENESS), st.booleans()), max_size=200))
def test_no_stamp_is_accepted_twice_and_command_stamps_increase(found):
    """Compared with a receiver that stores every stamp."""
    stamps, taken, orders = Stamps(clock=Clock()), set(), [0]
    start = stamps.last
    for k, ordered in found + found[::-1]:
        want = k not in taken and k > max(taken, default=0) - LONGEST_LATENESS and not (ordered and k <= orders[-1])
        assert is_new(stamps, STREAM, start + k, ordered) == want
        if want:
            stamps.accept(STREAM, start + k, ordered)
            taken.add(k)
            orders += [k] if ordered else []


def test_memory_per_stream_is_bounded(clock):
    stamps = Stamps(clock=clock)
    for _ in range(4 * LONGEST_LATENESS):
        stamps.accept(STREAM, stamps.last + 1, ordered=False)
    assert len(stamps._streams[STREAM]._taken) == LONGEST_LATENESS


def test_rejects_stamps_over_a_minute_old_in_any_stream(clock):
    stamps = Stamps(clock=clock)
    stamps.accept(STREAM, stamps.last + 1)
    clock.now += 3600
    now = int(stamp_at(clock.now))
    assert not is_new(stamps, STREAM, now - MARGIN - 1)
    assert is_new(stamps, STREAM, now - MARGIN)
    assert not is_new(stamps, (8, 1, 0), now - MARGIN - 1)


def test_largest_stamp_does_not_overflow(clock):
    stamps = Stamps(clock=clock)
    stamps.accept(STREAM, LARGEST)
    assert stamps.next_stamp() == LARGEST
    assert not is_new(stamps, STREAM, LARGEST)


def test_rejects_stamp_a_day_ahead_without_storing_it(tmp_path, clock):
    """If accepted, it would lock out every sender with the correct clock for a day, across restarts."""
    store = tmp_path / "a.time"
    stamps = Stamps(store, clock)
    now = stamps.last
    assert stamps.find_refusal(STREAM, now + 86_400 * PER_SECOND) is Refusal.LEADING
    assert stamps.find_refusal(STREAM, now + MOST_LEAD + 1) is Refusal.LEADING
    assert stamps.find_refusal(STREAM, now + MOST_LEAD) is None
    assert stamps.lead(now + 86_400 * PER_SECOND) == pytest.approx(86_400)
    stamps.close()
    assert int(store.read_text()) == now


def test_correct_clock_is_never_stale_after_a_leading_peer(tmp_path, clock):
    """A peer with the largest accepted lead is accepted and stored. Then the vehicle is killed and restarted."""
    store = tmp_path / "a.time"
    stamps = Stamps(store, clock)
    stamps.accept(STREAM, stamps.last + MOST_LEAD)
    assert is_new(stamps, (8, 1, 0), stamp_at(clock.now) + 1)
    assert not is_new(stamps, STREAM, stamps.last + 1)  # the bound stands, whatever was accepted
    os.close(stamps._file)  # killed
    again = Stamps(store, clock)
    lead = again.stored_lead * PER_SECOND
    assert MOST_LEAD < lead < MARGIN  # by so much the right clock's owner sees it lead, once
    again.close()


def _largest_lead(stamps, clock):
    """Largest accepted lead over the correct clock (s)."""
    now = int(stamp_at(clock.now))
    return max(k for k in range(3000) if is_new(stamps, STREAM, now + k * PER_SECOND // 10)) / 10


@pytest.mark.parametrize(("ends", "most"), [("close", 48), ("abandon", 118)])
def test_restarts_do_not_add_up_to_a_large_lead(tmp_path, clock, ends, most):
    """A peer with the largest accepted lead over eight restarts."""
    store = tmp_path / "a.time"
    for _ in range(8):
        stamps = Stamps(store, clock)
        clock.now += 5
        lead = _largest_lead(stamps, clock)
        stamps.accept(STREAM, int(stamp_at(clock.now) + lead * PER_SECOND))
        getattr(stamps, ends)()
    assert lead <= most
    clock.now += 2 * most
    assert _largest_lead(Stamps(store, clock), clock) == MOST_LEAD / PER_SECOND


@pytest.mark.parametrize("ahead", [60, 3600, 86_400])
def test_peers_that_follow_a_stored_stamp_far_ahead_are_accepted_throughout(tmp_path, clock, ahead):
    clock.now += ahead
    Stamps(tmp_path / "a.time", clock).close()
    clock.now -= ahead
    vehicle, peer = Stamps(tmp_path / "a.time", clock), Stamps(None, clock)
    assert vehicle.stored_lead == ahead
    peer.follow(vehicle.next_stamp())
    for _ in range(600):
        stamp = peer.next_stamp()
        assert is_new(vehicle, STREAM, stamp)
        vehicle.accept(STREAM, stamp)
        told = vehicle.next_stamp()
        assert is_new(peer, (1, 1, 0), told)
        peer.accept((1, 1, 0), told)
        clock.now += 1


def test_stale_and_replayed_stamps_are_distinguished(clock):
    stamps = Stamps(clock=clock)
    start = stamps.last
    stamps.accept(STREAM, start + 5)
    assert stamps.find_refusal(STREAM, start + 5) is Refusal.REPLAYED
    assert stamps.find_refusal(STREAM, start - 120 * PER_SECOND) is Refusal.STALE
    assert stamps.find_refusal((8, 1, 0), start) is Refusal.STALE


def test_reset_discards_stamp_stored_by_a_wrong_clock(tmp_path, clock):
    store = tmp_path / "a.time"
    clock.now += 86_400
    Stamps(store, clock).close()
    clock.now -= 86_400
    kept = Stamps(store, clock)
    assert kept.stored_lead == pytest.approx(86_400)
    kept.close()
    stamps = Stamps(store, clock, is_reset=True)
    assert stamps.last == int(stamp_at(clock.now))
    assert stamps.stored_lead == 0
    stamps.close()
    assert int(store.read_text()) == int(stamp_at(clock.now))


@pytest.mark.parametrize("difference", [-86_400, 86_400])
def test_followed_peer_clock_is_not_stored(tmp_path, clock, difference):
    store = tmp_path / "a.time"
    stamps = Stamps(store, clock)
    stamps.accept(STREAM, stamps.last + 1)
    kept, theirs = store.read_text(), stamps.last + difference * PER_SECOND
    stamps.follow(theirs)
    assert is_new(stamps, STREAM, theirs + 1)
    assert not is_new(stamps, STREAM, theirs)
    clock.now += 10
    assert stamps.next_stamp() == pytest.approx(theirs + 10 * PER_SECOND, abs=2)
    stamps.close()
    assert store.read_text() == kept


def test_many_streams_are_bounded_without_allowing_replays():
    clock = Clock()
    stamps = Stamps(None, clock)
    clock.now += 10
    first = {}
    for k in range(3 * MOST_STREAMS):
        clock.now += 0.001
        stream, stamp = (k % 250 + 1, k // 250, 7), int(stamp_at(clock.now))
        assert stamps.find_refusal(stream, stamp) is None
        stamps.accept(stream, stamp)
        first[stream] = stamp
    assert len(stamps._streams) == MOST_STREAMS
    assert all(stamps.find_refusal(stream, stamp) is not None for stream, stamp in first.items())

"""Clock offset estimate against known clocks, with delays drawn from measured latencies of Bluetooth modules."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.time import UNITS_PER_SECOND, ms, seconds
from trimtab.flight.mavlink.time_sync import TimeSync, TimeSyncExchange, fit_offset_line
from trimtab.links.latency import bluetooth_link, normal_scores

OFFSET = 123_456_789_012


def theirs(now, drift, offset=OFFSET):
    """Remote clock at a local time."""
    return round(offset + now * (1 + drift))


def exchange(sync, now, up, down, drift=0.0, offset=OFFSET):
    """Make one exchange that starts at now. Return the time of its answer."""
    asked = sync.ask(now)
    back = now + up + down
    assert sync.handle_answer(theirs(now + up, drift, offset) * 100, asked["ts1"], back)
    return back


def draw(path, n, seed):
    """Delays in 100 ns from the table that the channel model draws from."""
    table = np.asarray(bluetooth_link("free2move/linksys 2.9/22.0", path).latency)
    z = np.random.default_rng(seed).standard_normal(n)
    return np.rint(np.interp(z, normal_scores(), table) * UNITS_PER_SECOND).astype(int)


@pytest.mark.thorough("0.0", "4e-05")
@pytest.mark.parametrize("drift", [0.0, 4e-5, -1e-4])
def test_error_over_radio_is_below_single_exchange_error(drift):
    """Bluetooth modules, ten exchanges a second for a minute: up 22..90 ms, down 19..67 ms, [1] table 5.1."""
    sync, errors, single = TimeSync(), [], []
    for k, (up, down) in enumerate(zip(draw("up", 600, 1), draw("down", 600, 2), strict=True)):
        now = k * ms(100)
        back = exchange(sync, now, int(up), int(down), drift)
        at = theirs(back, drift)
        errors.append(sync.to_local(at) - back)
        single.append((up - down) / 2)
        assert abs(theirs(now + up, drift) - now - up - sync.offset) <= sync.shortest / 2 + ms(1)
    settled = np.array(errors[100:])
    assert np.abs(settled).max() < ms(6)
    assert settled.std() < np.std(single) / 5


def test_offset_and_drift_are_estimated_over_short_link():
    """Delays of 0.2 ms plus an exponential part each way, as on a cable to a busy machine."""
    rng, sync, drift = np.random.default_rng(3), TimeSync(), 5e-5
    for k in range(60):
        up, down = (ms("0.2") + int(rng.exponential(ms("0.3"))) for _ in range(2))
        back = exchange(sync, k * seconds(1), up, down, drift)
    assert abs(sync.to_local(theirs(back, drift)) - back) < ms("0.15")
    assert sync.drift == pytest.approx(drift, abs=1e-5)


def test_fitted_offset_matches_numpy_least_squares():
    """Exact offsets on a straight line, so that the prior of the drift has no weight."""
    rng = np.random.default_rng(4)
    times = np.arange(50) * seconds(1)
    exchanges = [
        TimeSyncExchange(int(t), 1000.0 + 3e-5 * t, int(r))
        for t, r in zip(times, rng.integers(100, 9000, 50), strict=True)
    ]
    line = fit_offset_line(exchanges)
    slope, start = np.polyfit(times, [e.offset for e in exchanges], 1)
    assert line.drift == pytest.approx(slope, rel=1e-3)
    assert line.value(int(times[-1])) == pytest.approx(start + slope * times[-1], abs=20)


def test_first_exchange_gives_an_offset_with_bounded_error():
    sync = TimeSync()
    assert not sync.is_known
    assert sync.to_local(5) == 5
    back = exchange(sync, seconds(1), ms(30), ms(10))
    assert sync.is_known
    assert abs(sync.to_local(theirs(back, 0.0)) - back) == ms(10)
    assert sync.shortest == ms(40)


@given(
    st.lists(
        st.tuples(st.integers(0, ms(200)), st.integers(0, ms(200)), st.integers(1, ms(400)), st.booleans()), max_size=60
    )
)
def test_converted_times_are_monotonic(story):
    """For any delays and pauses, local time advances at 0.99 to 1.01 of the remote rate."""
    sync, now, given_out = TimeSync(), 0, []
    for up, down, pause, used in story:
        now = exchange(sync, now, up, down) + pause
        if used:
            remote = theirs(now, 0.0)
            given_out.append((remote, sync.to_local(remote)))
    for (r1, l1), (r2, l2) in itertools.pairwise(given_out):
        assert 0.99 * (r2 - r1) - 1 <= l2 - l1 <= 1.01 * (r2 - r1) + 1


def test_older_sample_does_not_change_earlier_conversions():
    sync = TimeSync()
    for k in range(20):
        exchange(sync, k * ms(100), ms(1), ms(40))
    late = theirs(seconds(3), 0.0)
    first = sync.to_local(late)
    sync.to_local(late - ms(500))
    exchange(sync, seconds(4), ms(1), ms(1))
    assert sync.to_local(late) == first


def test_vehicle_restart_changes_offset_without_backward_time():
    sync, last = TimeSync(), 0
    for k in range(50):
        back = exchange(sync, k * ms(100), ms(20), ms(60))
        last = sync.to_local(theirs(back, 0.0))
    new = -seconds(4)
    for k in range(50, 100):
        back = exchange(sync, k * ms(100), ms(20), ms(20), offset=new)
        if sync.is_doubtful:
            assert (k, sync.jumps) == (50, 0)
            continue
        local = sync.to_local(theirs(back, 0.0, new))
        assert local >= last
        last = local
    assert sync.jumps == 1
    assert abs(local - back) < ms(1)


@pytest.mark.parametrize("wrong", [seconds(3600), -seconds(3600)])
def test_single_exchange_an_hour_off_is_ignored(wrong):
    sync = TimeSync()
    for k in range(50):
        exchange(sync, k * ms(100), ms(20), ms(60))
    before = sync.offset
    exchange(sync, seconds(5), ms(20), ms(60), offset=OFFSET + wrong)
    assert sync.is_doubtful
    back = exchange(sync, seconds("5.1"), ms(20), ms(60))
    assert (sync.jumps, sync.is_doubtful) == (0, False)
    assert abs(sync.offset - before) < ms(1)
    assert abs(sync.to_local(theirs(back, 0.0)) - back) < ms(21)


@pytest.mark.parametrize("wrong", [seconds(3600), ms(490)])
def test_show_local_leaves_later_conversions_unchanged(wrong):
    """Regression: a sample an hour ahead made every later time of the flight wrong."""
    sync, other = TimeSync(), TimeSync()
    for k in range(100):
        for each in (sync, other):
            back = exchange(each, k * ms(100), ms(20), ms(60 + 7 * k % 40))
        sync.show_local(theirs(back, 0.0) + wrong)
        assert sync.to_local(theirs(back, 0.0)) == other.to_local(theirs(back, 0.0))


def test_offset_stays_bounded_without_a_link():
    sync = TimeSync()
    for k in range(20):
        exchange(sync, k * ms(100), ms(100), ms(10))
        sync.to_local(theirs(k * ms(100), 0.0))
    exchange(sync, seconds(3), ms(1), ms(1))  # a better one: what is applied turns, for one second
    later = seconds(600)
    assert abs(sync.to_local(theirs(later, 0.0)) - later) < ms(60)


def test_rejects_foreign_late_and_invalid_answers():
    sync = TimeSync()
    asked = sync.ask(1000)
    assert not sync.handle_answer(5, asked["ts1"] + 100, 2000)
    assert not sync.handle_answer(-5, asked["ts1"], 2000)
    assert not sync.handle_answer(5, asked["ts1"], 999)
    assert not sync.handle_answer(5, asked["ts1"], 1000 + seconds(11))
    assert not sync.handle_answer(0, 123, 2000)  # a question of the other end
    assert sync.refused == 4
    assert sync.handle_answer(5, asked["ts1"], 2000)
    assert not sync.handle_answer(5, asked["ts1"], 2000)  # once


def test_remote_and_local_conversions_are_inverse():
    """Over a radio link while the applied offset is slewed."""
    sync = TimeSync()
    assert sync.to_remote(5) == 5
    for k, (up, down) in enumerate(zip(draw("up", 100, 3), draw("down", 100, 4), strict=True)):
        back = exchange(sync, k * ms(100), int(up), int(down), 5e-5)
        for later in range(0, ms(100), ms(7)):
            remote = sync.to_remote(back + later)
            assert abs(sync.to_local(remote) - back - later) <= 1


@pytest.mark.parametrize("later", [0, 1_000, ms(5), ms(300), seconds(2)])
def test_duplicated_request_is_not_a_second_clock(later):
    """A relay duplicates the request. The vehicle answers both copies, the second one later."""
    sync = TimeSync()
    asked = sync.ask(0)
    assert sync.handle_answer(theirs(ms(2), 0.0) * 100, asked["ts1"], ms(4))
    assert not sync.handle_answer(theirs(ms(2) + later, 0.0) * 100, asked["ts1"], ms(4) + later)
    assert not sync.handle_answer(theirs(ms(2), 0.0) * 100, asked["ts1"], ms(5))  # the same answer twice
    assert sync.doubles == 0


@pytest.mark.parametrize("other", [OFFSET + seconds(1), OFFSET - seconds(3600)])
def test_answers_of_two_clocks_are_counted(other):
    sync = TimeSync()
    asked = sync.ask(0)
    assert sync.handle_answer(theirs(ms(2), 0.0) * 100, asked["ts1"], ms(4))
    assert not sync.handle_answer(theirs(ms(2), 0.0, other) * 100, asked["ts1"], ms(5))
    assert sync.doubles == 1

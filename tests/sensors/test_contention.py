import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.rng import key, uniform2
from trimtab.sensors.contention import AGAIN, ATTEMPTS, FIRST, CarrierSense, simulate_exchange

SENSE = CarrierSense()
LEAST = 8000
"""Number of exchanges that are simulated at least: calls with as many stations share a program."""
WINDOW = 0.1
MESSAGE = 24 / 2400


@jax.jit
def _exchanges(sense, numbers, ready, speaks):
    return jax.vmap(lambda k, r, s: simulate_exchange(sense, key(11), k, r, s, WINDOW))(numbers, ready, speaks)


def exchanges(n, runs, sense=SENSE, speaks=None, seed=0):
    """Exchanges of n stations that get ready a few milliseconds apart, as at a random place under beacons."""
    ready = 0.0088 + 0.0035 * np.random.default_rng(seed).random((runs, n))
    speaks = np.ones((runs, n), bool) if speaks is None else speaks
    given = (np.pad(a, [(0, max(0, LEAST - runs)), (0, 0)], "edge") for a in (ready, speaks))
    found = _exchanges(sense, np.arange(max(runs, LEAST)), *given)
    return ready, jax.tree.map(lambda a: np.asarray(a)[:runs], found)


def draws(number, n):
    """The uniform numbers of an exchange: first waits, and that of each attempt."""
    base = number * ATTEMPTS
    first = np.asarray(uniform2(key(11), base + jnp.arange(n), FIRST)[0])
    return first, np.asarray(uniform2(key(11), base + jnp.arange(SENSE.attempts), AGAIN)[0])


def event_list(number, ready):
    """Reference simulation: a list of the next event of each station, earliest first."""
    n = len(ready)
    first, again = draws(number, n)
    when = {i: ready[i] + (1 + int(first[i] * 64)) / 2400 for i in range(n)}
    busy, end, got = -1.0, [0.0] * n, [False] * n
    for k in range(SENSE.attempts):
        if not when:
            break
        i = min(when, key=lambda j: when[j])
        if when[i] < busy:
            when[i] += (1 + int(again[k] * 64)) / 2400
            continue
        group = [j for j in when if when[j] <= when[i] + 0.9 / 2400]
        for j in group:
            end[j] = when[j] + MESSAGE
            got[j] = len(group) == 1 and end[j] <= WINDOW
        busy = max(end[j] for j in group)
        for j in group:
            del when[j]
    return end, got


@pytest.mark.thorough
def test_exchange_matches_event_list_simulation():
    ready, found = exchanges(6, 40)
    for number in range(40):
        end, got = event_list(number, ready[number])
        np.testing.assert_allclose(found.end[number], end, atol=1e-12)
        np.testing.assert_array_equal(found.received[number], got)


@pytest.mark.thorough("4-0.85-0.015", "5-0.97-0.015", "6-0.97-0.015", "8-0.99-0.01")
@pytest.mark.parametrize(
    ("n", "expected", "tolerance"),
    [(3, 0.92, 0.015), (4, 0.85, 0.015), (5, 0.97, 0.015), (6, 0.97, 0.015), (8, 0.99, 0.01)],
)
def test_three_ranges_per_slot_arrive_with_expected_probability(n, expected, tolerance):
    """Probability of at least three ranges in a slot of 100 ms, all beacons in reach; fewest with four, where one
    collision leaves two."""
    _, found = exchanges(n, 8000)
    assert (found.received.sum(1) >= 3).mean() == pytest.approx(expected, abs=tolerance)


def test_mean_time_of_last_range_is_61_to_91_ms():
    """On the average, with three and with eight beacons."""
    for n, expected in ((3, 61e-3), (8, 91e-3)):
        _, found = exchanges(n, 8000)
        last = np.where(found.received, found.end, 0).max(1)
        assert last[last > 0].mean() == pytest.approx(expected, abs=2e-3)
        assert last.max() <= WINDOW


def test_received_messages_do_not_overlap():
    _, found = exchanges(8, 500)
    assert found.collided.any()
    for end, received, collided in zip(found.end, found.received, found.collided, strict=True):
        assert not (received & collided).any()
        others = np.sort(end[end > 0])
        for e in end[received]:
            gaps = abs(others - e)
            assert np.sort(gaps)[1] >= MESSAGE - 1e-12


def test_only_speaking_stations_send_and_single_one_is_received():
    speaks = np.zeros((200, 4), bool)
    speaks[:, 2] = True
    _, found = exchanges(4, 200, speaks=speaks)
    np.testing.assert_array_equal(found.received, speaks)
    assert (found.end[~speaks] == 0).all()
    _, none = exchanges(4, 200, speaks=np.zeros((200, 4), bool))
    assert not none.received.any()


def test_waiting_times_are_uniform_whole_bytes():
    ready, found = exchanges(1, 4000)
    waits = (found.end - ready - MESSAGE) * 2400
    np.testing.assert_allclose(waits, waits.round(), atol=1e-9)
    counts = np.bincount(waits.round().astype(int).ravel(), minlength=65)
    assert counts[0] == 0
    assert len(counts) == 65
    chi2 = ((counts[1:] - 4000 / 64) ** 2 / (4000 / 64)).sum()
    assert chi2 < 103.4  # 0.1 % of chi-squared with 63 degrees


@pytest.mark.thorough
def test_more_attempts_do_not_change_the_exchange():
    """Eight stations come to an end long before the attempts do; more of them change nothing."""
    _, found = exchanges(8, 2000)
    _, longer = exchanges(8, 2000, sense=replace(SENSE, attempts=96))
    np.testing.assert_array_equal(found.end, longer.end)
    assert (found.end > 0).all()

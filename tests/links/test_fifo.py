import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.rng import key
from trimtab.core.signals import new_sample
from trimtab.core.time import ms
from trimtab.links.fifo import check_ring, required_slots
from trimtab.links.latency_trace import LatencyTrace

SETTINGS = [  # period, send period, sensor period, first valid sample, longest latency in periods
    (ms(1), ms(20), ms(1), 0, 100),
    pytest.param(ms(1), ms(6), ms(6), 0, 80, marks=pytest.mark.thorough),
    (ms(1), ms(6), ms(10), ms(33), 50),
    (ms(1), 65536, 65536, 0, 60),  # the tick of an IMU is no multiple of the link's period
    pytest.param(ms(2), ms(2), ms(3), 0, 0, marks=pytest.mark.thorough),
    (ms(3), ms(10), ms(1), ms(5), 7),
]


def oracle(times, link, sent_at, sensor_period, first):
    """Reference: a list of packets, searched from its start at every instant."""
    packets, offered, sent, lost, rows, held = [], -1, 0, 0, [], None
    for t in times:
        sample = sent_at(t, sensor_period, first)
        opens = t // link.send_period != (t - link.period) // link.send_period
        if opens and sample.valid and sample.t > offered:
            k, offered = sent % len(link.latency), sample.t
            sent += 1
            if link.lost[k]:
                lost += 1
            else:
                arrival = t + round(link.latency[k] * 1e7)
                packets.append((max(arrival, packets[-1][0]) if packets else arrival, sample.t))
        arrived = [p for p in packets if p[0] <= t]
        newest = arrived[-1][1] if arrived else None
        rows.append((newest, newest != held, sent, lost, len(arrived)))
        held = newest
    return rows, packets


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("period", "send_period", "sensor_period", "first", "longest"), SETTINGS)
def test_fifo_matches_a_list_of_packets(drive, sent_at, period, send_period, sensor_period, first, longest, seed):
    random = np.random.default_rng(seed)
    latency = np.round(random.uniform(0, longest * period * 1e-7, 37) * random.integers(0, 2, 37), 7)
    lost = random.random(37) < 0.25
    capacity = required_slots(longest * period * 1e-7, send_period, period)  # the shortest ring for any such latencies
    link = LatencyTrace(latency, lost, send_period, period, capacity)
    link.check()
    t, out, state = drive(link, key(0), 1500, sensor_period, first)
    rows, packets = oracle(t.tolist(), link, sent_at, sensor_period, first)
    newest, fresh, sent, gone, arrived = zip(*rows, strict=True)

    valid = np.array([n is not None for n in newest])
    when = np.array([0 if n is None else n for n in newest])
    np.testing.assert_array_equal(out.valid, valid)
    np.testing.assert_array_equal(out.t, when)
    np.testing.assert_array_equal(out.fresh, fresh)
    np.testing.assert_array_equal(state.sent, sent)
    np.testing.assert_array_equal(state.lost, gone)
    np.testing.assert_array_equal(state.delivered, arrived)
    np.testing.assert_allclose(out.value.sway_velocity, np.where(valid, 1 - 2 * (when * 1e-7), 0.0), atol=1e-15)
    np.testing.assert_allclose(out.age, (t - when) * 1e-7, rtol=0, atol=1e-12)
    assert (np.diff(out.t[out.valid]) >= 0).all()  # never an older one after a newer one
    assert (out.age >= 0).all()
    assert state.lost[-1] > 10
    assert len(packets) > 30


@pytest.mark.thorough
def test_runs_of_a_batch_have_their_own_packets():
    latency = np.array([[0.003, 0.001, 0.0], [0.0, 0.005, 0.002]])
    lost = np.array([[False, False, True], [False, False, False]])

    def run(latency, lost):
        link = LatencyTrace(latency, lost, ms(1), ms(1), 8)

        def body(state, t):
            state, out = link.step(t, state, new_sample(t, t * 1.0))
            return state, out.t

        return jax.lax.scan(body, link.init(key(0), new_sample(0, 0.0)), np.arange(12) * ms(1))[1]

    run = jax.jit(run)
    both = jax.vmap(run)(latency, lost)
    for i in range(2):
        np.testing.assert_array_equal(both[i], run(latency[i], lost[i]))
    assert not (both[0] == both[1]).all()


def test_rejects_ring_buffer_that_could_overflow():
    assert required_slots(0.1, ms(20), ms(1)) == 7  # 5 under way, 1 for the wait to be seen, 1 that has arrived
    check_ring("link", 7, 0.1, ms(20), ms(1))
    with pytest.raises(InputError, match=r"link\.capacity.*6 slots.*0\.1 s.*\nFix: set capacity to at least 7"):
        check_ring("link", 6, 0.1, ms(20), ms(1))
    with pytest.raises(InputError, match=r"link\.send_period: 1 ms is shorter than the link's period, 2 ms"):
        check_ring("link", 64, 0.0, ms(1), ms(2))

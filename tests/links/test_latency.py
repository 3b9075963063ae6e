import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Channel
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key, key
from trimtab.core.time import ms
from trimtab.links.latency import SPAN, MeasuredLatency, gamma_table, interpolate_latency, mean_latency, normal_scores

MEAN, SD, SHIFT = 0.034, 0.008, 0.017
LINK = MeasuredLatency(gamma_table(MEAN, SD, SHIFT), loss=0.1, send_period=ms(6), capacity=20)
SPARSE = replace(LINK, send_period=ms(200), capacity=2)  # a packet arrives before the next one leaves


@jax.jit
def _draws(link, key, packets):
    return jax.vmap(lambda k: link.draw(key, k))(packets)


def draws(link, seed, n=20_000):
    latency, lost = _draws(to_arrays(link), key(seed), jnp.arange(n))
    return np.asarray(latency), np.asarray(lost)


def test_the_table_holds_the_quantiles_of_a_shifted_gamma_distribution():
    k, scale = ((MEAN - SHIFT) / SD) ** 2, SD**2 / (MEAN - SHIFT)
    want = stats.gamma.ppf(stats.norm.cdf(normal_scores()), k, loc=SHIFT, scale=scale)
    np.testing.assert_allclose(gamma_table(MEAN, SD, SHIFT), want, rtol=1e-9)


@pytest.mark.parametrize("moments", [(0.03, 0.008, 0.03), (0.03, 0.0, 0.01), (0.03, 0.008, -0.01), (np.nan, 1, 0)])
def test_rejects_moments_without_a_gamma_distribution(moments):
    with pytest.raises(InputError, match="do not define a distribution"):
        gamma_table(*moments)


def test_table_is_linear_between_nodes_and_constant_beyond():
    z = np.concatenate([np.linspace(-7, 7, 1001), normal_scores(), [-SPAN, SPAN]])
    got = jax.vmap(interpolate_latency, (None, 0))(LINK.latency, z)
    np.testing.assert_allclose(got, np.interp(z, normal_scores(), LINK.latency), rtol=1e-12)


def test_the_mean_of_the_table_is_its_integral():
    def integrand(z):
        return np.interp(z, normal_scores(), LINK.latency) * stats.norm.pdf(z)

    nodes = normal_scores()
    pieces = zip([-12, *nodes], [*nodes, 12], strict=True)
    want = sum(integrate.quad(integrand, a, b)[0] for a, b in pieces)
    assert mean_latency(LINK.latency) == pytest.approx(want, rel=1e-9)
    assert mean_latency(LINK.latency) == pytest.approx(MEAN, rel=1e-3)  # 65 nodes cost 0.01 %


def test_draws_follow_the_distribution():
    latency, _ = draws(LINK, 1)
    k, scale = ((MEAN - SHIFT) / SD) ** 2, SD**2 / (MEAN - SHIFT)
    assert stats.kstest(latency, stats.gamma(k, loc=SHIFT, scale=scale).cdf).pvalue > 0.01
    assert abs(np.corrcoef(latency[1:], latency[:-1])[0, 1]) < 4 / np.sqrt(len(latency))


def test_the_same_key_gives_the_same_bits_and_others_differ():
    first, again, other = draws(LINK, 1), draws(LINK, 1), draws(LINK, 2)
    np.testing.assert_array_equal(first, again)
    assert (first[0] != other[0]).mean() > 0.999
    assert abs(np.corrcoef(first[0], other[0])[0, 1]) < 4 / np.sqrt(len(first[0]))


def test_loss_is_independent_of_latency():
    latency, lost = draws(LINK, 1)
    assert abs(lost.mean() - 0.1) < 4 * np.sqrt(0.1 * 0.9 / len(lost))
    assert abs(np.corrcoef(latency, lost)[0, 1]) < 4 / np.sqrt(len(lost))
    np.testing.assert_array_equal(draws(without(LINK, "loss"), 1)[0], latency)
    np.testing.assert_array_equal(draws(without(LINK, "jitter"), 1)[1], lost)


@pytest.mark.thorough
def test_a_packet_takes_exactly_the_latency_drawn_for_it(drive):
    t, out, state = drive(SPARSE, key(3), 20_000)
    latency, lost = draws(SPARSE, 3, 100)
    arrives = np.ceil(np.round(latency * 1e7) / ms(1)) * ms(1) + np.arange(100) * ms(200)
    np.testing.assert_array_equal(t[out.fresh], arrives[~lost])
    np.testing.assert_array_equal(out.t[out.fresh], (np.arange(100) * ms(200))[~lost])
    assert (state.sent[-1], state.lost[-1], state.delivered[-1]) == (100, lost.sum(), (~lost).sum())
    assert lost.sum() > 3


@pytest.mark.thorough
def test_packets_never_overtake_and_never_arrive_early(drive):
    t, out, state = drive(LINK, key(4), 6_000, sensor_period=ms(6))
    latency, lost = draws(LINK, 4, 1_000)
    sends = np.arange(1_000) * ms(6)
    arrival = np.maximum.accumulate(np.where(lost, 0, sends + np.round(latency * 1e7)))
    fresh = np.flatnonzero(out.fresh)
    packet = out.t[fresh] // ms(6)
    assert (np.diff(packet) > 0).all()
    assert not lost[packet].any()
    assert (out.age[fresh] >= latency[packet] - 1e-7).all()
    np.testing.assert_array_equal(t[fresh], np.ceil(arrival[packet] / ms(1)) * ms(1))
    valid = out.valid
    np.testing.assert_allclose(out.age[valid], (t - out.t)[valid] * 1e-7, rtol=0, atol=1e-12)
    assert (np.diff(state.delivered) > 1).any()  # some arrive together: only the newest is seen, all are counted
    assert len(fresh) < state.delivered[-1] == state.sent[-1] - state.lost[-1] - (arrival[~lost] > t[-1]).sum()


def test_without_jitter_every_packet_takes_the_mean(drive):
    t, out, _ = drive(without(without(SPARSE, "jitter"), "loss"), key(5), 2_000)
    delays = (t - out.t)[out.fresh]
    assert len(delays) == 10
    np.testing.assert_array_equal(delays, np.ceil(mean_latency(SPARSE.latency) * 1e3) * ms(1))


def test_without_delay_a_packet_arrives_when_it_leaves(drive):
    t, out, _ = drive(without(without(LINK, "delay"), "loss"), key(5), 600, sensor_period=ms(6))
    np.testing.assert_array_equal(out.t, t // ms(6) * ms(6))
    np.testing.assert_array_equal(out.fresh, t % ms(6) == 0)


def test_output_is_never_valid_if_all_packets_are_lost(drive):
    _, out, state = drive(replace(LINK, loss=1.0), key(0), 600)
    assert not out.valid.any()
    assert state.sent[-1] == state.lost[-1] == 100


@pytest.mark.thorough
def test_batched_run_equals_the_single_run():
    keys = Key(np.full(3, 7, np.uint32), np.arange(3, dtype=np.uint32))
    batch = jax.vmap(_draws, (None, 0, None))(to_arrays(LINK), keys, jnp.arange(50))
    for run in range(3):
        alone = _draws(to_arrays(LINK), key(7, run), jnp.arange(50))
        np.testing.assert_allclose(batch[0][run], alone[0], rtol=1e-14)
        np.testing.assert_array_equal(batch[1][run], alone[1])


def test_bad_settings_are_refused():
    LINK.check()
    assert isinstance(LINK, Channel)
    falling = np.array(LINK.latency)[::-1]
    for table in (falling, np.zeros(0), np.zeros(3), np.full(65, np.nan), np.array(LINK.latency) - 0.02):
        with pytest.raises(InputError, match="65 rising latencies, at least 0"):
            replace(LINK, latency=table).check()
    with pytest.raises(InputError, match=r"capacity.*\nFix: set capacity to at least 1\d"):
        replace(LINK, capacity=5).check()
    with pytest.raises(InputError, match=r"no imperfection 'delays'.*\nChoices: delay, jitter, loss"):
        without(LINK, "delays")

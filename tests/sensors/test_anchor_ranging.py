"""Ranges to anchors in space, and the place that they give."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.estimators.ranging.multilateration import solve_in_space
from trimtab.sensors.anchor_ranging import HALL, AnchorRanging

O = np.zeros(3)
PLACE = np.array([3.0, 2.0, -1.2])
IDEAL = without_any(AnchorRanging())
STILL = Motion(np.int64(0), PLACE, np.array([0.0, 0.0, np.pi / 2]), O, O, O, O)


def samples(sensor, n, seed=0):
    return rollout(to_arrays(sensor), key(seed), np.arange(n, dtype=np.int64))


@jax.jit
def rollout(sensor, key, k):
    def one(state, k):
        state, sample = sensor.step(k * sensor.period, state, STILL)
        return state, sample.value

    return jax.lax.scan(one, sensor.init(key), k)[1]


def test_ranges_are_distances_from_antenna_to_anchors():
    seen = replace(IDEAL, lever_arm=(0.5, 0.0, 0.1)).measure(STILL)
    np.testing.assert_allclose(seen.range, np.linalg.norm(PLACE + np.array([0.0, 0.5, 0.1]) - np.array(HALL), axis=1))
    assert np.asarray(seen.received).all()


@pytest.mark.thorough
def test_noise_bias_losses_and_multipath_have_given_sizes():
    true = np.asarray(IDEAL.measure(STILL).range)
    assert (samples(replace(IDEAL, noise=0.05), 3000).range - true).std() == pytest.approx(0.05, rel=0.05)
    runs = np.array([samples(replace(IDEAL, bias=0.1), 2, seed).range[0] - true for seed in range(60)])
    assert runs.std() == pytest.approx(0.1, rel=0.15)
    lossy = samples(replace(IDEAL, losses=0.2), 3000)
    assert 1 - np.asarray(lossy.received).mean() == pytest.approx(0.2, abs=0.02)
    late = np.asarray(samples(replace(IDEAL, late_paths=0.1), 3000).range) - true
    assert (late > -1e-12).all()
    assert (late > 1e-9).mean() == pytest.approx(0.1, abs=0.01)
    assert late[late > 1e-9].mean() == pytest.approx(0.8, rel=0.1)


def test_anchor_out_of_reach_is_not_received():
    short = samples(replace(IDEAL, reach=4.0), 2)
    np.testing.assert_array_equal(short.received[1], np.linalg.norm(PLACE - np.array(HALL), axis=1) <= 4.0)
    np.testing.assert_array_equal(np.asarray(short.range)[1][~np.asarray(short.received)[1]], 0.0)


@pytest.mark.thorough
def test_least_squares_recovers_position_from_ranges():
    """Exactly without noise; with it as well as the geometry lets it: the covariance of least squares."""
    anchors, used = np.array(HALL), np.ones(6, bool)
    solve = jax.jit(lambda r, u: solve_in_space(anchors, r, u, np.array([4.0, 3.0, -1.5])))
    true = np.asarray(IDEAL.measure(STILL).range)
    np.testing.assert_allclose(solve(true, used)[0], PLACE, atol=1e-9)
    wrong = np.where(np.arange(6) == 2, 9.0, true)
    np.testing.assert_allclose(solve(wrong, np.arange(6) != 2)[0], PLACE, atol=1e-9)
    assert float(solve(wrong, used)[1]) > 0.3
    seen = samples(replace(IDEAL, noise=0.05), 2000).range
    places = np.asarray(jax.vmap(lambda r: solve_in_space(anchors, r, used, PLACE)[0])(seen))
    H = (PLACE - anchors) / true[:, None]
    np.testing.assert_allclose(np.cov((places - PLACE).T), 0.05**2 * np.linalg.inv(H.T @ H), atol=4e-4)


def test_rejects_anchors_with_wrong_shape():
    with pytest.raises(InputError, match=r"must have shape \(n, 3\)"):
        AnchorRanging(anchors=((0.0, 1.0),)).check()

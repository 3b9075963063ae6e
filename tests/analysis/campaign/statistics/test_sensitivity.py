"""Sobol indices on functions whose indices are known."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.sampling.points import rows_per_base, saltelli_rows
from trimtab.analysis.campaign.statistics.sensitivity import sensitivity
from trimtab.core.errors import InputError

NAMES = ("one", "two", "three")
A, B = 7.0, 0.1


def ishigami(u):
    """Ishigami, Homma 1990: sin x1 + a sin^2 x2 + b x3^4 sin x1 with x uniform in -pi to pi."""
    x = np.pi * (2 * u - 1)
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_indices():
    """(S, T) in closed form: variances of the terms."""
    v1 = 0.5 * (1 + B * np.pi**4 / 5) ** 2
    v2 = A**2 / 8
    v13 = B**2 * np.pi**8 * (1 / 18 - 1 / 50)
    whole = v1 + v2 + v13
    return np.array([v1, v2, 0]) / whole, np.array([v1 + v13, v2, v13]) / whole


def rows_of(base, seed=0, parameters=3, noise=False):
    return saltelli_rows(seed, 0, base * rows_per_base(parameters, noise=noise), parameters, noise=noise)


def test_sobol_indices_of_ishigami_function():
    """4096 base samples: within 0.01, and within the bootstrap's interval."""
    found = sensitivity(ishigami(rows_of(4096).u), NAMES, noise=False)
    first, total = ishigami_indices()
    np.testing.assert_allclose(found.first, first, atol=0.01)
    np.testing.assert_allclose(found.total, total, atol=0.01)
    assert ((found.first_low <= first) & (first <= found.first_high)).all()
    assert ((found.total_low <= total) & (total <= found.total_high)).all()
    assert found.order == ("one", "two", "three")
    assert found.variance == pytest.approx(
        0.5 * (1 + B * np.pi**4 / 5) ** 2 + 49 / 8 + B**2 * np.pi**8 * 8 / 225, rel=0.02
    )
    assert (found.base, found.rows) == (4096, 4096 * 5)


@pytest.mark.thorough
def test_index_intervals_have_at_least_the_stated_coverage():
    """100 seeds of 256 base samples; 3 sigma of 100 repetitions."""
    first, total = ishigami_indices()
    held, spread = [], []
    for seed in range(100):
        f = sensitivity(ishigami(rows_of(256, seed).u), NAMES, noise=False)
        held.append(
            [(f.first_low <= first) & (first <= f.first_high), (f.total_low <= total) & (total <= f.total_high)]
        )
        spread.append([f.first, f.total])
    assert np.mean(held, axis=0).min() >= 0.95 - 3 * np.sqrt(0.05 * 0.95 / 100)
    np.testing.assert_allclose(np.mean(spread, axis=0), [first, total], atol=0.02)


@pytest.mark.thorough
def test_index_intervals_are_exact_for_independent_samples():
    """What the bootstrap assumes: 200 repetitions of 256 random base samples, 95 ± 4.6 % (3 sigma)."""
    first, total = ishigami_indices()
    rng, held = np.random.default_rng(12), []
    for _ in range(200):
        a, b = rng.random((2, 256, 3))
        points = np.stack([a, *(np.where(np.arange(3) == i, b, a) for i in range(3)), b], axis=1)
        f = sensitivity(ishigami(points.reshape(-1, 3)), NAMES, noise=False)
        held.append(
            [(f.first_low <= first) & (first <= f.first_high), (f.total_low <= total) & (total <= f.total_high)]
        )
    np.testing.assert_allclose(np.mean(held, axis=0), 0.95, atol=0.046)


def test_bootstrap_matches_scipy_with_other_draws():
    rows = rows_of(256, 5)
    y = ishigami(rows.u)
    table = y.reshape(256, 5)
    given = {"f_A": table[None, :, 0], "f_B": table[None, :, -1], "f_AB": table[:, 1:-1].T[:, None]}
    theirs = stats.sobol_indices(func=given, n=256)
    ours = sensitivity(y, NAMES, noise=False)
    np.testing.assert_allclose(ours.first, theirs.first_order, rtol=1e-12)
    np.testing.assert_allclose(ours.total, theirs.total_order, rtol=1e-12)
    boot = theirs.bootstrap()
    for order, kind in ((boot.first_order, "first"), (boot.total_order, "total")):
        wide = getattr(ours, f"{kind}_high") - getattr(ours, f"{kind}_low")
        np.testing.assert_allclose(wide, order.confidence_interval.high - order.confidence_interval.low, rtol=0.25)


def noise_of(words):
    return np.random.default_rng(1).normal(size=2 * len(words))[words]


def test_noise_is_a_factor_with_its_share_of_the_variance():
    """y = u1 + sqrt(1/4) times noise of the same variance: 4/5 and 1/5; u2 does nothing."""
    rows = rows_of(4096, 2, parameters=2, noise=True)
    y = rows.u[:, 0] + 0.5 * np.sqrt(1 / 12) * noise_of(rows.words)
    found = sensitivity(y, ("one", "two"))
    assert found.factors == ("one", "two", "noise")
    np.testing.assert_allclose(found.first, [0.8, 0, 0.2], atol=0.03)
    np.testing.assert_allclose(found.total, [0.8, 0, 0.2], atol=0.02)
    assert found.total[1] < 1e-12
    assert found.order == ("one", "noise", "two")


@pytest.mark.thorough
def test_parameter_scaled_noise_shows_as_interaction():
    """y = u n: V = 1/3; S of u is 0; T of u is 1/4; the noise alone has 3/4."""
    rows = rows_of(8192, 3, parameters=1, noise=True)
    found = sensitivity(rows.u[:, 0] * noise_of(rows.words), ("scale",))
    np.testing.assert_allclose(found.first, [0, 0.75], atol=0.06)
    np.testing.assert_allclose(found.total, [0.25, 1], atol=0.04)


def test_sobol_indices_of_a_success_flag():
    """Success where u1 < 0.5 and u2 < 0.5: V = 3/16, S = 1/3, T = 2/3 each."""
    rows = rows_of(1024)
    found = sensitivity((rows.u[:, :2] < 0.5).all(axis=1), NAMES, noise=False)
    np.testing.assert_allclose(found.first, [1 / 3, 1 / 3, 0], atol=0.02)
    np.testing.assert_allclose(found.total, [2 / 3, 2 / 3, 0], atol=0.02)


def test_diverged_runs_require_rank_based_indices():
    rows = rows_of(512)
    y = np.exp(5 * rows.u[:, 0]) + rows.u[:, 1]
    y[y > np.exp(4.9)] = np.nan
    found = sensitivity(y, NAMES, noise=False)
    assert np.isnan(found.first).all()
    assert "no finite value" in found.note
    ranked = sensitivity(y, NAMES, noise=False, by_rank=True)
    assert ranked.note == ""
    assert ranked.first[0] > 0.95
    same = sensitivity(np.log(rows.u[:, 0]), NAMES, noise=False, by_rank=True)
    np.testing.assert_allclose(same.total, sensitivity(rows.u[:, 0], NAMES, noise=False).total, atol=0.01)


def test_equal_runs_give_no_indices_and_a_note():
    found = sensitivity(np.full(500, 3.0), NAMES, noise=False)
    assert "no variance to explain" in found.note
    assert np.isnan(found.total).all()


def test_only_power_of_two_base_samples_are_used():
    y = ishigami(rows_of(300).u)
    found, same = sensitivity(y[:1499], NAMES, noise=False), sensitivity(y[:1280], NAMES, noise=False)
    assert (found.base, found.rows) == (256, 1280)
    np.testing.assert_array_equal(found.total_high, same.total_high)


def test_refuses_too_few_rows():
    with pytest.raises(InputError, match="at least 40 runs"):
        sensitivity(np.arange(39.0), NAMES, noise=False)

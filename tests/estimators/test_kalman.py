"""The filter's two steps against textbook forms written out in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.estimators import kalman
from trimtab.estimators.kalman import nees, predict, update_sequentially

N, M = 5, 3
update, health, inflate = map(jax.jit, (kalman.update, kalman.covariance_health, kalman.inflate_covariance))
in_turn = jax.jit(update_sequentially)


def case(seed, m=M):
    g = np.random.default_rng(seed)
    A, B = g.standard_normal((N, N)), g.standard_normal((m, m))
    return (
        g.standard_normal(N),
        A @ A.T + np.eye(N),
        g.standard_normal(m),
        g.standard_normal((m, N)),
        B @ B.T + np.eye(m),
    )


def information_form(x, P, y, H, R):
    """The update by inverses, which the code never forms."""
    new = np.linalg.inv(np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H)
    return x + new @ H.T @ np.linalg.inv(R) @ y, new


def test_predict_matches_the_textbook_formula():
    x, P, *_ = case(0)
    F, Q = np.random.default_rng(1).standard_normal((N, N)), np.eye(N)
    new_x, new_P = predict(x, P, F, Q)
    np.testing.assert_allclose(new_x, F @ x, rtol=1e-13)
    np.testing.assert_allclose(new_P, F @ P @ F.T + Q, rtol=1e-12)
    assert (np.asarray(new_P) == np.asarray(new_P).T).all()


@pytest.mark.thorough("2")
@pytest.mark.parametrize("m", [1, 2, 3])
def test_update_matches_the_information_form(m):
    x, P, y, H, R = case(m, m)
    done = update(x, P, y, H, R)
    want_x, want_P = information_form(x, P, y, H, R)
    np.testing.assert_allclose(done.x, want_x, rtol=1e-10)
    np.testing.assert_allclose(done.P, want_P, rtol=1e-9, atol=1e-12)
    S = H @ P @ H.T + R
    np.testing.assert_allclose(done.S, S, rtol=1e-12)
    np.testing.assert_allclose(done.nis, y @ np.linalg.solve(S, y), rtol=1e-12)
    assert done.accepted
    assert done.finite


@pytest.mark.thorough("2")
@pytest.mark.parametrize("m", [1, 2, 3])
def test_inflated_covariance_gives_expected_nis(m):
    """Without noise of the measurement NIS falls to its mean m; an innovation within it inflates nothing."""
    _, P, y, H, _ = case(3, m)
    none = 1e-12 * np.eye(m)
    y = 100 * y
    assert update(np.zeros(N), P, y, H, none).nis > m
    wider = inflate(P, y, H, none)
    assert float(update(np.zeros(N), wider, y, H, none).nis) == pytest.approx(m, rel=1e-6)
    for small in (1e-4 * y, np.full(m, np.nan)):
        np.testing.assert_array_equal(inflate(P, small, H, none), P)


@pytest.mark.thorough
def test_sequential_update_matches_joint_update():
    x, P, y, H, _ = case(4)
    variances = np.array([0.5, 1.0, 2.0])
    joint, turn = update(x, P, y, H, np.diag(variances)), update_sequentially(x, P, y, H, variances)
    np.testing.assert_allclose(turn.x, joint.x, rtol=1e-11)
    np.testing.assert_allclose(turn.P, joint.P, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(turn.nis, joint.nis, rtol=1e-11)


def test_sequential_update_drops_only_the_outlier():
    x, P, y, H, _ = case(5)
    variances, bad = np.ones(M), y + np.array([0.0, 1e3, 0.0])
    kept = update(x, P, y[[0, 2]], H[[0, 2]], np.eye(2))
    turn = in_turn(x, P, bad, H, variances, gate=50.0)
    np.testing.assert_array_equal(turn.accepted, [True, False, True])
    np.testing.assert_allclose(turn.x, kept.x, rtol=1e-11)
    missing = in_turn(x, P, np.array([y[0], np.nan, y[2]]), H, variances, gate=np.inf)
    np.testing.assert_allclose(missing.x, kept.x, rtol=1e-11)
    np.testing.assert_array_equal(missing.finite, [True, False, True])
    np.testing.assert_allclose(missing.nis, kept.nis, rtol=1e-11)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nan_measurement_leaves_the_state_unchanged(bad):
    x, P, y, H, R = case(6)
    done = update(x, P, np.array([y[0], bad, y[2]]), H, R)
    assert not done.finite
    assert not done.accepted
    np.testing.assert_array_equal(done.x, x)
    np.testing.assert_array_equal(done.P, P)
    assert np.isfinite(done.nis)


@pytest.mark.thorough
def test_gate_applies_to_the_nis():
    x, P, y, H, R = case(7)
    nis = float(update(x, P, y, H, R).nis)
    assert update(x, P, y, H, R, gate=nis * 1.001).accepted
    refused = update(x, P, y, H, R, gate=nis * 0.999)
    assert not refused.accepted
    np.testing.assert_array_equal(refused.x, x)
    np.testing.assert_array_equal(refused.P, P)


def test_considered_state_is_kept_and_its_uncertainty_counts():
    """P is the true covariance of the filter with that gain: checked by pushing errors through it."""
    _, P, _, H, R = case(8)
    consider = np.array([1.0, 0, 1, 1, 0])
    done = update(np.zeros(N), P, np.ones(M), H, R, consider=consider)
    np.testing.assert_array_equal(np.asarray(done.x)[[1, 4]], 0.0)
    np.testing.assert_allclose(np.asarray(done.P)[1, 1], P[1, 1], rtol=1e-12)
    g = np.random.default_rng(9)
    e = g.multivariate_normal(np.zeros(N), P, 200_000)
    z = -e @ H.T + g.multivariate_normal(np.zeros(M), R, len(e))  # innovation of an estimate that is e too high
    K = (np.linalg.solve(H @ P @ H.T + R, H @ P).T) * consider[:, None]
    after = e + z @ K.T
    np.testing.assert_allclose(np.cov(after.T), done.P, atol=0.02 * np.abs(P).max())


def test_joseph_form_keeps_symmetry_over_many_steps():
    _, P, _, H, R = case(10)
    F = np.eye(N) + 0.01 * np.random.default_rng(11).standard_normal((N, N))

    def step(P, _):
        P = predict(jnp.zeros(N), P, F, 1e-12 * jnp.eye(N))[1]
        return update(jnp.zeros(N), P, jnp.zeros(M), H, 1e-9 * R).P, health(P)

    _, signals = jax.jit(lambda P: jax.lax.scan(step, P, None, length=2000))(P)
    assert np.asarray(signals.positive).all()
    assert np.asarray(signals.asymmetry).max() == 0.0


def test_covariance_health_bounds_the_eigenvalues():
    for seed in range(20):
        _, P, *_ = case(seed)
        signals = health(P)
        s = np.sqrt(np.diag(P))
        least = np.linalg.eigvalsh(P / np.outer(s, s)).min()
        assert signals.positive
        assert 0 < signals.eigenvalue_bound <= least * (1 + 1e-12)
        np.testing.assert_allclose(signals.trace, np.trace(P), rtol=1e-13)
        shares = np.diag(np.linalg.cholesky(P)) ** 2 / np.diag(P)
        np.testing.assert_allclose(signals.least_pivot, shares.min(), rtol=1e-9)
        assert signals.least_pivot >= signals.eigenvalue_bound


@pytest.mark.parametrize("spoil", ["negative", "indefinite", "nan", "infinite"])
def test_covariance_health_reports_invalid_covariance(spoil):
    _, P, *_ = case(12)
    P = P.copy()
    if spoil == "negative":
        P[2, 2] = -1.0
    if spoil == "indefinite":
        P[0, 1] = P[1, 0] = 2 * np.sqrt(P[0, 0] * P[1, 1])
    if spoil == "nan":
        P[1, 1] = np.nan
    if spoil == "infinite":
        P[1, 1] = np.inf
    signals = health(P)
    assert not signals.positive
    assert all(
        np.isfinite(v) for v in (signals.asymmetry, signals.least_pivot, signals.eigenvalue_bound, signals.trace)
    )


def test_covariance_health_reports_asymmetry():
    P = np.eye(3)
    P[0, 1] = 1e-3
    assert health(P).asymmetry == pytest.approx(1e-3)


def test_nees_matches_the_quadratic_form():
    x, P, *_ = case(13)
    assert nees(x, P) == pytest.approx(x @ np.linalg.solve(P, x), rel=1e-11)
    assert np.isnan(nees(x, -P))


@pytest.mark.thorough
def test_filter_steps_lower_to_generated_c():
    x, P, y, H, R = case(14)
    assert lower_function(predict, (x, P, P, P)).text("f")
    assert lower_function(lambda *a: update(*a, gate=9.0, consider=jnp.ones(N)), (x, P, y, H, R)).text("f")
    assert lower_function(update_sequentially, (x, P, y, H, np.ones(M))).text("f")
    assert lower_function(lambda P: (health(P), nees(x, P)), (P,)).text("f")

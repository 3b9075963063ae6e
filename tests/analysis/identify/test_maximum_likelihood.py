"""Maximum likelihood: value against a dense Gaussian, gradient against differences, intervals of a linear model."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.analysis.identify.maximum_likelihood import (
    CompiledLikelihood,
    Model,
    Timeline,
    compare_flights,
    compile_likelihood,
    log_likelihood,
    maximise_likelihood,
    name_collinear,
    profile_intervals,
)

N, H = 60, 0.1


def model() -> Model:
    """x' = -a x + b u, measured with noise; p = a, b, log r, log q."""
    u = np.sin(0.4 * np.arange(N))

    def step(p: Any, x: Any, u: Any, h: Any) -> Any:
        return x + h * (-p[0] * x + p[1] * u)

    def process(p: Any) -> Any:
        return jnp.exp(p[3])[None]

    return Model(
        step, lambda p, drive: jnp.asarray(u), process, lambda p: jnp.exp(p[2])[None], (0,), (False,), np.array([4.0])
    )


def timeline(seed: int, p: Any) -> Timeline:
    g, u, x, y = np.random.default_rng(seed), np.sin(0.4 * np.arange(N)), 0.0, []
    for k in range(N):
        if k:
            x += H * (-p[0] * x + p[1] * u[k]) + np.sqrt(H * np.exp(p[3])) * g.standard_normal()
        y.append(x + np.exp(p[2] / 2) * g.standard_normal())
    begins, seen = np.arange(N) == 0, np.ones((N, 1), bool)
    seen[20:26] = False
    return Timeline(np.where(begins, 0.0, H), begins, np.array(y)[:, None], seen, np.zeros((N, 1)))


TRUE = np.array([0.8, 2.0, 2 * np.log(0.05), 2 * np.log(0.1)])


def test_likelihood_equals_dense_gaussian_likelihood() -> None:
    data = timeline(0, TRUE)
    F, u = 1 - H * TRUE[0], np.sin(0.4 * np.arange(N))
    mean, cause = np.zeros(N), np.zeros((N, N))
    cause[0, 0] = 2.0  # standard deviation of the first state
    for k in range(1, N):
        mean[k] = F * mean[k - 1] + H * TRUE[1] * u[k]
        cause[k] = F * cause[k - 1]
        cause[k, k] += np.sqrt(H * np.exp(TRUE[3]))
    P = cause @ cause.T + np.exp(TRUE[2]) * np.eye(N)
    there = data.seen[:, 0]
    e, S = (data.y[:, 0] - mean)[there], P[np.ix_(there, there)]
    dense = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])
    np.testing.assert_allclose(float(log_likelihood(model(), data, jnp.asarray(TRUE))), dense, rtol=1e-10)


@pytest.mark.thorough
def test_likelihood_gradient_matches_finite_differences() -> None:
    likelihood, data = compile_likelihood(model()), timeline(1, TRUE)
    p, h = TRUE + 0.1, 1e-5
    _, g, information = (np.asarray(v) for v in likelihood.score(data, p))
    for k in range(4):
        d = h * np.eye(4)[k]
        numeric = (float(likelihood.value(data, p + d)) - float(likelihood.value(data, p - d))) / (2 * h)
        np.testing.assert_allclose(g[k], numeric, rtol=1e-5, atol=1e-5)
    assert np.linalg.eigvalsh(information).min() > 0


@pytest.mark.thorough
def test_parameter_intervals_have_the_stated_coverage() -> None:
    inside, likelihood = 0, compile_likelihood(model())
    for seed in range(12):
        data = timeline(100 + seed, TRUE)
        start = np.array([1.1, 1.5, *(TRUE[2:] + 0.5)])
        found = maximise_likelihood(likelihood, data, start, np.full(4, -20.0), np.full(4, 20.0))
        free = np.array([True, True, False, False])
        for i, (low, high) in enumerate(profile_intervals(likelihood, data, found, (0, 1), free)):
            inside += int(low <= TRUE[i] <= high)
    assert inside >= 19  # of 24, 22.8 expected; fewer by chance 0.4 %


def gaussian_score(timeline: Timeline, p: Any) -> Any:
    """Score of the mean p[0] and of the logarithm of the variance p[1] of independent measurements."""
    z, n = (timeline.y[timeline.seen] - p[0]) / np.exp(p[1] / 2), timeline.seen.sum()
    gradient = [np.sum(z) / np.exp(p[1] / 2), np.sum(z * z - 1) / 2]
    return 0.0, np.array(gradient), np.diag([n / np.exp(p[1]), n / 2])


@pytest.mark.parametrize(("shift", "noise", "agrees"), [(0.0, 1.0, True), (0.0, 3.0, True), (3.0, 1.0, False)])
def test_flights_with_other_parameters_are_found(shift: float, noise: float, agrees: bool) -> None:
    g = np.random.default_rng(0)
    y = np.concatenate([g.standard_normal(50), shift + noise * g.standard_normal(50)])
    flights = Timeline(y, y, y[:, None], np.ones((100, 1), bool), y, (), np.repeat([0, 1], 50))
    none: Any = None
    likelihood = CompiledLikelihood(gaussian_score, none, none, none)
    p, kept = np.array([y.mean(), np.log(y.var())]), np.array([True, False])
    chances = compare_flights(likelihood, flights, p, kept)
    assert len(chances) == 2
    assert all((chance > 1e-3) == agrees for chance in chances)
    first = flights._replace(owner=np.zeros(100, int))
    assert compare_flights(likelihood, first, p, kept) == [1.0]


def test_collinear_parameters_are_named() -> None:
    J = np.array([[1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 2.0, 0.5, 0.0]])
    assert name_collinear(J.T @ J, ["a", "b", "c", "d"]) == [("d",), ("a", "b")]

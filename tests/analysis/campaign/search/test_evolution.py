"""CMA-ES in the cube on functions with known minima."""

import numpy as np
import pytest

from trimtab.analysis.campaign.search.evolution import evolve


def run(of, start, budget=2000, population=8):
    found = list(evolve(of, start, step=0.2, population=population, budget=budget, seed=4))
    x, f = np.concatenate([g.x for g in found]), np.concatenate([g.f for g in found])
    return found, x, x[np.argmin(f)]


@pytest.mark.thorough("least1", "least2")
@pytest.mark.parametrize("least", [(0.3,), (0.9, 0.1), (1.0, 0.0, 0.5)])
def test_minimum_is_found_inside_and_on_the_bounds(least):
    found, x, best = run(lambda x: ((x - least) ** 2).sum(axis=1), lambda restart: np.full(len(least), 0.6))
    assert best == pytest.approx(least, abs=0.02)
    assert x.min() >= 0
    assert x.max() <= 1
    assert len(x) <= 2000
    assert found[-1].mean.shape == (len(least),)


def test_restarts_use_given_start_and_double_population():
    starts = []

    def start(restart):
        starts.append(restart)
        return np.array([0.1, 0.1]) if restart == 0 else np.array([0.8, 0.8])

    def two_wells(x):
        return np.minimum(0.1 + ((x - 0.1) ** 2).sum(axis=1), 4 * ((x - 0.8) ** 2).sum(axis=1))

    found, _, best = run(two_wells, start, 4000)
    assert best == pytest.approx([0.8, 0.8], abs=0.02)
    sizes = {g.restart: len(g.x) for g in found}
    assert sizes[1] == 2 * sizes[0]
    assert starts == sorted(starts)


def test_evolution_is_repeatable_and_keeps_global_random_state():
    def once():
        return run(lambda x: x.sum(axis=1), lambda restart: np.array([0.5, 0.5]), 200)[1]

    np.random.seed(11)
    first = once()
    drawn = np.random.random()
    np.random.seed(11)
    assert drawn == np.random.random()
    assert np.array_equal(once(), first)


def test_budget_below_one_generation_evaluates_no_points():
    assert list(evolve(lambda x: x[:, 0], lambda r: np.zeros(3), step=0.2, population=8, budget=4, seed=0)) == []

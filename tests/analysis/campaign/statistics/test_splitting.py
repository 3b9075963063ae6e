"""Splitting compared with probabilities in closed form, and intervals with the stated coverage."""

import numpy as np
import pytest
from scipy import special, stats

from trimtab.analysis.campaign.statistics.splitting import (
    SPLIT,
    ChainStates,
    Ladder,
    Stalled,
    descend,
    expected_width,
    probability,
    set_ladder,
    take_step,
)

BATCHES = 40


def word_normals(words):
    """A standard normal number of each word."""
    return special.ndtri((words + 0.5) / 2**32)


def linear(b):
    """Margin of a sum of all numbers, standard normal, that must stay below b."""

    def margin(z, words):
        n = z.shape[1] + words.shape[1]
        return b - (z.sum(axis=1) + word_normals(words).sum(axis=1)) / np.sqrt(n)

    return margin


def two_corners(b):
    """Fails in either of two places, which are equally probable."""
    return lambda z, words: b - np.maximum(z[:, 0], -z[:, 1])


def estimate(margins, d, m, runs, seed):
    rng = np.random.default_rng(seed)
    ladder = set_ladder(margins, rng, 1000, d, m)
    roots = int((runs - ladder.flown) / ladder.roots_cost) // BATCHES
    found = descend(margins, rng, ladder, roots * BATCHES, d, m)
    sums = found.counts.reshape(BATCHES, -1).sum(axis=1)
    return probability(sums, roots, ladder), ladder, found, roots


CASES = {
    "one parameter": (linear, 1, 0, 1e-6),
    "two parameters": (linear, 2, 0, 1e-6),
    "thirty parameters": (linear, 30, 0, 1e-6),
    "noise alone": (linear, 0, 32, 1e-6),
    "both": (linear, 5, 32, 1e-6),
    "two corners": (two_corners, 2, 0, 1 - (1 - 5e-7) ** 2),
    "often": (linear, 3, 4, 0.2),
}


def make(name):
    of, d, m, p = CASES[name]
    return of(-special.ndtri(5e-7 if of is two_corners else p)), d, m, p


@pytest.mark.parametrize("name", CASES)
def test_splitting_estimates_a_known_probability(name):
    margins, d, m, p = make(name)
    found, ladder, descent, roots = estimate(margins, d, m, 60_000, seed=1)
    assert found.low < p < found.high
    assert abs(found.value / p - 1) < 0.5
    assert ladder.levels[-1] == 0
    assert np.all(np.diff(ladder.levels) < 0)
    assert (found.high - found.low) / 2 / found.value == pytest.approx(expected_width(ladder, roots * BATCHES), rel=0.6)
    assert np.all(margins(descent.failures.z, descent.failures.words) < 0)
    assert descent.counts.sum() == len(descent.failures.margin)


def below(rng, n, b):
    """ChainStates whose first number and first word both lie beyond b, drawn directly."""
    z, words = rng.standard_normal((n, 2)), rng.integers(0, 2**32, (n, 3), dtype=np.uint32)
    tail = special.ndtr(-b)
    z[:, 0] = -special.ndtri(tail * rng.random(n))
    words[:, 0] = np.floor((1 - tail * rng.random(n)) * 2**32).astype(np.uint32)
    return ChainStates(z, words, beyond(b)(z, words), np.arange(n))


def beyond(b):
    return lambda z, words: b - np.minimum(z[:, 0], word_normals(words[:, 0]))


def test_mcmc_steps_preserve_the_conditional_distribution():
    rng, b = np.random.default_rng(2), 1.0
    at = below(rng, 4000, b)
    first = at
    for _ in range(15):
        at, _, taken = take_step(beyond(b), rng, at, 0.0, np.array([0.5, 1.0]), 0.4)
    assert 0.1 < taken.mean() < 0.9
    moved = (at.z != first.z).any(axis=1) & (at.words != first.words).any(axis=1)
    assert moved.mean() > 0.8
    assert np.all(at.margin < 0)
    cut = stats.truncnorm(b, np.inf)
    assert stats.kstest(at.z[:, 0], cut.cdf).pvalue > 1e-3
    assert stats.kstest(word_normals(at.words[:, 0]), cut.cdf).pvalue > 1e-3
    assert stats.kstest(at.z[:, 1], "norm").pvalue > 1e-3
    assert stats.kstest(at.words[:, 1] / 2.0**32, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(at.z[:, 0], at.words[:, 0])[0, 1]) < 4 / np.sqrt(len(at.margin))


def test_poor_ladder_gives_an_unbiased_estimate():
    """Uneven levels and far too short steps widen the interval, but the estimate stays unbiased."""
    p, margins = 1e-3, linear(-special.ndtri(1e-3))
    levels = -special.ndtri(p) - np.array([0.4, 1.9, -special.ndtri(p)])
    ladder = Ladder(levels, np.full((2, 2), 0.05), np.array([0.05, 0.9]), 0.0, 0)
    counts = descend(margins, np.random.default_rng(3), ladder, 40_000, 2, 2).counts / SPLIT**2
    error = counts.std() / np.sqrt(len(counts))
    assert error < 0.12 * p
    assert abs(counts.mean() - p) < 3.5 * error


def test_margin_plateau_raises_stalled_with_its_level():
    with pytest.raises(Stalled) as stalled:
        set_ladder(lambda z, w: np.where(z[:, 0] > 5, -1.0, 0.25), np.random.default_rng(0), 1000, 2, 0)
    assert stalled.value.level == 0.25
    assert stalled.value.flown == 1000


def test_no_failure_gives_no_upper_bound():
    ladder = Ladder(np.array([0.0]), np.zeros((0, 1)), np.zeros(0), 0.0, 0)
    found = probability(np.zeros(BATCHES), 10, ladder)
    assert (found.value, found.low, found.high) == (0.0, 0.0, np.inf)


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["two parameters", "noise alone", "both", "two corners"])
def test_interval_coverage_at_one_in_a_million(name, capsys):
    """Of 100 intervals at 95 %, about 95 contain the true value, and the mean estimate is unbiased."""
    margins, d, m, p = make(name)
    found = [estimate(margins, d, m, 100_000, seed)[0] for seed in range(100)]
    held = sum(f.low <= p <= f.high for f in found)
    values = np.array([f.value for f in found]) / p
    width = np.median([(f.high - f.low) / 2 / p for f in found])
    with capsys.disabled():
        print(
            f"\n{name}: {held} of 100 hold it; mean {values.mean():.3f}, scatter {values.std():.3f}, width {width:.3f}"
        )
    assert held >= 90  # of a binomial of 0.95, fewer in 1 of 80 cases
    assert abs(values.mean() - 1) < 4 * values.std() / 10
    assert width < 0.3

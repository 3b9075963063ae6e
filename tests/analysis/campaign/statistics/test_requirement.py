"""Requirements judged on runs."""

import math

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.grammar import parse_requirement
from trimtab.analysis.campaign.statistics.requirement import evaluate_requirement, least_runs
from trimtab.core.errors import InputError


def judged(text, anytime=False, **columns):
    return evaluate_requirement(
        parse_requirement(text), {name.replace("_of_", ":"): x for name, x in columns.items()}, anytime=anytime
    )


def trials(successes, n):
    return np.arange(n) < successes


@pytest.mark.parametrize(
    ("successes", "outcome"), [(1000, "met"), (996, "met"), (995, "undecided"), (985, "undecided"), (984, "not met")]
)
def test_success_requirement_matches_binomial_tails(successes, outcome):
    """met: fewer failures than 5 % of campaigns at exactly 0.99 would have; not met: more than 5 % would have."""
    found = judged("success >= 0.99 @ 95%", success=trials(successes, 1000))
    so_many, so_few = stats.binom.sf(successes - 1, 1000, 0.99), stats.binom.cdf(successes, 1000, 0.99)
    assert outcome == ("met" if so_many <= 0.05 else "not met" if so_few < 0.05 else "undecided")
    assert (found.outcome, found.is_met) == (outcome, outcome == "met")
    assert found.value == successes / 1000


def test_upper_limit_on_success_is_judged():
    assert judged("success <= 0.05", success=trials(0, 100)).outcome == "met"
    assert judged("success <= 0.05", success=trials(5, 100)).outcome == "undecided"
    assert judged("success <= 0.05", success=trials(30, 100)).outcome == "not met"


@pytest.mark.parametrize(("p", "relation"), [(0.95, "<="), (0.95, ">="), (0.2, "<="), (0.2, ">=")])
def test_quantile_requirement_equals_share_within_limit(p, relation):
    """An order statistic below the limit, and enough runs below the limit, are the same statement."""
    rng = np.random.default_rng(4)
    seen = set()
    for limit in np.linspace(-3, 3, 61):
        x = rng.normal(size=300)
        count = int((x <= limit).sum())
        shown = stats.binom.sf(count - 1, 300, p) <= 0.05  # P(x <= limit) is at least p
        denied = stats.binom.cdf(count, 300, p) <= 0.05
        if relation == ">=":
            shown, denied = denied, shown
        expected = "met" if shown else "not met" if denied else "undecided"
        assert judged(f"p{100 * p:g}(a_b) {relation} {limit}", a_b=x).outcome == expected
        seen.add(expected)
    assert seen == {"met", "not met", "undecided"}


def test_non_finite_runs_count_as_violations():
    x = np.r_[np.zeros(940), [np.nan] * 30, [np.inf] * 30]
    below, above = judged("p95(m) <= 1", m=x), judged("p5(m) >= -1", m=x)
    assert (below.outcome, above.outcome) == ("undecided", "undecided")
    assert (below.value, above.value) == (math.inf, -math.inf)
    assert below.not_finite == above.not_finite == 60
    assert "60 runs have no finite value and count as violations" in str(below)
    assert judged("p90(m) <= 1", m=x).is_met
    assert judged("mean(m) <= 1", m=x).outcome == judged("max(m) <= 1", m=x).outcome == "not met"


def test_too_few_runs_are_undecided_and_needed_runs_stated():
    found = judged("success >= 0.99", success=trials(298, 298))
    assert found.outcome == "undecided"
    assert "at least 299 runs are needed" in str(found)
    assert judged("success >= 0.99", success=trials(299, 299)).is_met
    assert not judged("success >= 0.99", True, success=trials(299, 299)).is_met


def test_mean_requirement_is_met_undecided_or_not_met():
    x = np.random.default_rng(0).normal(2, 1, 400)
    width = stats.t.ppf(0.95, 399) * stats.sem(x)
    for limit, outcome in ((1.05, "met"), (0.5, "undecided"), (-1.05, "not met")):
        assert judged(f"mean(m) <= {x.mean() + limit * width}", m=x).outcome == outcome
    assert judged("mean(m) <= 9", m=np.full(500, 3.0)).outcome == "undecided"


def test_max_and_min_requirements_judge_only_flown_runs():
    x = np.arange(1000.0)
    found = judged("max(m) <= 999", m=x)
    assert found.is_met
    share = float(str(found).split("at least ")[1].split(" %")[0]) / 100
    assert share**1000 == pytest.approx(0.05, rel=0.05)  # of 1000 runs, none beyond
    assert not judged("max(m) <= 998", m=x).is_met
    assert judged("min(m) >= 0", m=x).is_met
    assert judged("max(m) >= 999", m=x).is_met
    assert "of all possible runs" not in str(judged("max(m) >= 999", m=x))


def test_verdict_text_names_the_deciding_bound():
    assert "at least 0.9937" in str(judged("success >= 0.99", success=trials(998, 1000)))
    assert "at most 0.9" in str(judged("success >= 0.99", success=trials(900, 1000)))
    assert "one-sided" in str(judged("success >= 0.99", success=trials(998, 1000)))


@pytest.mark.thorough
def test_false_acceptance_rate_is_at_most_5_percent():
    """The true probability or quantile lies exactly at the limit; 2000 campaigns each."""
    rng = np.random.default_rng(9)
    met = [judged("success >= 0.9", success=trials(k, 400)).is_met for k in rng.binomial(400, 0.9, 2000)]
    assert 0.02 < np.mean(met) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 2000)
    limit = float(stats.expon.ppf(0.9))
    met = [judged(f"p90(m) <= {limit}", m=rng.exponential(size=400)).is_met for _ in range(2000)]
    assert 0.02 < np.mean(met) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 2000)


@pytest.mark.parametrize("success", [[0.5, 1.0], [np.nan, 1.0], [], [[True]]])
def test_rejects_invalid_success_column(success):
    with pytest.raises(InputError, match="success"):
        judged("success >= 0.5", success=success)


@pytest.mark.parametrize(
    ("text", "runs"),
    [
        ("success >= 0.99 @ 95%", 299),
        ("success <= 0.01 @ 95%", 299),
        ("p95(x) <= 1 @ 95%", 59),
        ("p5(x) >= 1 @ 95%", 59),
        ("p99(x) >= 1 @ 95%", 1),
        ("max(x) <= 1", 1),
        ("mean(x) <= 1", 30),
    ],
)
def test_least_runs_match_the_tolerance_tables(text, runs):
    """299 and 59: the numbers every tolerance table has (Wilks 1941)."""
    requirement = parse_requirement(text)
    assert least_runs(requirement) == runs
    if requirement.statistic == "success" and requirement.relation == ">=":
        assert stats.binom.cdf(runs - 1, runs, 0.99) >= 0.95 > stats.binom.cdf(runs - 2, runs - 1, 0.99)
    if runs > 100:
        assert least_runs(requirement, anytime=True) > runs

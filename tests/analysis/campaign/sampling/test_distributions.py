"""Distributions compared with scipy.stats, their texts, and invalid ones."""

import numpy as np
import pytest
from scipy import stats

from trimtab.analysis.campaign.sampling.distributions import check_nominal, parse_distribution
from trimtab.core.errors import InputError

U = np.linspace(0.001, 0.999, 999)


@pytest.mark.parametrize(
    ("text", "oracle"),
    [
        ("normal(2.6, 0.1)", stats.norm(2.6, 0.1)),
        ("uniform(-1, 3)", stats.uniform(-1, 4)),
        ("lognormal(2, 0.5)", stats.lognorm(0.5, scale=2)),
        ("loguniform(0.1, 10)", stats.loguniform(0.1, 10)),
        ("truncated(1, 2, 0, 4)", stats.truncnorm(-0.5, 1.5, 1, 2)),
    ],
)
def test_quantiles_match_scipy(text, oracle):
    np.testing.assert_allclose(parse_distribution(text).quantile(U, np.nan), oracle.ppf(U), rtol=1e-9, atol=1e-12)


def test_percentages_are_relative_to_the_nominal_value():
    assert parse_distribution("uniform(80%, 120%)").quantile(np.array([0.25]), -2.0) == pytest.approx(-1.8)
    mixed = parse_distribution("normal(2.6, 10%)")
    assert mixed.quantile(np.array([stats.norm.cdf(1.0)]), 3.0) == pytest.approx(2.9)
    assert not mixed.is_relative
    assert parse_distribution("normal(100%, 5%)").is_relative


@pytest.mark.parametrize(
    ("text", "median"),
    [
        ("truncated(0, 1, 10, 11)", 10.068409369547576),
        ("truncated(0, 1, -11, -10)", -10.068409369547576),
        ("truncated(0, 1, 40, 41)", 40.01731412676458),
        ("truncated(0, 1, 12, 1e6)", 12.057234557007263),
        ("truncated(0, 1, 990, 999)", 990.0007001477053),
        ("truncated(0, 1, 1001, 1001.000001)", 1001.00000049987490),
        ("truncated(0, 1, 15000, 16000)", 15000.000046209812),
        ("truncated(110%, 1%, 120%, 130%)", 1.2006841183608144),
    ],
)
def test_truncated_normal_is_accurate_far_from_the_mean(text, median):
    """The medians are roots of sf(z) = (sf(low) + sf(high))/2, computed with 60 digits."""
    found = parse_distribution(text).quantile(U, 1.0)
    bounds = parse_distribution(text).numbers(1.0)[2:]
    near = min(bounds, key=abs)
    assert abs(found[499] - near) == pytest.approx(abs(median - near), rel=2e-5)
    assert len(np.unique(found)) == len(U)
    assert (bounds[0] < found).all()
    assert (found < bounds[1]).all()


def test_lognormal_std_is_dimensionless():
    one_sigma = np.array([stats.norm.cdf(1.0)])
    assert parse_distribution("lognormal(2.6, 5%)").quantile(one_sigma, 100.0) == pytest.approx(2.6 * np.exp(0.05))
    for text in ("lognormal(100%, 5%)", "lognormal(100%, 0.05)"):
        assert parse_distribution(text).is_relative
        assert parse_distribution(text).quantile(one_sigma, 100.0) == pytest.approx(100 * np.exp(0.05))
    check_nominal("--spread x", parse_distribution("lognormal(2.6, 5%)"), 0.0)


def test_choices_are_equally_likely():
    picked = parse_distribution("choice(1, 2, 50%)").quantile((np.arange(3000) + 0.5) / 3000, 8.0)
    assert dict(zip(*np.unique(picked, return_counts=True), strict=True)) == {1.0: 1000, 2.0: 1000, 4.0: 1000}
    words = parse_distribution("choice(20 ms, 40 ms)")
    assert words.choices == ("20 ms", "40 ms")
    assert words.amounts == ()


def test_file_distribution_draws_from_a_column(tmp_path):
    file = tmp_path / "measured.csv"
    file.write_text("mass,arm\n2.7,1\n2.5,2\n2.6,3\n")
    found = parse_distribution(f"file({file}:mass)").quantile(np.array([0.1, 0.5, 0.9]), 1.0)
    assert found.tolist() == [2.5, 2.6, 2.7]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gauss(1, 2)", "unknown distribution"),
        ("normal(1)", "wrong number of arguments: 1"),
        ("normal(1, 0)", "STD must be above 0, got 0"),
        ("normal(1, x)", "'x'"),
        ("normal(1, inf)", "not finite"),
        ("uniform(3, 1)", "LOW 3 must be below HIGH 1"),
        ("lognormal(-1, 1)", "MEDIAN must be above 0, got -1"),
        ("choice()", "offers no choices"),
        ("file(nowhere.csv:mass)", "cannot read"),
        ("file(nowhere.csv)", "names no column"),
        ("2.6", "unknown distribution"),
    ],
)
def test_rejects_invalid_distribution_with_a_fix(text, problem):
    with pytest.raises(InputError, match=r"Fix: ") as refused:
        parse_distribution(text)
    assert problem in str(refused.value)


@pytest.mark.parametrize(
    ("content", "problem"), [("mass\n1\nx\n", "not a number"), ("mass\nnan\n", "not finite"), ("a\n1\n", "no column")]
)
def test_rejects_invalid_file_column(tmp_path, content, problem):
    file = tmp_path / "measured.csv"
    file.write_text(content)
    with pytest.raises(InputError, match=problem):
        parse_distribution(f"file({file}:mass)")


def test_rejects_percentage_of_a_zero_nominal_value():
    with pytest.raises(InputError, match="own value is 0"):
        check_nominal("--spread x", parse_distribution("normal(100%, 5%)"), 0.0)
    with pytest.raises(InputError, match="must be above 0"):
        check_nominal("--spread x", parse_distribution("normal(2, 10%)"), -1.0)

"""Requirements read from text."""

import math

import pytest
from scipy import stats

from trimtab.campaign.statistics.requirement import Requirement, parse_requirement
from trimtab.core.errors import InputError


def test_reads_every_form():
    text = "success >= 0.99 @ 95%"
    assert parse_requirement(text)[:3] == (text, "success", "success")
    assert parse_requirement(text)[4:] == (">=", 0.99, 0.95)
    settling = parse_requirement("p95(settling:yaw_rate) <= 10 @ 90%")
    assert settling == Requirement(settling.text, "quantile", "settling:yaw_rate", 0.95, "<=", 10.0, 0.90)
    assert parse_requirement(" p99.9( max:truth.sway_velocity )<=1e-1@0.99 ")[1:] == (
        "quantile", "max:truth.sway_velocity", pytest.approx(0.999), "<=", 0.1, 0.99,
    )  # fmt: skip
    assert parse_requirement("mean(rms:x) >= -2")[1:3] == ("mean", "rms:x")
    assert parse_requirement("mean(rms:x) >= -2").level == 0.95
    for name in ("max", "min"):
        found = parse_requirement(f"{name}(max:truth.x) <= 3")
        assert (found.statistic, found.metric) == (name, "max:truth.x")
        assert math.isnan(found.level)
    assert parse_requirement("success >= 99.5 %").bound == pytest.approx(0.995)
    assert parse_requirement("success <= 1% @ 99 %").bound == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "success >= 0.99 @ 95%"),
        ("success", "no comparison"),
        ("success > 0.99", "Choices: <=, >="),
        ("success == 1", "Choices: <=, >="),
        ("success >= 1", "no number of runs shows"),
        ("success <= 0", "no number of runs shows"),
        ("success >= often", "'often' is no finite number"),
        ("success >= nan", "no finite number"),
        ("success >= 0.9 @ 95", "'95' is no confidence"),
        ("success >= 0.9 @ 40%", "above 50 %"),
        ("success >= 0.9 @", "no confidence"),
        ("median(x) <= 1", "'median(x)' is no statistic"),
        ("p95 <= 1", "is no statistic"),
        ("p95(x <= 1", "is no statistic"),
        ("p95(x)) <= 1", "is no statistic"),
        ("p95() <= 1", "is no statistic"),
        ("p0(x) <= 1", "above p0, below p100"),
        ("p100(x) <= 1", "above p0, below p100"),
        ("p9.9.9(x) <= 1", "is no quantile"),
        ("mean(x) <= 10 s", "without a unit"),
        ("p95(x) <= 50%", "no finite number"),
        ("max(x) <= 1 @ 95%", "at no confidence"),
        ("1 <= mean(x) <= 2", "no comparison"),
    ],
)
def test_refuses_with_what_to_type(text, says):
    with pytest.raises(InputError) as caught:
        parse_requirement(text)
    assert says in str(caught.value)
    assert "Fix:" in str(caught.value)


def test_refuses_a_metric_that_is_not_there_before_anything_flies():
    wanted = parse_requirement("p95(settling:yaw_rat) <= 10")
    with pytest.raises(InputError, match=r"Choices: settling:yaw_rate"):
        wanted.check(["success", "settling:yaw_rate"])
    parse_requirement("success >= 0.9").check(["success"], anytime=True)
    with pytest.raises(InputError, match="fixed number"):
        parse_requirement("mean(x) <= 1").check(["x"], anytime=True)


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
def test_how_many_runs_it_takes_at_least(text, runs):
    """299 and 59: the numbers every tolerance table has (Wilks 1941)."""
    wanted = parse_requirement(text)
    assert wanted.least_runs() == runs
    if wanted.statistic == "success" and wanted.relation == ">=":
        assert stats.binom.cdf(runs - 1, runs, 0.99) >= 0.95 > stats.binom.cdf(runs - 2, runs - 1, 0.99)
    if runs > 100:
        assert wanted.least_runs(anytime=True) > runs

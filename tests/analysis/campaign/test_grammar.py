"""Texts of metrics, conditions, costs, requirements and stopping rules: parsing, and errors with a fix."""

import math

import numpy as np
import pytest

from trimtab.analysis.campaign.grammar import (
    Condition,
    CostTerm,
    MetricName,
    Requirement,
    parse_condition,
    parse_cost,
    parse_metric,
    parse_requirement,
    parse_stopping,
)
from trimtab.core.errors import InputError


def test_parses_metric_kind_or_file_function():
    assert parse_metric("settling:yaw_rate") == MetricName("settling", "yaw_rate")
    assert parse_metric("my/own.py:miss").is_function
    assert not parse_metric("peak:truth.x").is_function


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("settling:yaw_rate <= 10", ("settling:yaw_rate", "<=", 10.0)),
        ("  peak:truth.x>-2e1 ", ("peak:truth.x", ">", -20.0)),
        ("settling:x < inf", ("settling:x", "<", math.inf)),
        ("a=b@c/own.py:miss >= 1", ("a=b@c/own.py:miss", ">=", 1.0)),
    ],
)
def test_parses_conditions(text, condition):
    assert parse_condition(text) == Condition(*condition)


@pytest.mark.parametrize("text", ["", "settling:x", "x <= ", "<= 3", "x == 3", "x <= soon", "x <= 3 @ 95%"])
def test_rejects_invalid_condition_with_a_fix(text):
    with pytest.raises(InputError, match=r"success=\[\"settling:yaw_rate <= 10\"\]"):
        parse_condition(text)


def test_rejects_bound_with_a_unit():
    with pytest.raises(InputError, match=r"'3 s' has a unit.*\n.*success=\[\"x <= 3\"\]"):
        parse_condition("x <= 3 s")


def test_formula_is_a_condition_on_its_robustness():
    formula = "eventually[0, 8 s](always(abs(truth.heading) < 3 deg))"
    assert parse_condition(f" {formula} ") == Condition(f"robustness:{formula}", ">", 0.0)
    assert parse_condition(f"robustness:{formula} >= 0.1") == Condition(f"robustness:{formula}", ">=", 0.1)
    assert parse_metric(f"robustness:{formula}") == MetricName("robustness", formula)
    assert parse_condition("settling:always <= 3").metric == "settling:always"


def test_robustness_is_accepted_in_requirement_stopping_and_cost():
    metric = "robustness:always[1 s, 2 s](abs(x + 1 m) < 3 m and y >= 0)"
    found = parse_requirement(f"p5({metric}) >= 0.1 @ 90%")
    assert (found.metric, found.relation, found.bound) == (metric, ">=", 0.1)
    assert parse_requirement(f"min({metric}) >= 0").metric == metric
    assert parse_stopping(f"width(p50({metric})) <= 0.1").metric == metric
    wanted = (CostTerm(1.0, "rms:x"), CostTerm(-1.0, metric), CostTerm(-0.5, metric), CostTerm(2.0, "rms:v"))
    assert parse_cost(f"rms:x + -{metric} + -0.5*{metric} + 2*rms:v") == wanted
    for text in (metric, f"2*{metric}", f"0*{metric}"):
        with pytest.raises(InputError, match="a large robustness is good"):
            parse_cost(text)


def test_condition_is_false_for_nan_metric():
    assert parse_condition("x <= 1").holds(np.array([0.0, 1.0, 2.0, np.nan])).tolist() == [True, True, False, False]


def test_parses_weighted_cost_terms():
    assert parse_cost("error_rms:yaw_rate + 2*rms:v +  1e-3 * peak:x") == (
        CostTerm(1.0, "error_rms:yaw_rate"),
        CostTerm(2.0, "rms:v"),
        CostTerm(1e-3, "peak:x"),
    )


@pytest.mark.parametrize("text", ["", "0*rms:x", "-1*rms:x", "1e999*rms:x", "1-2*rms:x", "rms:x + ", "rms:x rms:y"])
def test_rejects_invalid_cost(text):
    with pytest.raises(InputError, match="not a metric with a positive weight"):
        parse_cost(text)


def test_parses_every_form_of_requirement():
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
        requirement = parse_requirement(f"{name}(max:truth.x) <= 3")
        assert (requirement.statistic, requirement.metric) == (name, "max:truth.x")
        assert math.isnan(requirement.level)
    assert parse_requirement("success >= 99.5 %").bound == pytest.approx(0.995)
    assert parse_requirement("success <= 1% @ 99 %").bound == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "success >= 0.99 @ 95%"),
        ("success", "must compare a statistic with a number"),
        ("success > 0.99", "Choices: <=, >="),
        ("success == 1", "Choices: <=, >="),
        ("success >= 1", "a finite number of runs cannot prove"),
        ("success <= 0", "a finite number of runs cannot prove"),
        ("success >= often", "'often' is not a finite number"),
        ("success >= nan", "not a finite number"),
        ("success >= 0.9 @ 95", "'95' is not a valid confidence"),
        ("success >= 0.9 @ 40%", "above 50 %"),
        ("success >= 0.9 @", "not a valid confidence"),
        ("median(x) <= 1", "unknown statistic 'median(x)'"),
        ("p95 <= 1", "unknown statistic"),
        ("p95(x <= 1", "unknown statistic"),
        ("p95(x)) <= 1", "unknown statistic"),
        ("p95() <= 1", "unknown statistic"),
        ("p0(x) <= 1", "above 0 and below 100"),
        ("p100(x) <= 1", "above 0 and below 100"),
        ("p9.9.9(x) <= 1", "is not a quantile"),
        ("mean(x) <= 10 s", "without the unit"),
        ("p95(x) <= 50%", "not a finite number"),
        ("max(x) <= 1 @ 95%", "cannot bound the max"),
        ("1 <= mean(x) <= 2", "must compare a statistic with a number"),
    ],
)
def test_rejects_invalid_requirement_with_a_fix(text, says):
    with pytest.raises(InputError) as caught:
        parse_requirement(text)
    assert says in str(caught.value)
    assert "Fix:" in str(caught.value)


def test_requirement_rejects_missing_metric_before_flying():
    requirement = parse_requirement("p95(settling:yaw_rat) <= 10")
    with pytest.raises(InputError, match=r"Choices: settling:yaw_rate"):
        requirement.check(["success", "settling:yaw_rate"])
    parse_requirement("success >= 0.9").check(["success"], anytime=True)
    with pytest.raises(InputError, match="stops early because of its results"):
        parse_requirement("mean(x) <= 1").check(["x"], anytime=True)


def test_parses_both_forms_of_stopping_rule():
    rule = parse_stopping("width(success) <= 0.01 @ 99%")
    assert (rule.statistic, rule.metric, rule.width, rule.level) == ("success", "success", 0.01, 0.99)
    rule = parse_stopping("width( p95(max:truth.x) ) <= 0.5")
    assert (rule.statistic, rule.metric, rule.p, rule.width, rule.level) == (
        "quantile",
        "max:truth.x",
        0.95,
        0.5,
        0.95,
    )


@pytest.mark.parametrize(
    "text",
    [
        "success", "width(success)", "width(success) >= 0.1", "width(success) <= 0", "width(success) <= 1",
        "width(mean(x)) <= 1", "width(max(x)) <= 1", "width(success) <= 0.1 @ 95", "width(p95(x)) <= wide",
    ],
)  # fmt: skip
def test_rejects_invalid_stopping_rule_with_a_fix(text):
    with pytest.raises(InputError, match=r"stopping '.*\n(Choices.*\n)?Fix:"):
        parse_stopping(text)


def test_stopping_rule_rejects_missing_metric():
    with pytest.raises(InputError, match="Choices: settling:a"):
        parse_stopping("width(p50(settling:b)) <= 1").check(["success", "settling:a"])

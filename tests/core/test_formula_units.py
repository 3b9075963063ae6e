"""Units in formulas: conversion to SI, and the column at which a wrong unit is rejected."""

import math

import pytest

from trimtab.core.errors import InputError
from trimtab.core.formula import Literal
from trimtab.core.formula_units import MIXED, fit_formula, format_dimension, least_length, look_ahead, parse_dimension
from trimtab.core.time import seconds

UNITS = {
    "truth.yaw_rate": "rad/s", "truth.heading": "rad", "fan.speed": "rpm", "truth.v": "m/s", "law.mode": "1",
    "world.mass": "kg", "sensor.a": "m/s^2", "p": "m", "odd": "(slug ft)^1/2",
}  # fmt: skip
SHAPES = {path: (3,) if path == "p" else () for path in UNITS}


def fit(text):
    return fit_formula(text, SHAPES, UNITS, _full)


def _full(name):
    return {"yaw_rate": "truth.yaw_rate"}.get(name, name)


def literals(tree):
    """The numbers of a tree, in order."""
    if isinstance(tree, Literal):
        return [tree.value]
    below = [part for part in tree if isinstance(part, tuple)]
    return [value for part in below for value in literals(part)]


@pytest.mark.parametrize(
    ("text", "values", "unit"),
    [
        ("always(yaw_rate < 90 deg/s)", [math.pi / 2], "rad/s"),
        ("always(90 deg/s > yaw_rate)", [math.pi / 2], "rad/s"),
        ("always(yaw_rate < 60 rpm)", [2 * math.pi], "rad/s"),
        ("always(fan.speed < 3 krpm)", [3000.0], "rpm"),
        ("always(fan.speed < 1 Hz)", [60.0], "rpm"),
        ("always(abs(yaw_rate - 3) < 0.15)", [3.0, 0.15], "rad/s"),
        ("always(world.mass < 500 g)", [0.5], "kg"),
        ("always(sensor.a < 2 g)", [2 * 9.80665], "m/s^2"),
        ("always(truth.v * truth.v < 4)", [4.0], "m^2/s^2"),
        ("always(truth.v * 1 s + p[2] < 30 cm)", [1.0, 0.3], "m"),
        ("always(truth.v / 2 s < sensor.a)", [2.0], "m/s^2"),
        ("always(truth.heading / 1 deg < 3)", [math.pi / 180, 3.0], "1"),
        ("always(law.mode == 2)", [2.0], "1"),
        ("always(law.mode < 5 %)", [0.05], "1"),
        ("always(odd < 3)", [3.0], "(slug ft)^1/2"),
        ("always(yaw_rate < 1 rad/s) and always(p[0] < 1 m)", [1.0, 1.0], MIXED),
        ("always(yaw_rate < 1) and always(yaw_rate > 100 mrad/s)", [1.0, 0.1], "rad/s"),
    ],
)
def test_literals_are_converted_to_si_units(text, values, unit):
    fitted = fit(text)
    assert literals(fitted.root) == pytest.approx(values)
    assert fitted.unit == unit
    assert fitted.text == text


def test_signal_paths_are_complete_and_unique():
    assert fit("always(yaw_rate > p[0] / 1 m * 1 rad/s and p[1] < truth.v * 2 s)").paths == (
        "truth.yaw_rate", "p", "truth.v",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "column", "says"),
    [
        ("always(yaw_rat < 1)", 8, "there is no signal 'yaw_rat'.\nChoices: truth.yaw_rate"),
        ("always(truth < 1)", 8, "Choices: truth.yaw_rate, truth.heading, truth.v"),
        ("always(yaw_rate < 1 m)", 17, "rad/s and m are compared by <"),
        ("always(1 m > yaw_rate)", 12, "m and rad/s are compared by >"),
        ("always(yaw_rate + truth.v > 0)", 17, "rad/s and m/s are added"),
        ("always(yaw_rate - 2 m > 0)", 17, "rad/s and m are subtracted"),
        ("always(truth.v * 2 s < 3 m/s)", 22, "m and m/s are compared"),
        ("always(p < 1)", 8, "Fix: write p[0]"),
        ("always(p[3] < 1)", 8, "'p' has 3 components"),
        ("always(yaw_rate[0] < 1)", 8, "has no components"),
        ("always(1 < 2) and always(yaw_rate < 1)", 10, "both sides of the comparison are constants"),
    ],
)
def test_rejects_unit_mismatch_with_the_column(text, column, says):
    with pytest.raises(InputError) as refused:
        fit(text)
    assert f"at column {column}: " in str(refused.value)
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("unit", "plain"),
    [("rad/s", "rad/s"), ("1", "1"), ("kg m^2", "kg m^2"), ("N s^2/m^2", "N s^2/m^2"), ("1/s", "1/s"), ("U^2", "U^2")],
)
def test_dimension_is_parsed_and_formatted_back(unit, plain):
    assert format_dimension(parse_dimension(unit)) == plain


def test_look_ahead_and_length_of_formulas():
    for text, ahead, length in (
        ("yaw_rate < 1", 0, 0),
        ("always[1 s, 5 s](yaw_rate < 1)", 5, 5),
        ("always[1 s, 5 s](eventually[0, 2 s](yaw_rate < 1))", 7, 7),
        ("once[1 s, 5 s](eventually[0, 2 s](yaw_rate < 1))", 2, 2),
        ("always[3 s, inf](eventually[0, 2 s](yaw_rate < 1))", None, 5),
        ("(yaw_rate < 1) until[0, 4 s] always[0, 1 s](yaw_rate > 1)", 5, 5),
        ("always(yaw_rate < 1) or not always[0, 9 s](yaw_rate < 1)", None, 9),
    ):
        root = fit(text).root
        assert look_ahead(root) == (None if ahead is None else seconds(ahead))
        assert least_length(root) == seconds(length)

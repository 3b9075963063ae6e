"""Verdicts of rows: each relation on both sides of its edge."""

import json
import math

import pytest

from trimtab.study import (
    at_most,
    band,
    direction,
    format_value,
    inside,
    missing_row,
    overlaps,
    rows_table,
    same,
    within,
)

HOLDING = {
    "within": within("a", "x", 2.0, 2.1, "p", tolerance=0.1001),
    "relative": within("a", "x", -2.0, -2.1, "p", relative=0.051),
    "both": within("a", "x", 2.0, 2.3, "p", tolerance=0.11, relative=0.1),
    "band": band("a", "x", "about 5", 4.0, "p", low=4.0, high=6.0),
    "at most": at_most("a", "x", "-", -9.0, "p", high=1.0),
    "inside": inside("a", "x", (-1.0, 1.0), (-1.0, 0.5), "p"),
    "overlaps": overlaps("a", "x", (-1.0, 1.0), (1.0, 5.0), "p"),
    "direction": direction("a", "x", "slower", 1.01, "p", above=1.0),
    "same": same("a", "x", (14, 81), (14, 81), "p"),
}
FAILING = {
    "within": within("a", "x", 2.0, 2.1, "p", tolerance=0.0999),
    "relative": within("a", "x", -2.0, -2.1, "p", relative=0.049),
    "band": band("a", "x", "about 5", 6.001, "p", low=4.0, high=6.0),
    "at most": at_most("a", "x", "-", 1.001, "p", high=1.0),
    "inside": inside("a", "x", (-1.0, 1.0), (-1.001, 0.5), "p"),
    "overlaps": overlaps("a", "x", (-1.0, 1.0), (1.001, 5.0), "p"),
    "direction": direction("a", "x", "slower", 1.0, "p", above=1.0),
    "same": same("a", "x", (14, 81), (14, 82), "p"),
    "not a number": within("a", "x", 2.0, math.nan, "p", tolerance=math.inf),
    "never": band("a", "x", 5.0, math.inf, "p", low=4.0, high=6.0),
}


@pytest.mark.parametrize("row", HOLDING.values(), ids=HOLDING)
def test_each_relation_holds_inside_its_limit(row):
    assert (row.verdict, row.fails) == ("holds", False)


@pytest.mark.parametrize("row", FAILING.values(), ids=FAILING)
def test_each_relation_differs_outside_its_limit(row):
    assert (row.verdict, row.fails) == ("differs", True)


def test_failed_optional_row_is_not_reproduced():
    about = {"tolerance": 0.1, "must_hold": False, "note": "why"}
    assert within("a", "x", 2.0, 3.0, "p", **about).verdict == "not reproduced"
    assert within("a", "x", 2.0, 2.0, "p", **about).verdict == "holds"
    nothing = missing_row("a", "x", 2.0, "p", note="why")
    assert (nothing.verdict, nothing.fails) == ("not reproduced", False)


@pytest.mark.parametrize(
    "bad",
    [
        {"citation": ""},
        {"id": ""},
        {"what": ""},
        {"citation": "p", "must_hold": False},
    ],
)
def test_rejects_row_without_citation_or_reason(bad):
    given = {"id": "a", "what": "x", "printed": 1.0, "computed": 1.0, "citation": "p"} | bad
    with pytest.raises(ValueError, match=r"needs an id|state the reason"):
        within(**given)


def test_json_writes_infinite_values_as_null():
    row = direction("a", "x", "slower", math.inf, "p", above=1.0)
    plain = json.loads(json.dumps(row.as_json(), allow_nan=False))
    assert plain["computed"] is None
    assert plain["accepted"] == [1.0, None]
    assert plain["verdict"] == "differs"


def test_values_and_tolerances_are_formatted_as_text():
    assert [format_value(v) for v in (None, True, 1.23456, (14, 81), (-1.0, 0.5), "slower", 22)] == [
        "-",
        "yes",
        "1.235",
        "14 x 81",
        "-1 … 0.5",
        "slower",
        "22",
    ]
    words = {name: row.tolerance for name, row in HOLDING.items()}
    assert words == {
        "within": "± 0.1",
        "relative": "± 0.102",
        "both": "± 0.31",
        "band": "4 … 6",
        "at most": "≤ 1",
        "inside": "in -1 … 1",
        "overlaps": "meets -1 … 1",
        "direction": "> 1",
        "same": "exact",
    }


def test_markdown_escapes_bars_and_stars_unprinted_values():
    text = rows_table([within("a", "|e|", 1.0, 1.0, "p", tolerance=0.1, basis="reference"), FAILING["band"]])
    first, second = text.splitlines()[2:]
    assert first.startswith("| \\|e\\| | 1 \\* | 1 | ± 0.1 |")
    assert "**differs**" in second

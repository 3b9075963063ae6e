"""Robustness compared with its definition, with RTAMT, and with hand calculations for short logs and NaN."""

import math
import time

import numpy as np
import pytest
from oracles.temporal_logic import PAIRS, TABLE, checksum, draw_pair, robustness_at, write_formula

from trimtab.core.errors import InputError
from trimtab.core.formula_units import fit_formula
from trimtab.core.quantity import Quantity
from trimtab.core.time import UNITS_PER_SECOND, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.robustness import EQUALITY_ROBUSTNESS, assess_formula, robustness, slide

SHAPES, UNITS = {"x": (), "y": ()}, {"x": "m", "y": "m"}


def evaluate(text, signals, t=None):
    """Robustness at each row, of equal numbers 0; signals (m,) or (n, m), rows a second apart."""
    x = {name: np.atleast_2d(values) for name, values in signals.items()}
    t = np.arange(x["x"].shape[1]) if t is None else t
    formula = fit_formula(text, SHAPES, UNITS)
    rows = robustness(formula, np.round(np.asarray(t) * UNITS_PER_SECOND).astype(np.int64), x.__getitem__)
    rows = np.where(np.abs(rows) <= EQUALITY_ROBUSTNESS, 0.0, rows)
    return rows[0] if np.ndim(signals["x"]) == 1 else rows


@pytest.mark.thorough
@pytest.mark.parametrize("pairs", [range(2500), pytest.param(range(2500, PAIRS), marks=pytest.mark.thorough)], ids=str)
def test_robustness_equals_rtamt_at_all_rows(pairs):
    table = np.load(TABLE)
    for k in pairs:
        tree, signals = draw_pair(k)
        rows = evaluate(write_formula(tree), signals)
        assert np.float32(rows[0]) == table["first"][k], (k, write_formula(tree))
        assert checksum(rows) == table["checksums"][k], (k, write_formula(tree))


@pytest.mark.thorough
def test_robustness_equals_definition_and_table_covers_operators():
    table, words = np.load(TABLE), set()
    for k in range(400):
        tree, signals = draw_pair(k)
        text, m = write_formula(tree), len(signals["x"])
        words |= set(text.replace("(", " ").replace("[", " ").split())
        wanted = [robustness_at(tree, signals, i) for i in range(m)]
        assert evaluate(text, signals).tolist() == wanted, (k, text)
        assert checksum(wanted) == table["checksums"][k]
    assert {"always", "eventually", "until", "historically", "once", "since", "not", "and", "or", "implies"} <= words
    assert len(np.unique(table["first"])) > 60
    assert 0.3 < np.mean(table["first"] > 0) < 0.6
    assert 0.01 < np.mean(np.isinf(table["first"])) < 0.4


X = [3.0, 1.0, 4.0, 1.0, 5.0]


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("always[0, 2](x < 6)", [2, 2, 1, 1, 1]),  # both ends count; at the end of the log those rows that there are
        ("always[1, 2](x < 6)", [2, 2, 1, 1, math.inf]),  # of no rows it holds without limit
        ("eventually[1, 2](x > 0)", [4, 4, 5, 5, -math.inf]),
        ("eventually[0.5, 1.5](x > 0)", [1, 4, 1, 5, -math.inf]),  # ends between rows: the rows inside
        ("eventually[0.2, 0.8](x > 0)", [-math.inf] * 5),
        ("always(x > 0)", [1, 1, 1, 1, 5]),
        ("once[1, 2](x > 0)", [-math.inf, 3, 3, 4, 4]),
        ("historically[0, 1](x > 0)", [3, 1, 1, 1, 1]),
        ("x > 2 until x > 3.5", [-0.5, -1, 0.5, -1, 1.5]),
        ("x > 0 until[2, 3] x > 4", [0, 1, 1, -math.inf, -math.inf]),
        ("x > 0 since[1, 2] x > 3.5", [-math.inf, -0.5, -0.5, 0.5, 0.5]),
    ],
)
def test_robustness_matches_values_computed_by_hand(text, rows):
    assert evaluate(text, {"x": np.array(X), "y": np.array(X)}).tolist() == rows


def logged(x, duration=None):
    ticks = np.arange(len(x)) * UNITS_PER_SECOND
    about = {} if duration is None else {"duration_s": duration}
    x = np.asarray(x, np.float64)
    return Log(to_seconds(ticks), ticks, {"a.x": x, "a.p": np.stack([x, -x], 1)}, {"a.x": Quantity("m", "")}, about)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("always(a.x < 5 m)", False), ("always(a.x <= 5 m)", True),
        ("eventually(a.x > 5 m)", False), ("eventually(a.x >= 5 m)", True),
        ("not always(a.x <= 5 m)", False), ("not always(a.x < 5 m)", True), ("eventually(a.x == 4 m)", True),
        ("always(a.x != 4 m)", False), ("always(a.x != 2 m)", True), ("eventually(not a.x != 5 m)", True),
        ("a.x == 3 m implies eventually[0, 1](a.x == 1 m)", True),
        ("a.x == 3 m implies always[0, 1](a.x > 1 m)", False),
    ],
)  # fmt: skip
def test_strict_and_weak_comparison_differ_at_equality(text, holds):
    assessed = assess_formula(logged(X), text)
    assert assessed.holds is holds
    assert abs(assessed.robustness) <= 2.0
    assert "1e-30" not in str(assessed)


@pytest.mark.parametrize("text", ["x < 3", "x >= 3", "x == 3", "x != 3"])
def test_nan_satisfies_neither_comparison_nor_negation(text):
    x = {"x": np.array([math.nan, 1.0]), "y": np.zeros(2)}
    assert evaluate(text, x)[0] == evaluate(f"not({text})", x)[0] == -math.inf
    assert evaluate(f"always({text} or not({text}))", x)[0] == -math.inf
    assert evaluate(f"({text}) implies 1 < y", x)[0] == -1  # a premise that is none says nothing: by the rest
    assert evaluate("eventually(x < 3)", x).tolist() == [2, 2]


def test_rejects_log_shorter_than_the_formula_horizon():
    assert assess_formula(logged(X, duration=5.0), "always[0, 5 s](a.x < 6 m)").robustness == 1
    assert assess_formula(logged(X), "always[0, 4 s](a.x < 6 m)").robustness == 1
    for log, text in (
        (logged(X, 5.0), "always[0, 6 s](a.x < 6 m)"),
        (logged(X), "always[0, 2 s](once(always[0, 3 s](a.x < 6)))"),
    ):
        with pytest.raises(InputError, match=r"looks . s ahead, but the run lasts . s.\nFix: settings={.duration"):
            assess_formula(log, text)
    assert str(assess_formula(logged(X), "always(a.p[1] > -5.5)")) == "holds, robustness 0.5: always(a.p[1] > -5.5)"
    assert str(assess_formula(logged(X), "always(a.x < 4)")) == "VIOLATED, robustness -1 m: always(a.x < 4)"


def test_batched_runs_equal_single_runs_at_uneven_times():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.integers(1, 60_000, 400)) / UNITS_PER_SECOND * 10
    runs = {"x": rng.normal(size=(7, 400)), "y": rng.normal(size=(7, 400))}
    for text in ("always[0.1, 0.7](x > y)", "(x > y) until[0.2, 0.9] y > 1", "once[0.3, inf](x > 1) since[0, 1] y > 0"):
        together = evaluate(text, runs, t)
        for k in range(7):
            alone = evaluate(text, {name: x[k] for name, x in runs.items()}, t)
            assert together[k].tobytes() == alone.tobytes()
    always = evaluate("always[0.1, 0.7](x > y)", runs, t)
    for i in range(0, 400, 13):
        inside = (t >= t[i] + 0.1 - 1e-9) & (t <= t[i] + 0.7 + 1e-9)
        wanted = np.where(inside, runs["x"] - runs["y"], np.inf).min(axis=1)
        assert np.array_equal(always[:, i], wanted)


@pytest.mark.real_time
def test_window_cost_is_independent_of_window_length():
    x = np.random.default_rng(0).normal(size=(200_000, 1))
    rows = np.arange(len(x))

    def duration(w):
        last, best = np.minimum(rows + w, len(x) - 1), math.inf
        for _ in range(3):
            begin = time.perf_counter()
            found = slide(x, rows, last, np.minimum)
            best = min(best, time.perf_counter() - begin)
        assert found[1000, 0] == x[1000 : 1001 + w].min()
        return best

    assert duration(50_000) < 4 * duration(500)  # 100 times as long; the dumb way would take 100 times the time

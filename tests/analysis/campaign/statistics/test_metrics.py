"""Metrics of a block compared with those of each single log, and invalid metric texts."""

import numpy as np
import pytest

from trimtab.analysis.campaign.statistics.metrics import Rows, find_metric, first_reach
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, metrics
from trimtab.logs.robustness import assess_formula

TARGETS = (Target("yaw_rate", 1.0, band=0.1), Target("heading", 3.0, band=0.2))
SIGNALS = {"truth.yaw_rate": (), "truth.heading": (), "truth.position": (2,)}
T = np.arange(400) * 0.01


def some_runs():
    """Decays that settle, that don't, that start at the target, are NaN from somewhere on, or wind round the circle."""
    rng = np.random.default_rng(1)
    rate, ripple = rng.uniform(0.2, 6, (60, 1)), rng.uniform(0, 0.2, (60, 1))
    yaw = 1 + rng.normal(0, 1, (60, 1)) * np.exp(-rate * T) + ripple * np.sin(9 * T)
    yaw[3] = 1.0
    yaw[4, 200:] = np.nan
    yaw[5, 0] = 1.0
    yaw[6] = np.inf
    heading = 3 + 2 * np.pi * rng.integers(-2, 3, (60, 1)) + rng.normal(0, 1, (60, 1)) * np.exp(-rate * T)
    return {"truth.yaw_rate": yaw, "truth.heading": heading}


@pytest.fixture(scope="module")
def runs():
    return some_runs()


def column(runs, text):
    rows = Rows(T, runs, TARGETS, frozenset({"truth.heading"}))
    with np.errstate(all="ignore"):
        return find_metric(text, SIGNALS, TARGETS).of(rows)


@pytest.mark.parametrize("signal", ["yaw_rate", "heading"])
@pytest.mark.parametrize("kind", ["settling", "first_reach", "overshoot", "tail_mean", "tail_rms"])
def test_block_metrics_equal_single_log_metrics(runs, kind, signal):
    found = column(runs, f"{kind}:{signal}")
    declared = {"truth.yaw_rate": Quantity("rad/s", ""), "truth.heading": Quantity("rad", "", kind="angle")}
    for i in range(60):
        log = Log(T, (T * 1e7).round().astype(np.int64), {p: x[i] for p, x in runs.items()}, declared, {}, {})
        alone = metrics(log, TARGETS, [signal])[signal]
        expected = alone.get(f"{kind}_s", alone.get(kind))
        if expected is None:
            assert not np.isfinite(found[i])
        else:
            assert found[i] == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    ("kind", "oracle"),
    [
        ("final", lambda x: x[-1]),
        ("least", np.min),
        ("most", np.max),
        ("peak", lambda x: np.abs(x).max()),
        ("mean", np.mean),
        ("rms", lambda x: np.sqrt((x**2).mean())),
        ("error_rms", lambda x: np.sqrt(((x[T[-1] / 2 <= T] - 1) ** 2).mean())),
    ],
)
def test_reductions_match_numpy(runs, kind, oracle):
    found = column(runs, f"{kind}:yaw_rate")
    for i in (0, 1, 2, 3, 59):
        assert found[i] == pytest.approx(oracle(runs["truth.yaw_rate"][i]), rel=1e-12)


def test_sustained_metric_separates_limit_cycle_from_decay():
    turn = 2 * np.pi * T / (T[-1] / 12)
    swings = {
        "dies away": np.exp(-4 * T / T[-1]) * np.sin(turn),
        "limit cycle": 2.0 + 0.3 * np.sin(turn),
        "grows": np.exp(T / T[-1]) * np.sin(turn),
        "offset": np.full(len(T), 2.0),
        "settles to a small cycle": 0.01 * np.sin(turn) + np.exp(-20 * T / T[-1]),
    }
    yaw = np.stack([*swings.values()])
    rows = Rows(T, {"truth.yaw_rate": yaw, "truth.heading": yaw}, TARGETS, frozenset())
    found = find_metric("sustained:yaw_rate", SIGNALS, TARGETS).of(rows)
    np.testing.assert_allclose(found[[0, 1, 3, 4]], [0.0, 0.3, 0.0, 0.01], rtol=0.03)
    assert 2 < found[2] < np.e


@pytest.mark.parametrize("kind", ["error_rms", "most", "peak", "rms", "tail_rms", "sustained", "settling", "overshoot"])
def test_diverged_run_has_infinite_metric(runs, kind):
    assert np.isposinf(column(runs, f"{kind}:yaw_rate")[4])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("settle:yaw_rate", "write KIND:SIGNAL"),
        ("settling:surge_velocity", "no target"),
        ("rms:truth.surge", "no signal"),
        ("rms:truth.position", "shape"),
        ("nowhere.py:miss", "no file"),
        ("rms", "write KIND:SIGNAL"),
    ],
)
def test_rejects_invalid_metric_text(text, problem):
    with pytest.raises(InputError, match=r"Fix: ") as refused:
        find_metric(text, SIGNALS, TARGETS)
    assert problem in str(refused.value)


def test_function_in_a_file_is_used_as_metric(runs, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text('def last(rows):\n    return rows["yaw_rate"][:, -1]\n\n\nlast.signals = ("truth.yaw_rate",)\n')
    found = find_metric(f"{file}:last", SIGNALS, TARGETS)
    assert found.signals == ("truth.yaw_rate",)
    assert found.of(Rows(T, runs, TARGETS, frozenset()))[7] == runs["truth.yaw_rate"][7, -1]
    with pytest.raises(InputError, match="last"):
        find_metric(f"{file}:first", SIGNALS, TARGETS)


def test_block_robustness_equals_single_log_robustness(runs):
    text = "eventually[0, 2 s](always[0, 1 s](abs(yaw_rate - 1) < 0.1 rad/s)) or heading < 100 deg"
    units = {"truth.yaw_rate": "rad/s", "truth.heading": "rad"}
    metric = find_metric(f"robustness:{text}", SIGNALS, TARGETS, units)
    assert metric.signals == ("truth.yaw_rate", "truth.heading")
    assert metric.unit == "mixed units"
    found = metric.of(Rows(T, runs, TARGETS, frozenset()))
    declared = {path: Quantity(unit, "") for path, unit in units.items()}
    for i in range(60):
        log = Log(T, (T * 1e7).round().astype(np.int64), {p: x[i] for p, x in runs.items()}, declared)
        assert assess_formula(log, text).robustness == found[i]
    assert 10 < (found > 0).sum() < 50


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("robustness:always(yaw_rat < 1)", "there is no signal 'yaw_rat'"),
        ("robustness:always(yaw_rate < 1 m)", "rad/s and m"),
        ("robustness:always[0, 6 s](yaw_rate < 1)", "looks 6 s ahead, but the run lasts 5 s"),
        ("robustness:", "write KIND:SIGNAL"),
    ],
)
def test_rejects_formula_that_does_not_match_the_scenario(text, says):
    with pytest.raises(InputError, match=says):
        find_metric(text, SIGNALS, TARGETS, {"truth.yaw_rate": "rad/s"}, 50_000_000)


def test_changes_metric_counts_mode_changes():
    modes = np.array([[0, 0, 1, 1, 0, 2], [3, 3, 3, 3, 3, 3], [0, 1, 0, 1, 0, 1]], np.int32)
    flags = np.array([[0, 1, 1, 0, 0, 0], [0] * 6, [1] * 6], bool)
    shapes = {"law.mode": (), "actuators.speed_saturated": ()}
    rows = Rows(T[:6], {"law.mode": modes, "actuators.speed_saturated": flags}, (), frozenset())
    changes = find_metric("changes:law.mode", shapes, ())
    assert changes.of(rows).tolist() == [3, 0, 5]
    assert (changes.unit, changes.of(rows).dtype) == ("1", np.float64)
    assert find_metric("changes:actuators.speed_saturated", shapes, ()).of(rows).tolist() == [2, 0, 0]
    assert find_metric("mean:actuators.speed_saturated", shapes, ()).of(rows) == pytest.approx([1 / 3, 0, 1])


@pytest.mark.parametrize(
    ("name", "says", "fix"),
    [
        ("loop.overruns", "only the log of a flight over a link", "trimtab fly SCENARIO --link … --out DIR"),
        ("link.silence", "only the log of a flight over a link", "trimtab fly SCENARIO --link … --out DIR"),
        ("flight.altitude", "this vehicle has no three-dimensional attitude", "peak:truth."),
        ("truth.yaw_rat", "there is no signal 'truth.yaw_rat'.\n", "peak:truth.yaw_rate"),
    ],
)
def test_rejects_signals_logged_only_over_a_link(name, says, fix):
    with pytest.raises(InputError) as refused:
        find_metric(f"peak:{name}", SIGNALS, TARGETS)
    assert says in str(refused.value)
    assert fix in refused.value.fix


def test_sample_in_band_takes_precedence_over_crossing_before_it():
    t, band = np.arange(4.0), 0.1
    runs = {"truth.yaw_rate": np.array([[0.0, 1.05, 1.0, 1.0], [0.0, 4.0, 1.0, 1.0], [3.0, 2.0, 0.95, 1.0]])}
    rows = Rows(t, runs, [Target("truth.yaw_rate", 1.0, band)], frozenset())
    np.testing.assert_allclose(first_reach(rows, "yaw_rate"), [1.0, 0.25, 2.0], rtol=1e-12)

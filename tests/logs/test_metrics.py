import json
import math

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, check_targets, full_path, metrics, mode_switches, nearest_target_value


def logged(x, *, dt: float = 1.0, start: float = 0.0, kind: str = "real", name: str = "truth.x", **signals) -> Log:
    ticks = np.round((start + dt * np.arange(len(x))) * 1e7).astype(np.int64)
    held = {name: np.asarray(x)} | {path.replace("__", "."): np.asarray(v) for path, v in signals.items()}
    return Log(to_seconds(ticks), ticks, held, {name: Quantity("1", "Made by hand.", kind=kind)})


def merits(x, value=1.0, band=0.1, **options) -> dict:
    return metrics(logged(x, **options), [Target("truth.x", value, band)], ["truth.x"])["truth.x"]


def test_metrics_of_a_rise_with_overshoot():
    found = merits([0.0, 0.5, 0.95, 1.3, 1.05, 1.0, 1.0])
    assert found["settling_s"] == 4.0
    assert found["first_reach_s"] == 2.0
    assert found["overshoot"] == pytest.approx(0.3, abs=1e-15)
    assert found["tail_mean"] == pytest.approx((1.05 + 1.0 + 1.0) / 3, abs=1e-15)  # from 4 s on, of 0 to 6 s
    assert found["tail_rms"] == pytest.approx(np.std([1.05, 1.0, 1.0]), abs=1e-15)


def test_times_count_from_the_first_sample():
    assert merits([0.0, 0.5, 1.0, 1.0], start=100.0, dt=0.5)["settling_s"] == pytest.approx(1.0, abs=1e-9)
    assert merits([0.0, 0.5, 1.0, 1.0], start=100.0, dt=0.5)["first_reach_s"] == pytest.approx(1.0, abs=1e-9)


def test_first_reach_is_interpolated_between_samples():
    assert merits([0.0, 0.0, 4.0, 4.0])["first_reach_s"] == pytest.approx(1.25, abs=1e-9)
    assert merits([0.0, 0.0, 4.0, 4.0])["settling_s"] is None
    assert merits([4.0, 0.0, 1.0])["first_reach_s"] == pytest.approx(0.75, abs=1e-9)


def test_sample_in_band_takes_precedence_over_crossing_before_it():
    assert merits([0.0, 1.05, 1.0])["first_reach_s"] == 1.0
    assert merits([3.0, 0.95, 1.0])["first_reach_s"] == 1.0


def test_overshoot_from_above_is_below_the_target():
    found = merits([3.0, 1.2, 0.6, 0.9, 1.0])
    assert found["overshoot"] == pytest.approx(0.4, abs=1e-15)
    assert found["settling_s"] == 3.0
    assert merits([3.0, 2.0, 1.5])["overshoot"] == 0.0


def test_overshoot_from_target_is_the_largest_excursion():
    assert merits([1.0, 1.4, 0.3, 1.0])["overshoot"] == pytest.approx(0.7, abs=1e-15)


def test_band_limits_are_inclusive():
    assert merits([0.0, 0.5, 0.5], value=1.0, band=0.5)["settling_s"] == 1.0
    assert merits([0.0, 0.49, 0.49], value=1.0, band=0.5)["settling_s"] is None


def test_metrics_of_constant_signals():
    at = merits([1.0] * 4)
    assert at == {"settling_s": 0.0, "first_reach_s": 0.0, "overshoot": 0.0, "tail_mean": 1.0, "tail_rms": 0.0}
    off = merits([0.0] * 4)
    assert off == {"settling_s": None, "first_reach_s": None, "overshoot": 0.0, "tail_mean": 0.0, "tail_rms": 0.0}


def test_signal_outside_band_at_end_never_settles():
    found = merits([0.0, 1.0, 1.0, 1.0, 1.2])
    assert found["settling_s"] is None
    assert found["first_reach_s"] == 1.0


def test_metrics_of_a_single_sample():
    inside = merits([1.05])
    assert inside["settling_s"] == 0.0
    assert inside["first_reach_s"] == 0.0
    assert inside["tail_mean"] == 1.05
    assert inside["tail_rms"] == 0.0
    assert merits([3.0])["settling_s"] is None
    assert merits([3.0])["first_reach_s"] is None


def test_empty_log_has_no_metrics():
    log = logged([1.0]).between(5, 6)
    found = metrics(log, [Target("truth.x", 1.0, 0.1)], ["truth.x"])["truth.x"]
    assert set(found.values()) == {None}
    assert mode_switches(log) == 0


@pytest.mark.parametrize("gap", [math.nan, math.inf, -math.inf])
def test_non_finite_samples_are_outside_every_band(gap):
    early = merits([0.0, gap, 1.0, 1.0, 1.0, 1.0])
    assert early["settling_s"] == 2.0
    assert early["first_reach_s"] == 2.0
    assert early["overshoot"] is None
    assert early["tail_mean"] == 1.0
    late = merits([0.0, 1.0, 1.0, 1.0, 1.0, gap])
    assert late["settling_s"] is None
    assert late["first_reach_s"] == 1.0
    assert late["tail_mean"] is None
    assert late["tail_rms"] is None
    assert set(merits([gap] * 3).values()) == {None}
    json.dumps([early, late], allow_nan=False)


def test_no_crossing_is_detected_across_a_nan_gap():
    assert merits([0.0, math.nan, 4.0])["first_reach_s"] is None


def test_overflow_gives_none_instead_of_infinity():
    found = merits([1e308] * 4)
    json.dumps(found, allow_nan=False)
    assert found["tail_mean"] is None


def test_signals_without_target_have_only_tail_metrics():
    log = logged([1, 2, 3, 4], name="truth.count")
    found = metrics(log, [], ["truth.count"])["truth.count"]
    assert found["settling_s"] is found["first_reach_s"] is found["overshoot"] is None
    assert found["tail_mean"] == 3.5
    assert all(type(v) is float for v in found.values() if v is not None)


def test_results_use_the_requested_signal_names():
    log = logged([3.0, 3.0, 3.0], name="truth.yaw_rate")
    assert full_path("yaw_rate") == "truth.yaw_rate"
    found = metrics(log, [Target("truth.yaw_rate", 3.0, 0.15)], ["yaw_rate"])
    assert found["yaw_rate"]["settling_s"] == 0.0
    assert metrics(log, [Target("yaw_rate", 3.0, 0.15)], ["truth.yaw_rate"]) == {"truth.yaw_rate": found["yaw_rate"]}


def test_angle_target_is_met_modulo_full_turns():
    short_way = np.array([0.0, -0.6, -1.2, -1.283, -1.283])
    target = Target("truth.x", 5.0, 0.02)  # 5 rad is -1.283 rad the short way round
    angle, real = logged(short_way, kind="angle"), logged(short_way)
    assert nearest_target_value(angle, target) == pytest.approx(5.0 - 2 * np.pi, abs=1e-12)
    assert metrics(angle, [target], ["truth.x"])["truth.x"]["settling_s"] == 3.0
    assert metrics(angle, [target], ["truth.x"])["truth.x"]["overshoot"] == 0.0
    assert nearest_target_value(real, target) == 5.0
    assert metrics(real, [target], ["truth.x"])["truth.x"]["settling_s"] is None
    long_way = logged([0.0, 3.0, 5.0, 5.0], kind="angle")
    assert nearest_target_value(long_way, target) == 5.0


def test_metrics_match_a_plain_loop_on_random_walks():
    """Oracle: the definitions of the docs page, one sample after the other."""
    rng = np.random.default_rng(5)
    reached = 0
    for _ in range(200):
        x = np.cumsum(rng.normal(size=40)) * 0.4
        value, band = float(rng.normal()), float(rng.uniform(0.05, 0.6))
        settled, first, over = None, None, 0.0
        for i, v in enumerate(x):
            inside = abs(v - value) <= band
            settled = (settled if settled is not None else i) if inside else None
            if first is None and i and not inside and (x[i - 1] - value) * (v - value) < 0:
                first = i - 1 + (value - x[i - 1]) / (v - x[i - 1])
            if first is None and inside:
                first = i
            over = max(over, (v - value) if x[0] < value else (value - v))
        found = merits(x, value, band)
        assert found["settling_s"] == (None if settled is None else pytest.approx(settled, abs=1e-9))
        assert found["first_reach_s"] == (None if first is None else pytest.approx(first, abs=1e-9))
        assert found["overshoot"] == pytest.approx(over, abs=1e-12)
        tail = [v for i, v in enumerate(x) if i >= 39 * 2 / 3]
        assert found["tail_mean"] == pytest.approx(sum(tail) / len(tail), abs=1e-12)
        reached += settled is not None
    assert 10 < reached < 190


def test_mode_switches_are_counted():
    assert mode_switches(logged([0.0, 0.0])) == 0
    assert mode_switches(logged([0.0, 0.0, 0.0], law__switches=np.array([0, 1, 4], np.int32))) == 4
    assert mode_switches(logged([0.0] * 5, law__mode=np.array([0, 2, 2, 1, 1], np.int32))) == 2


@pytest.mark.parametrize(("value", "band"), [(1.0, 0.0), (1.0, -1.0), (1.0, math.nan), (math.inf, 1.0)])
def test_rejects_invalid_target_value_or_band(value, band):
    with pytest.raises(InputError, match="target of 'yaw_rate'"):
        Target("yaw_rate", value, band)


def test_rejects_vectors_unknown_signals_and_duplicate_targets():
    log = logged(np.zeros((3, 2)))
    with pytest.raises(InputError, match="2 components"):
        metrics(log, [], ["truth.x"])
    log = logged([0.0, 1.0])
    with pytest.raises(InputError, match="not in this log"):
        metrics(log, [], ["yaw_rate"])
    with pytest.raises(InputError, match="target of 'heading': no signal has this name"):
        metrics(log, [Target("heading", 1.0, 0.1)], [])
    with pytest.raises(InputError, match="two targets"):
        metrics(log, [Target("truth.x", 1.0, 0.1), Target("truth.x", 2.0, 0.1)], [])


def test_targets_are_checked_against_shapes_of_signals():
    shapes = {"truth.place": (2,), "truth.heading": ()}

    def check(*paths):
        check_targets([Target(path, 1.0, 0.1) for path in paths], shapes, shapes.__getitem__)

    check("truth.place[1]", "heading")
    check_targets([Target("truth.place[1]", 1.0, 0.1)], ["truth.place[1]"], lambda path: ())
    with pytest.raises(InputError, match=r"'truth.place' has shape \(2,\), but a target needs one number") as refused:
        check("truth.place")
    assert refused.value.fix == "Target('truth.place[0]', 1, band=0.1)"
    with pytest.raises(InputError, match=r"target of 'truth.place\[2\]': 'truth.place' has shape"):
        check("truth.place[2]")
    with pytest.raises(InputError, match="no signal has this name") as refused:
        check_targets([Target("law.error", 1.0, 0.1)], ["law.error.x", "law.errors"], lambda path: ())
    assert refused.value.choices == ("law.error.x",)
    with pytest.raises(InputError, match="no signal has this name") as refused:
        check("truth")
    assert refused.value.choices == ("truth.place", "truth.heading")


def test_angle_of_a_diverged_run_is_not_on_target():
    assert merits([1.0, -2.7e154], value=0.0, kind="angle")["settling_s"] is None
    for x, value in ((1e16, 0.0), (1e3, 318 * np.pi)):  # at 1e16, the spacing of numbers is 2
        assert nearest_target_value(logged([x], kind="angle"), Target("truth.x", 0.0, 0.1)) == pytest.approx(value)


@pytest.mark.parametrize(("value", "band"), [("20 kg", 0.1), (1.0, "3 cm"), (None, 0.1)])
def test_target_must_consist_of_numbers(value, band):
    with pytest.raises(InputError, match="must be a number in the signal's unit, got "):
        Target("truth.x", value, band)

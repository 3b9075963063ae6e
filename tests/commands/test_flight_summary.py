"""The summary of a flight that `trimtab run` prints: metrics, flags, monitors and targets."""

import re

import numpy as np
import pytest

from trimtab.commands.flight_summary import flag_times, metric_units, print_result, summarise_run
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target

T = np.arange(0, ms(1000), ms(10))


def test_target_on_law_signal_is_shown_with_full_path():
    error = np.exp(-5 * to_seconds(T))
    log = Log(t=to_seconds(T), ticks=T, signals={"truth.h": 10 + error, "law.h_error": error}, final={"truth.h": 10.0})
    found = summarise_run(log, [Target("law.h_error", 0.0, 0.1)])
    assert list(found["metrics"]) == ["law.h_error", "h"]
    assert found["metrics"]["law.h_error"]["settling_s"] == pytest.approx(np.log(10) / 5, abs=0.011)
    assert found["metrics"]["h"]["settling_s"] is None
    assert found["final"] == {"h": 10.0, "law.h_error": pytest.approx(error[-1])}


def test_target_on_truth_is_shown_by_short_name():
    log = Log(t=to_seconds(T), ticks=T, signals={"truth.heading": np.zeros(len(T))}, final={"truth.heading": 0.0})
    found = summarise_run(log, [Target("heading", 0.0, 0.1)])
    assert list(found["metrics"]) == ["heading"]
    assert found["metrics"]["heading"]["settling_s"] == 0.0


def test_swarm_metrics_are_reported_per_craft():
    speed = np.stack([np.full(len(T), 0.5), np.linspace(0, 1, len(T))], axis=1)
    log = Log(to_seconds(T), T, {"truth.surge_velocity": speed}, final={"truth.surge_velocity": speed[-1]})
    found = summarise_run(log, [])
    assert list(found["metrics"]) == ["surge_velocity[0]", "surge_velocity[1]"]
    assert found["metrics"]["surge_velocity[0]"]["tail_mean"] == 0.5
    assert found["final"] == {"surge_velocity[0]": 0.5, "surge_velocity[1]": 1.0}


def test_reports_flags_and_time_of_lost_state():
    up, h = (to_seconds(T) >= 0.25) & (to_seconds(T) < 0.5), np.where(to_seconds(T) < 0.805, 1.0, np.nan)
    flag = Quantity("1", "Whether a limit holds the input.", kind="flag")
    signals = {"truth.h": h, "law.saturated": up}
    log = Log(to_seconds(T), T, signals, declarations={"law.saturated": flag}, final={"truth.h": np.nan})
    found = summarise_run(log, [])
    assert found["flags"]["law.saturated"]["first_s"] == pytest.approx(0.25)
    assert found["flags"]["law.saturated"]["for_s"] == pytest.approx(0.25, abs=0.01)
    assert found["lost_s"] == pytest.approx(0.81)
    assert found["final"]["h"] is None  # JSON has no NaN
    calm = Log(to_seconds(T), T, {"truth.h": np.zeros(len(T))})
    assert (summarise_run(calm, [])["flags"], summarise_run(calm, [])["lost_s"]) == ({}, None)


def test_reports_verdict_and_robustness_of_monitors():
    verdict = np.repeat([0, 1, 2, 1], 25).astype(np.int32)
    signals = {"monitor.turn.robustness": np.where(verdict == 2, -0.5, verdict * 0.25), "monitor.turn.verdict": verdict}
    signals |= {"monitor.rest.robustness": np.zeros(100), "monitor.rest.verdict": np.zeros(100, np.int32)}
    found = summarise_run(Log(to_seconds(T), T, signals), [])["monitor"]
    assert found["turn"] == {"verdict": "holds", "least_robustness": -0.5, "violated_s": pytest.approx(0.5)}
    assert found["rest"] == {"verdict": "pending", "least_robustness": None, "violated_s": None}
    assert "monitor" not in summarise_run(Log(to_seconds(T), T, {"law.x": np.zeros(100)}), [])


def test_reports_closest_distance_between_swarm_craft():
    t = np.arange(0, ms(400), ms(100))
    craft = np.zeros((4, 8))
    signals = {"truth.north": craft, "sensors.arena.value.spacing": np.array([2.0, 1.5, 1.25, 3.0])}
    log = Log(t=to_seconds(t), ticks=t, signals=signals, final={"truth.north": craft[-1]})
    found = summarise_run(log, [Target("sensors.arena.value.spacing", 3.0, 0.1)])
    assert found["closest"] == {"distance_m": 1.25, "at_s": pytest.approx(0.2)}
    assert list(found["metrics"]) == ["sensors.arena.value.spacing"]
    assert found["final"] == {"sensors.arena.value.spacing": 3.0}
    alone = Log(t=to_seconds(t), ticks=t, signals={"truth.north": craft[:, 0]}, final={"truth.north": 0.0})
    assert "closest" not in summarise_run(alone, [])


def test_target_on_a_sensor_is_shown_for_the_real_run_only(capsys):
    t, zeros = np.arange(0, ms(300), ms(100)), np.zeros(3)
    logs = {
        "real": Log(to_seconds(t), t, {"truth.x": zeros, "sensors.fix.value.x": zeros}),
        "ideal": Log(to_seconds(t), t, {"truth.x": zeros}),
    }
    targets = [Target("sensors.fix.value.x", 0.0, 0.1), Target("truth.x", 0.0, 0.1)]
    sides = {side: summarise_run(log, targets) for side, log in logs.items()}
    assert {side: s["verdict"]["on_target"] for side, s in sides.items()} == {"real": True, "ideal": True}
    units = {"sensors.fix.value.x": "m", "x": "m"}
    print_result({"scenario": "own", "duration_s": 0.3, "seed": 0, **sides}, units)
    out = capsys.readouterr().out
    assert re.search(r"\(m\) +real", out), out
    assert len(re.findall("ideal  ", out)) == 1  # of truth.x


def in_space(down, tilt=0.0):
    """A flight straight along north at a depth (m), rolled to starboard (rad)."""
    t = to_seconds(T)
    zero = 0 * t
    q = np.stack([np.cos(zero + tilt / 2), np.sin(zero + tilt / 2), zero, zero], axis=1)
    signals = {"truth.q": q, "truth.p": np.stack([2 * t, zero, down + zero], axis=1), "truth.power": t}
    signals["truth.v"] = np.stack([2 + zero, zero, zero], axis=1)
    declared = {
        "truth.q": Quantity("1", "Attitude.", "WB", shape=(4,)),
        "truth.p": Quantity("m", "Position.", "W", shape=(3,)),
        "truth.v": Quantity("m/s", "Velocity.", "W", shape=(3,)),
        "truth.power": Quantity("1", "Of its engine."),
    }
    return Log(t, T, signals, declared, final={p: x[-1] for p, x in signals.items()})


@pytest.mark.usefixtures("wide_screen")
def test_flight_with_attitude_is_summarised_by_angles_and_altitude(capsys):
    log = in_space(-10.0, tilt=0.5)
    found = summarise_run(log, [Target("truth.p[0]", 1.98, 0.1)])
    shown = [n for n in found["metrics"] if n.startswith("flight.")]
    assert shown[:3] == ["flight.roll", "flight.pitch", "flight.yaw"]
    assert "q[0]" not in found["metrics"]
    assert "power" in found["metrics"]
    assert found["final"]["flight.roll"] == pytest.approx(0.5)
    flight = found["flight"]
    assert flight["greatest_tilt_rad"] == pytest.approx(0.5)
    assert (flight["lowest_m"], flight["highest_m"], flight["fastest_m_s"]) == (10.0, 10.0, 2.0)
    assert flight["settled_s"]["p[0]"] == pytest.approx(0.94, abs=0.011)
    result = {"scenario": "a", "duration_s": 1.0, "seed": 0, "real": found, "ideal": None}
    print_result(result, metric_units(log, found["metrics"]))
    said = capsys.readouterr().out
    assert re.search(r"flight\.roll \(deg\) +real +28\.648 ", said)
    assert "10 to 10 m high, up to 2 m/s over the ground, tilted by up to 28.6 deg, settled on its target from" in said


def test_missed_target_is_named_and_depth_is_reported(capsys):
    log = in_space(5.0)
    found = summarise_run(log, [Target("truth.p[0]", 9.0, 0.1)])
    result = {"scenario": "a", "duration_s": 1.0, "seed": 0, "real": found, "ideal": None}
    print_result(result, metric_units(log, found["metrics"]))
    said = capsys.readouterr().out
    assert "5 to 5 m deep" in said
    assert "NOT settled: p[0]" in said


def test_vector_state_without_attitude_is_shown_by_component():
    a = np.stack([np.cos(to_seconds(T)), np.sin(to_seconds(T)), 0 * T], axis=1)
    declared = {"truth.field": Quantity("T", "What it feels.", shape=(3,))}
    log = Log(to_seconds(T), T, {"truth.field": a}, declarations=declared, final={"truth.field": a[-1]})
    found = summarise_run(log, [Target("truth.field[0]", np.cos(0.99), 0.1)])
    assert {"field[0]", "field[1]", "field[2]"} == set(found["metrics"])
    assert found["metrics"]["field[0]"]["settling_s"] == pytest.approx(0.87, abs=0.02)
    assert found["final"]["field[1]"] == pytest.approx(np.sin(0.99))


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_reports_non_finite_demand(value, capsys):
    demand = np.where(to_seconds(T) < 0.305, 1.0, value)
    valid = to_seconds(T) > 0.1
    early = np.where(valid, 1.0, value)  # a law may compute anything before its estimate is valid
    signals = {"truth.h": np.zeros(len(T)), "law.demand.F": demand, "law.demand.M": early, "estimate.valid": valid}
    log = Log(to_seconds(T), T, signals, final={"truth.h": 0.0})
    found = summarise_run(log, [])
    assert found["not_finite"] == {"law.demand.F": pytest.approx(0.31)}
    print_result({"scenario": "s", "duration_s": 1.0, "seed": 0, "real": found, "ideal": None}, {"h": "m"})
    assert "NOT FINITE (real): law.demand.F, first at 0.31 s" in capsys.readouterr().out
    calm = Log(to_seconds(T), T, {"truth.h": np.zeros(len(T)), "law.demand.F": np.ones(len(T))})
    assert "not_finite" not in summarise_run(calm, [])


def test_flags_of_the_integration_are_reported():
    flag = Quantity("1", "True if events were missed.", kind="flag")
    crowded = Log(to_seconds(T), T, {"truth.h": 0 * T, "world.crowded": ms(500) <= T}, {"world.crowded": flag})
    assert flag_times(crowded)["world.crowded"]["first_s"] == 0.5

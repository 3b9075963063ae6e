"""Monitor of a compiled step: reports of violated formulas, also in a flight and in its log."""

import pytest
from flight.virtual_programs import fly_pair

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms
from trimtab.flight.monitored import CompiledMonitor
from trimtab.logs.robustness import VIOLATED
from trimtab.run.blocks import compile_autopilot
from trimtab.run.replay import replay
from trimtab.scenarios.build import build
from trimtab.scenarios.recorded import rebuild_scenario

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
TURN = "once[0, 20 ms](abs(estimate.state.yaw_rate) < 30 deg/s)"
FORMULAS = f"turn: {TURN}; never: always(downlink.navigation.age < 100 s)"


@pytest.fixture(scope="module")
def compiled():
    scenario = build("hovercraft/spin", {"autopilot.monitor.formulas": FORMULAS})
    return scenario, compile_autopilot(scenario)


def test_each_verdict_change_is_reported_once_with_robustness(compiled):
    scenario, step = compiled
    step.reset()
    step.inputs[:] = 0
    monitored = CompiledMonitor(scenario, step)
    said = {}
    for k in range(200):
        rate = 1.0 if 50 <= k < 120 else 0.0
        step.set_inputs({
            "t": k * ms(1), "samples.navigation.t": k * ms(1), "samples.navigation.fresh": True,
            "samples.navigation.valid": True, "samples.navigation.value.yaw_rate": rate,
        })  # fmt: skip
        step.step()
        if lines := monitored.describe_changes():
            said[k] = lines
    assert said == {
        70: [f"monitor: turn VIOLATED, robustness -0.4764 rad/s: {TURN}"],
        120: [f"monitor: turn holds again, robustness 0.5236 rad/s: {TURN}"],
    }


def test_no_report_without_a_monitor():
    scenario = build("hovercraft/spin")
    assert CompiledMonitor(scenario, compile_autopilot(scenario)).describe_changes() == []


@pytest.mark.thorough
def test_violation_in_flight_is_reported_logged_and_replayed(tmp_path):
    formulas = "autopilot.monitor.formulas=still: always(abs(estimate.state.yaw_rate) < 0.5 rad/s)"
    programs, there, here = fly_pair(tmp_path, "hovercraft/spin", "--duration", "2", pilot=("--set", formulas))
    assert "monitor: still VIOLATED, robustness -" in here.said
    log = programs.read_log("autopilot")
    told = [e for e in log.metadata["events"] if e["text"].startswith("monitor: still VIOLATED")]
    assert len(told) == 1
    first = log.t[(log["monitor.still.verdict"] == VIOLATED).argmax()]
    assert told[0]["t"] == pytest.approx(first, abs=0.1)
    again = replay(log, rebuild_scenario(log))
    assert again.exact, again.first
    assert "monitor.still.robustness" in again.replayed_log
    assert (there.status, here.status) == (0, 0), (there, here)

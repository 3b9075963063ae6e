"""The hovercraft on its navigation system instead of the error model: accuracy, consistency, better flights."""

import numpy as np
import pytest

from trimtab.logs.navigation import assess_navigation, state_series
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue

FLIGHTS = [name for name in catalogue.scenario_names() if name.startswith("hovercraft/")]
SEEDS = range(10)


def flown(name, **choices):
    scenario, _ = catalogue.load_scenario(name, choices)
    return scenario, simulate_many(scenario, seeds=SEEDS)


def rms_errors(logs, after_s=5.0):
    """Return the root mean square error over runs and instants, by state."""
    found = {}
    for log in logs:
        for name, one in state_series(log).items():
            if one.error is not None:
                found.setdefault(name, []).append(np.mean(one.error[one.t > after_s] ** 2))
    return {name: np.sqrt(np.mean(squares)) for name, squares in found.items()}


def check_accuracy(logs, heading=0.02):
    errors = rms_errors(logs)
    bounds = {"surge_velocity": 0.03, "sway_velocity": 0.03, "heading": heading, "north": 0.02, "east": 0.02}
    for name, bound in bounds.items():
        assert errors[name] < bound, (name, errors[name])


@pytest.mark.thorough
def test_zero_velocity_on_ins_is_accurate_and_consistent():
    scenario, logs = flown("hovercraft/zero-velocity", navigation="ins")
    check_accuracy(logs)
    verdicts = [assess_navigation(log).verdict for log in logs]
    print(verdicts)
    assert verdicts.count("optimistic") <= 1  # its errors hang together in time: rather too careful than too sure
    assert verdicts.count("consistent") >= 6
    model, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    before = simulate_many(model, seeds=SEEDS)
    late = logs[0].t > 10

    def wander(logs, signal):
        return np.mean([np.std(log[f"truth.{signal}"][late]) for log in logs])

    for signal in ("surge_velocity", "sway_velocity", "yaw_rate"):
        assert wander(logs, signal) < wander(before, signal)
    assert scenario.imperfections().keys() > {"imu-noise", "range-noise", "sound-speed", "uplink-delay", "saturation"}


@pytest.mark.thorough
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", ["ins", "ins-magnetometer", "ins-coupled"])
@pytest.mark.parametrize("name", FLIGHTS)
def test_every_navigation_kind_is_accurate_on_every_flight(name, kind):
    _, logs = flown(name, navigation=kind)
    check_accuracy(logs)
    verdicts = [assess_navigation(log).verdict for log in logs]
    print(name, kind, verdicts, rms_errors(logs))
    assert verdicts.count("optimistic") <= 3
    assert all(log["estimate.valid"][log.t > 1].all() for log in logs)


@pytest.mark.thorough
@pytest.mark.timeout(600)
def test_navigation_stays_accurate_over_measured_links():
    """Radio latencies with jitter: samples arrive in bursts and are fused at their measurement time."""
    _, logs = flown("hovercraft/zero-velocity", navigation="ins", links="measured")
    check_accuracy(logs)
    assert not any(log["estimate.state.coasting"][log.t > 1].any() for log in logs)

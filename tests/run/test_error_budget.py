"""The error budget: rows, disabled imperfections, invalid input, and the finding of the thesis."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.run.error_budget import cost_share, error_budget, flight_set_count
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue


@pytest.fixture(scope="module")
def forward():
    scenario, _ = catalogue.load_scenario("hovercraft/forward")
    return replace(scenario, duration=seconds(12))


@pytest.fixture(scope="module")
def found(forward):
    told = []
    budget = error_budget(forward, seeds=range(12), names=["navigation-error", "uplink-delay"], tell=told.append)
    return budget, told


@pytest.mark.thorough
def test_navigation_noise_is_the_dominant_error_source(found):
    """[1] section 6.1, text of fig. 6.8: the INS noise is the primary cause."""
    budget, _ = found
    dearest = {c.name: c for c in budget.costs}["navigation-error"]
    assert cost_share(budget, dearest, "sway_velocity") > 0.99
    assert cost_share(budget, dearest, "yaw_rate") > 0.99
    for measure in ("sway_velocity", "yaw_rate"):
        assert dearest.alone[measure][0] > 0.6 * budget.whole[measure][0]
        assert budget.least[measure][0] < 1e-9


@pytest.mark.thorough
def test_budget_rows_match_direct_simulations(forward, found):
    budget, told = found
    assert told == ["all imperfections", "no imperfections"] + [
        f"{how}" for n in ("navigation-error", "uplink-delay") for how in (f"without {n}", f"{n} alone")
    ]
    assert len(told) == flight_set_count(forward, ["navigation-error", "uplink-delay"])
    logs = simulate_many(forward.without("uplink-delay"), seeds=range(12), signals=("truth",))
    squares = [np.mean(log["truth.yaw_rate"][log.t >= 6] ** 2) for log in logs]
    row = {c.name: c for c in budget.costs}["uplink-delay"].without["yaw_rate"]
    assert row[0] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)
    assert row[1] == pytest.approx(np.std(squares, ddof=1) / np.sqrt(12) / 2 / row[0], rel=1e-9)
    assert dict(budget.units) == {"surge_velocity": "m/s", "sway_velocity": "m/s", "yaw_rate": "rad/s"}
    first = [c.without["surge_velocity"][0] for c in budget.costs]
    assert first == sorted(first)


def test_disabled_imperfection_has_zero_cost(forward):
    quiet = forward.without("navigation-error")
    budget = error_budget(quiet, seeds=[3], names=["navigation-error"])
    (cost,) = budget.costs
    assert cost.without == budget.whole
    assert cost.alone == budget.least


def test_rejects_unknown_imperfection_and_empty_seeds(forward):
    with pytest.raises(InputError, match="no imperfection 'wind'"):
        error_budget(forward, names=["wind"])
    with pytest.raises(InputError, match="at least one seed"):
        error_budget(forward, seeds=[])


def test_rejects_a_scenario_without_measures_before_running():
    told = []
    with pytest.raises(InputError, match=r"no error can be measured(.|\n)*Fix: add targets"):
        error_budget(catalogue.load_scenario("navigation/still")[0], seeds=range(2), tell=told.append)
    assert told == []


@pytest.mark.thorough
def test_navigation_errors_are_measured_without_targets():
    scenario = replace(catalogue.load_scenario("navigation/platform-square-wave")[0], duration=seconds(1))
    assert not scenario.targets
    assert "heading error" in error_budget(scenario, seeds=[0]).whole

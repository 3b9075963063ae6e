"""User-defined vehicles: vector states, own field names, a demand that differs from the input, integers."""

import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from loop.lander import Lander, LanderState, engines, hover

from trimtab import simulate
from trimtab.analysis.campaign.campaign import Campaign
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.record import quantity, record, replace, to_arrays
from trimtab.core.time import ms, seconds
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_vehicle
from trimtab.logs.metrics import Target
from trimtab.loop.settings import with_settings
from trimtab.run.error_budget import error_budget

FILE = Path(__file__).parents[1] / "loop" / "lander.py"


def call(*words):
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exception is None or isinstance(result.exception, SystemExit | InputError), result.exception
    return result


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    said = call("run", f"{FILE}:hover", "--out", folder, "--json")
    assert said.exit_code == 0, said.output
    return folder, json.loads(said.output)


@pytest.mark.thorough
def test_vector_state_is_summarised_by_component(flight):
    folder, said = flight
    assert {"r[0]", "r[2]", "v[1]", "q[3]", "t", "x", "altitude"} <= set(said["real"]["final"])
    assert {"r[2]", "t", "x", "flight.yaw", "flight.climb", "flight.north"} <= set(said["real"]["metrics"])
    assert said["real"]["final"]["flight.yaw"] == pytest.approx(4)
    assert said["real"]["final"]["t"] == pytest.approx(4)
    # q turns about one axis at 1 rad/s: q = (cos t/2, 0, 0, sin t/2)
    assert said["real"]["final"]["q[3]"] == pytest.approx(np.sin(2.0), abs=1e-9)
    assert said["real"]["final"]["r[2]"] == pytest.approx(-said["real"]["final"]["altitude"], abs=1e-9)
    assert 0 < said["real"]["metrics"]["r[2]"]["settling_s"] < 4
    assert said["real"]["metrics"]["r[2]"] != said["real"]["metrics"]["flight.north"]
    assert (folder / "run.png").stat().st_size > 10_000


def test_table_shows_vector_components_with_units():
    said = call("run", f"{FILE}:hover", "--no-ideal").output
    assert "r[2] (m)" in said
    assert "flight.yaw (deg)" in said
    assert "flight.climb (m/s)" in said


def test_log_gives_single_component_of_vector_signal():
    log = simulate(hover(), duration=ms(100))
    assert (log["truth.r[2]"] == log["truth.r"][:, 2]).all()
    assert log.unit("truth.v[1]") == "m/s"
    assert "truth.r[2]" in log
    assert "truth.r[3]" not in log
    with pytest.raises(InputError, match=r"truth.r\[3\]"):
        log["truth.r[3]"]
    with pytest.raises(InputError, match=r"truth.x\[0\]"):
        log["truth.x[0]"]


def test_campaign_measures_vector_component_and_rejects_whole_vector():
    metrics = ["final:truth.r[2]", "final:truth.altitude", "final:law.climb_error", "settling:truth.r[2]"]
    spread = {"world.vehicle.mass": "uniform(90%, 110%)"}
    campaign = Campaign(hover(), runs=70, spread=spread, metrics=metrics, success=["final:truth.r[2] <= -4"])
    rows = campaign.run().columns
    assert np.ptp(rows["final:truth.r[2]"]) > 0.1
    np.testing.assert_allclose(rows["final:truth.r[2]"], -rows["final:truth.altitude"], atol=1e-9)
    with pytest.raises(InputError, match=r"shape \(3,\)") as refused:
        Campaign(hover(), runs=70, metrics=["final:truth.r"])
    assert "truth.r[2]" in refused.value.choices
    row = campaign.row(5, campaign.rerun(5))
    assert row["final:truth.r[2]"] == rows["final:truth.r[2]"][5]


def test_final_metric_is_taken_at_end_of_run_not_last_row():
    scenario = replace(hover(), duration=ms(506))
    campaign = Campaign(scenario, runs=64, metrics=["final:truth.t"], success=["final:truth.t >= 0"], log_period=ms(50))
    assert campaign.run().columns["final:truth.t"] == pytest.approx(0.506)  # the last row is at 0.5 s


@pytest.mark.thorough
def test_budget_accepts_targets_on_law_signals_and_vector_components():
    budget = error_budget(hover(), seeds=range(2), names=["uplink-delay"])
    assert budget.units == {"r[2]": "m", "altitude": "m", "law.climb_error": "m"}
    assert budget.whole["law.climb_error"][0] > 0
    assert budget.whole["r[2]"][0] == pytest.approx(budget.whole["altitude"][0])


@pytest.mark.thorough
def test_ideal_twin_keeps_conversion_from_demand_to_input():
    scenario = engines()
    real, twin = simulate(scenario), simulate(scenario.ideal())
    assert real.final["truth.altitude"] == pytest.approx(4.26, abs=0.2)  # a tenth of the thrust is missing
    assert twin.final["truth.altitude"] == pytest.approx(5.0, abs=0.06)
    assert twin["uplink.age"].max() < 0.002  # a wire, held for one period
    direct = simulate(hover().ideal())
    np.testing.assert_allclose(twin["truth.altitude"], direct["truth.altitude"], atol=0.01)
    assert scenario.ideal().imperfections() == {"weak-engines": ["world.actuators"]}


def test_law_receives_its_period():
    log = simulate(replace(hover(), duration=seconds(1)))
    steps = log["law.flown"][log["estimate.valid"]]
    assert steps[-1] - steps[0] == pytest.approx(0.998 - to_first(log), abs=1e-9)
    assert np.unique(np.round(np.diff(steps)[np.diff(steps) > 0], 12)) == [0.002]
    assert "estimate.dt" not in log


def to_first(log):
    return float(log.t[log["estimate.valid"].argmax()])


@record
class OddNames:
    """Field names that are also names in functions and in C."""

    self: Any = quantity("1", "One.", default=1.0)
    r: Any = quantity("1", "Two.", default=2.0)
    changes: Any = quantity("1", "Three.", default=3.0)
    double: Any = quantity("1", "Four.", default=4.0)


def test_any_identifier_works_as_field_name():
    odd = replace(OddNames(), self=5, r=6, changes=7, double=8)
    assert [float(v) for v in jax.tree.leaves(to_arrays(odd))] == [5, 6, 7, 8]
    assert with_settings(odd, {"self": "9"}).self == 9
    x = LanderState()
    assert replace(x, r=(1, 2, 3), t=5.0, x=6.0).r == (1, 2, 3)
    assert simulate(hover(), duration=ms(10)).final["truth.x"] > 0


def test_integers_are_accepted_in_states_inputs_and_settings():
    whole = replace(hover(), initial=LanderState(r=[0, 0, -12], altitude=12))
    assert simulate(whole, duration=ms(10)).final["truth.altitude"] == pytest.approx(12, abs=0.01)
    u = whole.world.actuators.neutral_input
    model = model_of_vehicle(Lander(mass=2), LanderState(r=[0, 0, -12], altitude=12000), u)
    linear = linearise(model, u=[0, 0, -20])
    assert linear.A[model.states.index("r[2]"), model.states.index("v[2]")] == 1.0
    said = call("run", f"{FILE}:hover", "--no-ideal", "--json", "--duration", "10 ms", "--set", "initial.altitude=20")
    assert json.loads(said.output)["real"]["final"]["altitude"] == pytest.approx(20, abs=0.01)


@pytest.mark.thorough
def test_flight_from_file_is_replayed_with_scenario_option(flight):
    folder, _ = flight
    refused = call("replay", folder / "run.mcap")
    assert refused.exit_code != 0
    assert f"--scenario {FILE}:hover" in str(refused.exception) + refused.output
    assert "hovercraft/forward" not in str(refused.exception)
    again = call("replay", folder / "run.mcap", "--scenario", f"{FILE}:hover")
    assert again.exit_code == 0, again.output
    assert "identical bit for bit" in again.output
    same = call("compare", folder / "run.mcap", "--scenario", f"{FILE}:hover")
    assert same.exit_code == 0, same.output


def test_compare_of_two_logs_rejects_a_scenario():
    refused = call("compare", FILE, FILE, "--scenario", "hovercraft/spin")
    assert "--scenario: applies only to one log" in str(refused.exception) + refused.output


def test_unknown_mav_type_is_rejected_before_run():
    @record
    class Saucer(Lander):
        MAV_TYPE = "QUADROTER"

    scenario = hover()
    scenario.check()  # a rocket is one
    with pytest.raises(InputError, match="QUADROTER") as refused:
        replace(scenario, world=replace(scenario.world, vehicle=Saucer())).check()
    assert 'MAV_TYPE = "QUADROTOR"' in refused.value.fix
    assert {"HELICOPTER", "SUBMARINE", "GROUND_ROVER"} <= set(refused.value.choices)


def slip(method):
    """A lander with another dynamics."""
    return record(type("Slip", (Lander,), {"dynamics": method}))()


def branch(self, t, x, u):
    return replace(x, t=1.0) if x.altitude > 3 else x


SLIPS = {
    "a Python branch": (branch, "test_own_vehicle.py:.*`if` depends on a traced value", "jnp.where"),
    "another shape": (lambda self, t, x, u: replace(x, v=jnp.zeros(2)), r"has v of shape \(2,\)", "LanderState"),
    "not a record": (lambda self, t, x, u: x.q, r"an array of shape \(4,\)", "LanderState"),
    "misspelt field": (lambda self, t, x, u: x.hight, "test_own_vehicle.py:.*hight", ""),
}


@pytest.mark.parametrize("name", SLIPS)
def test_error_in_dynamics_is_reported_with_its_line(name):
    method, problem, fix = SLIPS[name]
    scenario = hover()
    with pytest.raises(InputError, match=problem) as refused:
        simulate(replace(scenario, world=replace(scenario.world, vehicle=slip(method))))
    assert refused.value.part == "world.vehicle.dynamics"
    assert fix in refused.value.fix


def test_rejects_vehicle_without_motion_and_law_with_varying_state_structure():
    scenario = hover()
    with pytest.raises(InputError, match=r"has no dynamics\(t, x, u\)"):
        simulate(replace(scenario, world=replace(scenario.world, vehicle=LanderState())))

    @record
    class Unseen:
        """A vehicle that no sensor can measure. Source: this file."""

        def dynamics(self, t, x, u):
            return x

    with pytest.raises(InputError, match=r"Unseen has no motion\(t, x, u\)") as refused:
        simulate(replace(scenario, world=replace(scenario.world, vehicle=Unseen())))
    assert "def motion(self, t, x, u)" in refused.value.fix

    @record
    class Forgetful(type(scenario.autopilot.law)):
        def init(self, key):
            return (0.0, 1.0)

        def step(self, t, state, estimate):
            _, output = super().step(t, state[0], estimate)
            return state[0], output

    with pytest.raises(InputError, match="the state that step"):
        simulate(replace(scenario, autopilot=replace(scenario.autopilot, law=Forgetful())))


def test_target_on_vector_component_is_drawn_in_vector_panel():
    from trimtab.plots.run import plot_run

    log = simulate(hover(), log_period=ms(20))
    figure = plot_run(log, targets=[Target("truth.r[2]", -5.0, 0.1)])
    axes = next(a for a in figure.axes if a.get_title(loc="right") == "truth.r")
    dashed = [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "--"]
    assert dashed == [-5.0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["[0]", "[1]", "[2]"]


@pytest.mark.usefixtures("wide_screen")
def test_run_reports_too_long_integration_steps_and_fix():
    file = FILE.with_name("falling.py")
    said = call("run", f"{file}:floor", "--no-ideal").output
    assert "INTEGRATION (real)" in said
    assert "first at 0.452 s" in said
    helped = call("run", f"{file}:floor", "--no-ideal", "--set", "world.integration.method=rosenbrock").output
    assert "INTEGRATION" not in helped
    assert " 0.012 " in helped  # the height that Radau gives

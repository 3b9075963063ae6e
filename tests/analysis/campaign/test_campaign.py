"""A campaign of the real zero-velocity scenario: rows, reruns, and arguments rejected before flying."""

import numpy as np
import pytest

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.analysis.campaign.workers.local import RowCount, local_workers
from trimtab.analysis.campaign.workers.prepare import prepare_campaign, scenario_of
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.logs.metrics import metrics
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

NAME = "hovercraft/zero-velocity"
MASS, PERIOD = "world.vehicle.mass", "world.sensors.navigation.period"
SETTINGS = {"duration": "6"}
SPREAD = {MASS: "normal(100%, 5%)", "autopilot.law.k2": "uniform(80%, 120%)"}
WANTED = {"success": ["error_rms:yaw_rate <= 2.1"], "metrics": ["settling:yaw_rate", "peak:truth.sway_velocity"]}


def campaign(**changes):
    asked = {"runs": 150, "seed": 7, "spread": SPREAD, "settings": SETTINGS, **WANTED, **changes}
    return Campaign(NAME, **asked)


@pytest.fixture(scope="module")
def flown():
    made = campaign()
    return made, made.run()


@pytest.mark.thorough
def test_rows_contain_drawn_parameters_and_results(flown):
    _, found = flown
    names = {*SPREAD, "run", "settling:yaw_rate", "peak:truth.sway_velocity", "error_rms:yaw_rate", "success", "lost"}
    assert set(found.columns) == names
    assert (found.columns["run"] == np.arange(150)).all()
    assert found.success.successes == found.columns["success"].sum()
    assert 0 < found.success.successes < 150, "the bound is meant to be met by some"
    assert (found.columns["success"] == (found.columns["error_rms:yaw_rate"] <= 2.1)).all()
    assert 2.2 < found.columns[MASS].min() < 2.6 < found.columns[MASS].max() < 3.1
    assert found.flown_runs == 150


@pytest.mark.thorough("0", "77")
@pytest.mark.parametrize("run", [0, 77, 149])
def test_rerun_equals_its_row(flown, run):
    made, found = flown
    log = made.rerun(run)
    row = made.row(run, log)
    assert {name: row[name] for name in row} == {name: found.columns[name][run] for name in row}


def test_friction_of_zero_nominal_value_can_vary():
    path = "world.vehicle.friction.torque_viscous"
    ready = prepare_campaign(campaign(spread={path: "uniform(0, 0.02)"}).plan)
    drawn = [scenario_of(ready, run).world.vehicle.friction.torque_viscous for run in range(8)]
    assert 0 < min(drawn) < max(drawn) < 0.02


def test_row_equals_simulate_and_metrics(flown):
    """Uses none of the campaign's code: values are set explicitly, and logs.metrics evaluates the log."""
    made, found = flown
    scenario = build(NAME, SETTINGS)
    k2, mass = found.columns["autopilot.law.k2"][5], found.columns[MASS][5]
    law = replace(scenario.autopilot.law, k2=k2)
    world = replace(scenario.world, vehicle=replace(scenario.world.vehicle, mass=mass))
    one = replace(scenario, world=world, autopilot=replace(scenario.autopilot, law=law))
    log = simulate(one, seed=7, run=5, log_period=made.plan.log_period)
    settled = metrics(log, scenario.targets, ["yaw_rate"])["yaw_rate"]["settling_s"]
    expected = np.inf if settled is None else settled
    assert found.columns["settling:yaw_rate"][5] == expected
    assert found.columns["peak:truth.sway_velocity"][5] == np.abs(log["truth.sway_velocity"]).max()


def test_another_seed_changes_draws_and_more_runs_do_not(flown):
    _, found = flown
    few = campaign(runs=20).run()
    for name, column in few.columns.items():
        assert (column == found.columns[name][:20]).all(), name
    other = campaign(runs=20, seed=8).run()
    assert not (other.columns[MASS] == found.columns[MASS][:20]).any()


@pytest.mark.thorough
def test_campaign_accepts_scenario_object_and_metric_function(flown):
    _, found = flown

    def last_yaw(rows):
        return rows["yaw_rate"][:, -1]

    last_yaw.signals = ("truth.yaw_rate",)
    mine = Campaign(
        build(NAME, SETTINGS), runs=20, seed=7, spread=SPREAD, metrics=[last_yaw], success=WANTED["success"]
    )
    rows = mine.run().columns
    assert (rows["error_rms:yaw_rate"] == found.columns["error_rms:yaw_rate"][:20]).all()
    assert rows["last_yaw"][3] == mine.rerun(3)["truth.yaw_rate"][-1]
    assert not mine.by_name


@pytest.mark.thorough
def test_option_choices_are_flown_with_their_values():
    made = campaign(runs=12, spread={PERIOD: "choice(1 ms, 4 ms)", **SPREAD}, settings={"duration": "2"})
    rows = made.run().columns
    assert set(rows[PERIOD]) == {0, 1}
    for run in (int(np.argmin(rows[PERIOD])), int(np.argmax(rows[PERIOD]))):
        assert made.row(run, made.rerun(run))["peak:truth.sway_velocity"] == rows["peak:truth.sway_velocity"][run]


@pytest.mark.thorough
def test_success_without_targets_is_a_finite_state():
    scenario = replace(build(NAME, {"duration": "1"}), targets=())
    found = Campaign(scenario, runs=3, metrics=["peak:truth.yaw_rate"]).run()
    assert found.success.successes == 3
    away = replace(scenario, world=replace(scenario.world, vehicle=replace(scenario.world.vehicle, inertia=1e-300)))
    lost = Campaign(away, runs=3, metrics=["peak:truth.yaw_rate"]).run()
    assert lost.success.successes == 0
    assert lost.columns["lost"].all()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"runs": 0}, "runs"),
        ({"seed": -1}, "seed"),
        ({"spread": {MASS: "normal(100%, 60%)"}}, "out of range"),
        ({"spread": {"world.vehicle.mas": "normal(1, 2)"}}, "unknown parameter"),
        ({"metrics": ["settling:heading"]}, "no target"),
        ({"success": ["settling:yaw_rate"]}, "is not a condition"),
        ({"sampling": "grid"}, "unknown sampling"),
        ({"spread": {PERIOD: f"choice({', '.join(f'{k} ms' for k in range(1, 70))})"}}, "69 compiled programs"),
        ({"spread": {PERIOD: "choice(1 ms, nonsense)"}}, "nonsense"),
    ],
)
def test_rejects_invalid_arguments_before_flying(changes, problem):
    with pytest.raises(InputError, match=r"Fix: ") as refused:
        campaign(**changes)
    assert problem in str(refused.value)


@pytest.mark.parametrize(
    ("success", "problem", "fix"),
    [
        ("settling:yawrate <= 10", "no target for 'yawrate'", "settling:yaw_rate <= 10"),
        ("settling:yaw_rate <= 10 s", "'10 s' has a unit", "settling:yaw_rate <= 10"),
        ("error_rms:yaw_rate <= 10 deg/s", "'10 deg/s' has a unit", "error_rms:yaw_rate <= NUMBER"),
    ],
)
def test_mistyped_condition_error_suggests_the_correction(success, problem, fix):
    with pytest.raises(InputError) as refused:
        campaign(success=[success])
    assert problem in refused.value.problem
    assert f'"{fix}"' in refused.value.fix


def test_settings_require_a_scenario_name():
    with pytest.raises(InputError, match="change the scenario itself"):
        Campaign(build(NAME), settings={"duration": "3"})


def test_stop_function_ends_the_campaign_early():
    seen = []

    def stop(columns):
        seen.append(len(columns["run"]))
        return len(columns["run"]) >= 64

    made = campaign(runs=300, settings={"duration": "1"})
    made.ready = made.ready._replace(block=64)
    found = made.run(stop=stop)
    assert seen == [64]
    assert len(found.columns["run"]) == 64


def test_stop_function_sees_only_contiguous_rows():
    """Blocks finished out of order wait for earlier ones, because failing runs are often the quick ones."""
    seen = []

    def stop(columns):
        seen.append(list(columns["run"]))
        return False

    def out_of_order(ready, blocks, backend):
        first, second, third, last = local_workers(1, RowCount(None))(ready, blocks, backend)
        yield from (first, third, last, second)

    made = campaign(runs=10, settings={"duration": "0.1"})
    made.ready = made.ready._replace(block=3)
    made.run(stop=stop, workers=out_of_order)
    assert seen == [[0, 1, 2], [0, 1, 2], [0, 1, 2], list(range(10))]


def test_rejects_rerun_of_missing_run():
    with pytest.raises(InputError, match="run 150 does not exist"):
        campaign().scenario(150)


def test_campaign_uses_the_scenario_duration():
    assert campaign().ready.scenario.duration == seconds(6)

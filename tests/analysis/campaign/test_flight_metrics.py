"""Metrics of a spatial flight, such as `flight.roll`: a campaign's equal those of the run's log bit for bit."""

import numpy as np
import pytest
from logs.test_spatial import over_the_earth, replace_metadata
from loop.test_world_turbulence import throw

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.analysis.campaign.search.falsify import falsify
from trimtab.analysis.campaign.search.stability_map import parse_success
from trimtab.analysis.campaign.search.tune import tune
from trimtab.analysis.campaign.statistics.metrics import Rows
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.logs.metrics import Target
from trimtab.logs.spatial import find_logged_flight, place_parameters, with_flight
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.build import build

needs_c = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
KEPT = ("rms:flight.roll", "final:flight.altitude", "peak:flight.climb", "final:flight.ground_speed")
FORMULA = "robustness:always(flight.altitude > 2 m)"
RUNS = 5


def fly(scenario, metrics, **spread):
    return Campaign(scenario, runs=RUNS, seed=3, spread=spread or None, metrics=metrics, log_period=ms(20))


@pytest.mark.thorough
@needs_c
@pytest.mark.parametrize("name", ["quadrotor/track", "f16/gcas"])  # a state with a quaternion, and one with angles
def test_campaign_metric_equals_metric_of_the_run_log(name):
    scenario = replace(build(name), duration=seconds(2))
    campaign = fly(scenario, (*KEPT, FORMULA), **{"world.vehicle.mass": "normal(100%, 5%)"})
    columns = campaign.run().columns
    assert len(set(columns["rms:flight.roll"])) == RUNS
    for run in (0, RUNS - 1):
        log = campaign.rerun(run)
        row, flight = campaign.row(run, log), with_flight(log)
        assert {n: row[n] for n in row} == {n: columns[n][run] for n in row}
        assert row["rms:flight.roll"] == np.sqrt(np.mean(flight["flight.roll"] ** 2))
        assert row["final:flight.altitude"] == flight.final["flight.altitude"]
        assert row["peak:flight.climb"] == np.abs(flight["flight.climb"]).max()
        assert row[FORMULA] == pytest.approx(flight["flight.altitude"].min() - 2)


@pytest.mark.thorough
def test_derived_signals_use_the_parameters_of_each_run():
    log, _ = over_the_earth()
    parameters = log.metadata["parameters"]
    winds = np.array([parameters["world.vehicle.wind.north"], 25.0])
    own = {p: np.repeat(v, 2) for p, v in place_parameters(parameters).items()} | {"world.vehicle.wind.north": winds}
    signals = {p: np.stack([log[p], log[p]]) for p in log.paths}
    rows = Rows(log.t, signals, (), frozenset(), flight=find_logged_flight(log), parameters=own)
    for i, wind in enumerate(winds):
        of_run = replace_metadata(log, {"parameters": parameters | {"world.vehicle.wind.north": wind}})
        np.testing.assert_array_equal(rows["flight.air_speed"][i], with_flight(of_run)["flight.air_speed"])
    assert np.ptp(rows["flight.air_speed"], axis=0).max() > 1


@pytest.mark.thorough
def test_rotating_earth_runs_use_their_own_wind():
    scenario = replace(throw(None), duration=seconds(1))
    wind = {"world.vehicle.wind.north": "uniform(0, 40)", "world.vehicle.wind.east_shear": "uniform(0, 0.1)"}
    campaign = fly(scenario, ("mean:flight.air_speed", "final:flight.air_speed", "final:flight.north"), **wind)
    columns = campaign.run(backend="jax").columns
    assert np.ptp(columns["mean:flight.air_speed"]) > 1
    for run in (1, RUNS - 1):
        flight = with_flight(campaign.rerun(run))
        assert columns["final:flight.air_speed"][run] == pytest.approx(flight.final["flight.air_speed"], rel=1e-12)
        assert columns["mean:flight.air_speed"][run] == pytest.approx(flight["flight.air_speed"].mean(), rel=1e-12)


@needs_c
@pytest.mark.thorough
def test_targets_searches_and_maps_accept_flight_signals():
    scenario = replace(build("quadrotor/track"), duration=seconds(1), targets=(Target("flight.roll", 0.0, 0.2),))
    assert np.isfinite(fly(scenario, ("error_rms:flight.roll",)).run().columns["error_rms:flight.roll"]).all()
    judge, signals = parse_success(scenario, ["least:flight.altitude > 1"])
    assert set(signals) == {"truth.attitude", "truth.position", "truth.rate", "truth.velocity"}
    assert judge(simulate_batch(scenario, seeds=[1, 2], signals=signals, log=True)).all()
    spread = {"world.vehicle.mass": "uniform(95%, 105%)"}
    found = falsify(scenario, spread=spread, success=("peak:flight.roll < 1",), runs=400)
    assert (found.margin > 0) == (found.columns["peak:flight.roll"] < 1)


@pytest.mark.parametrize(
    ("name", "metric", "says", "fix"),
    [
        ("quadrotor/track", "rms:flight.rol", "flight.pitch_rate, flight.yaw_rate, flight.altitude", "rms:flight.roll"),
        ("hovercraft/spin", "rms:flight.roll", "this vehicle has no three-dimensional attitude", "rms:truth."),
        ("quadrotor/track", "rms:flight.air_speed", "there is no signal 'flight.air_speed'", "flight.ground_speed"),
    ],
)
def test_unknown_flight_signal_error_lists_available_ones(name, metric, says, fix):
    with pytest.raises(InputError) as refused:
        Campaign(name, runs=1, metrics=[metric])
    assert says in str(refused.value)
    assert fix in refused.value.fix


def test_gradient_tuning_rejects_derived_flight_signals():
    with pytest.raises(InputError, match="computed after the flight"):
        tune(
            "quadrotor/track", gains={"autopilot.law.nominal.kx": "50%:200%"}, cost="rms:flight.roll", method="gradient"
        )

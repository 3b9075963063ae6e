"""Identification from flights: wrong parameters are found, unidentifiable ones named, foreign logs rejected."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from analysis.identify.motion_capture import CLOCK, NAME, NOISE, capture_flight
from click.testing import CliRunner

from trimtab.analysis.identify.flight_data import FlightData, read_flight
from trimtab.analysis.identify.identification import Identified, identify, identify_each
from trimtab.cli import main
from trimtab.commands.identify import _print_unexplained
from trimtab.core.errors import InputError
from trimtab.core.quantity import leaves
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.logs.mcap import write_mcap
from trimtab.loop.calibration import read_calibration
from trimtab.loop.scenario import Scenario
from trimtab.run.simulate import simulate, simulate_many
from trimtab.scenarios.build import build

MY_BOAT = f"{Path(__file__).parents[3] / 'examples' / 'my_boat.py'}:scenario"
FRICTION = {"world.vehicle.friction.torque_viscous": "0.02", "world.vehicle.friction.force_viscous": "0.1"}
CRAFT: dict[str, tuple[dict[str, str], tuple[str, ...]]] = {
    "mass": ({**FRICTION, "world.vehicle.mass": "3.1"}, ("world.vehicle.mass",)),
    "inertia": ({**FRICTION, "world.vehicle.inertia": "0.12"}, ("world.vehicle.inertia",)),
    "thrust curve": ({**FRICTION, "world.actuators.effectiveness": "0.85"}, ("world.actuators.effectiveness",)),
    "friction": (
        {"world.vehicle.friction.torque_viscous": "0.05", "world.vehicle.friction.force_viscous": "0.3"},
        (),
    ),
    "bent rudder": ({**FRICTION, "world.actuators.geometry.offset": "0.06"}, ("world.actuators.geometry.offset",)),
}
"""What is wrong with each, and what is fitted besides both frictions and the delay."""
COMMON = ("world.vehicle.friction.torque_viscous", "world.vehicle.friction.force_viscous", "delay")


def fit(settings: dict[str, str], paths: tuple[str, ...], duration: float = 60.0, **options: Any) -> Identified:
    scenario = build(NAME)
    flights = [read_flight(capture_flight(settings, seed, duration), scenario) for seed in (1, 2)]
    return identify(scenario, flights[:1], paths, held_out=flights[1:], **options)


@pytest.mark.thorough
@pytest.mark.parametrize("what", CRAFT)
def test_wrong_craft_parameters_are_identified(what: str) -> None:
    settings, own = CRAFT[what]
    paths = (*own, *COMMON)
    found = fit(settings, paths)
    assert found.estimate.converged
    assert not found.groups
    truth = {"delay": CLOCK} | {p: float(v) for p, v in settings.items()}
    for p, (low, high), error in zip(found.parameters, found.intervals, found.standard_errors, strict=True):
        reach = (high - low) / 2
        assert abs(truth[p.path] - (low + high) / 2) < 1.6 * reach + 2e-4 * abs(truth[p.path]), p.path
        assert reach < 6 * error + 1e-9, p.path
    nominal, fitted = found.held_out["heading"]
    assert fitted <= nominal / 2
    assert found.noise["north"] == pytest.approx(0.002, rel=0.1)
    assert found.noise["heading"] == pytest.approx(0.005, rel=0.1)


@pytest.mark.thorough
def test_indistinguishable_parameters_are_named() -> None:
    """Only the product of a fan's coefficient and its effectiveness is observable."""
    paths = ("world.actuators.effectiveness", "world.actuators.thruster.coefficient")
    found = fit({}, paths, duration=6.0)
    assert found.groups == (paths,) or found.groups == (paths[::-1],)
    assert found.unidentifiable() == set(paths)


@pytest.mark.thorough
def test_noise_free_flight_identifies_the_true_mass() -> None:
    scenario = build(NAME)
    log = simulate(scenario.without("navigation-error"), seed=1, log_period=ms(20), duration="12 s")
    found = identify(scenario, [read_flight(log, scenario)], ["world.vehicle.mass"])
    (low, high), true = found.intervals[0], float(scenario.world.vehicle.mass)
    assert low < true < high
    assert abs(found.values[0] - true) < 1e-3 * true  # 7.8 % where the first command acts before it came
    assert found.unexplained == found.correlated == {}


@pytest.mark.thorough
def test_correlated_measurement_errors_are_named() -> None:
    """The law reacts to navigation errors that are correlated over a second, so the mass cannot be identified."""
    scenario = build(NAME)
    log = simulate(scenario, seed=1, log_period=ms(6))
    found = identify(scenario, [read_flight(log, scenario)], ["world.vehicle.mass"])
    assert found.unexplained
    assert found.correlated["heading"] > 0.8


@pytest.mark.thorough
@pytest.mark.parametrize("name", [MY_BOAT, NAME])
def test_mass_intervals_have_the_stated_coverage(name: str) -> None:
    """100 flights each: a boat by its own noisy sensor, the hovercraft as a motion capture sees it.

    The process noise is fitted, too, and can't be below 0, where it is: so they are rather too wide.
    """
    scenario = build(name)
    logs = simulate_many(scenario, seeds=range(1, 101), log_period=ms(20 if name == NAME else 10))
    see = see_pose if name == NAME else lambda log, scenario, seed: read_flight(log, scenario)
    flights = [see(log, scenario, seed) for seed, log in enumerate(logs)]
    ends = np.array([f.intervals[0] for f in identify_each(scenario, flights, ["world.vehicle.mass"])])
    true = float(scenario.world.vehicle.mass)
    inside = int(((ends[:, 0] <= true) & (true <= ends[:, 1])).sum())
    assert 90 <= inside <= 99
    assert np.median(ends[:, 1] - ends[:, 0]) < 0.03 * true


def see_pose(log: Log, scenario: Scenario, seed: int) -> FlightData:
    """Pose at each row, with the noise of a motion capture."""
    g, fields = np.random.default_rng([seed, 3]), [path for path, _, _ in leaves(scenario.initial)]
    y = np.full((len(log), len(fields)), np.nan)
    for name, (sigma, _) in NOISE.items():
        y[:, fields.index(name)] = log[f"truth.{name}"] + sigma * g.standard_normal(len(log))
    commands = type(scenario.failsafe.safe)(*(log[f"uplink.value.{n}"] for n in ("rudder_pulse", "speed_rpm")))
    return FlightData("capture", commands, log.ticks, log.ticks, y, log["uplink.valid"])


def test_rejects_log_of_another_vehicle() -> None:
    log = capture_flight({}, 1, 2.0)
    with pytest.raises(InputError, match="does not contain the commands FX, FY"):
        read_flight(log, build("hovercraft/spin").ideal(), name="flight.mcap")


@pytest.mark.thorough
def test_identify_command_writes_a_calibration(tmp_path: Any) -> None:
    write_mcap(capture_flight({"world.vehicle.inertia": "0.12"}, 1, 6.0), tmp_path / "flight.mcap")
    words = ["identify", NAME, str(tmp_path / "flight.mcap"), "--fit", "world.vehicle.inertia", "--fit", "delay"]
    shown = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "boat.toml")])
    assert shown.exit_code == 0, shown.output
    assert "world.vehicle.inertia" in shown.output
    entry = read_calibration(tmp_path / "boat.toml").entries["Hovercraft.inertia"]
    assert abs(entry.value - 0.12) < 5 * entry.standard_error + 2e-5
    assert np.isfinite(entry.value)


@pytest.mark.thorough
def test_heading_of_wrong_sign_is_unexplained_and_not_written(tmp_path: Any) -> None:
    log, name = capture_flight({"world.vehicle.inertia": "0.12"}, 1, 6.0), "sensors.mocap.value.heading"
    turned = Log(log.t, log.ticks, {p: -log[p] if p == name else log[p] for p in log.paths}, log.declarations)
    scenario = build(NAME)
    assert identify(scenario, [read_flight(log, scenario)], ["world.vehicle.inertia"]).unexplained == {}
    found = identify(scenario, [read_flight(turned, scenario)], ["world.vehicle.inertia"])
    assert "heading" in found.unexplained or "world.vehicle.inertia" in found.unidentifiable()
    assert found.unexplained
    write_mcap(turned, tmp_path / "turned.mcap")
    words = ["identify", NAME, str(tmp_path / "turned.mcap"), "--fit", "world.vehicle.inertia"]
    done = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "boat.toml")])
    assert done.exit_code == 2
    assert "does not explain" in done.output
    assert not (tmp_path / "boat.toml").exists()


@pytest.mark.thorough
def test_flights_of_two_vehicles_disagree(tmp_path: Any) -> None:
    for name, inertia, seed in (("a", "0.12", 1), ("b", "0.2", 2)):
        write_mcap(capture_flight({"world.vehicle.inertia": inertia}, seed, 6.0), tmp_path / f"{name}.mcap")
    words = ["identify", NAME, str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap"), "--fit", "world.vehicle.inertia"]
    done = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "boat.toml")])
    assert done.exit_code == 2, done.output
    assert "the logs a.mcap and b.mcap disagree with the others, so nothing is written" in done.output


def test_parameter_without_an_interval_is_unidentifiable() -> None:
    names = [SimpleNamespace(path=path) for path in "abcd"]
    ends = np.array([[np.nan, np.nan], [1.0, 2.0], [np.nan, 3.0], [0.0, 1.0]])
    found: Any = SimpleNamespace(parameters=names, intervals=ends, groups=[("d",)])
    assert Identified.unidentifiable(found) == {"a", "d"}


def test_disagreeing_flight_is_named(capsys: Any) -> None:
    found: Any = SimpleNamespace(unexplained={}, disagreeing={"b.mcap": 1e-9}, correlated={})
    _print_unexplained(found)
    assert (
        "not consistent: b.mcap disagrees with the other logs on the parameters (p-value 1.0e-09)"
        in capsys.readouterr().out
    )


def test_empty_measurement_file_is_named_in_error(tmp_path: Any) -> None:
    (tmp_path / "capture.csv").write_text("")
    (tmp_path / "map.toml").write_text("")
    words = ["identify", NAME, str(tmp_path / "capture.csv"), "--map", str(tmp_path / "map.toml"), "--fit", "delay"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert "capture.csv': is empty" in done.output


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda name, v: np.degrees(v) if name == "heading" else v, "if the log is in degrees"),
        (
            lambda name, v: np.where(np.arange(len(v)) // 8 == 50, 99.0, v) if name == "north" else v,
            "'north' differs by",
        ),
    ],
)
def test_jumping_measurements_are_rejected_with_the_cause(change: Any, said: str) -> None:
    log, block = capture_flight({}, 1, 4.0), "sensors.mocap.value"
    signals = {p: change(p.rpartition(".")[2], log[p]) if p.startswith(block) else log[p] for p in log.paths}
    with pytest.raises(InputError, match=said):
        read_flight(Log(log.t, log.ticks, signals, log.declarations), build(NAME), name="flight.mcap")

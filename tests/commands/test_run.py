"""`trimtab run`: consistency verdict of an estimate with sigmas, requirements, monitors and log sizes."""

import json
import re

import pytest
from click.testing import CliRunner

from trimtab.cli import main

BOAT = '''
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.rng import normals
from trimtab.core.signals import Estimate
from trimtab.core.time import seconds
from trimtab.estimators.inertial.navigation_state import HeadingFix, no_heading_fix
from trimtab.links.wire import Wire
from trimtab.scenarios import catalogue
from trimtab.sensors.navigation_errors import PlanarNavigation


@record
class Told:
    surge_velocity: Scalar = quantity("m/s", "Velocity.")
    sway_velocity: Scalar = quantity("m/s", "Velocity.")
    yaw_rate: Scalar = quantity("rad/s", "Rate.")
    heading: Scalar = quantity("rad", "Heading.", kind="angle")
    sigma_heading: Scalar = quantity("rad", "Standard deviation.")
    heading_fix: HeadingFix = part("How the headings fared.")


@record
class Compass:
    """Truth with white noise on the heading; it believes in noise of 0.01 rad."""

    sigma: Scalar = quantity("rad", "What the noise is.", default=0.01)
    listens = ("navigation",)

    def init(self, key: Any) -> Any:
        return key, no_heading_fix()

    def step(self, t: Any, state: Any, frame: Any) -> Any:
        (key, fix), s = state, frame.samples["navigation"]
        z = normals(key, t, 1) * self.sigma / 0.01
        new = replace(fix, normalised=z, nis=z[0] ** 2, used=fix.used + 1)
        fix = jax.tree.map(lambda a, b: jnp.where(s.fresh, a, b), new, fix)
        v = s.value
        told = Told(v.surge_velocity, v.sway_velocity, v.yaw_rate, v.heading + 0.01 * z[0], np.float64(0.01), fix)
        return (key, fix), Estimate(t=t, age=s.age, fresh=s.fresh, valid=s.valid, state=told)


def scenario():
    made, _ = catalogue.load_scenario("hovercraft/zero-velocity")
    world = replace(made.world, sensors={"navigation": PlanarNavigation()}, downlink=Wire())
    return replace(made, world=world, autopilot=replace(made.autopilot, estimator=Compass()), duration=seconds(1))
'''


@pytest.fixture
def boat(tmp_path, monkeypatch):
    (tmp_path / "boat.py").write_text(BOAT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    return "boat.py:scenario"


def call(*words):
    done = CliRunner().invoke(main, ["run", *map(str, words)])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize(("sigma", "verdict"), [(0.005, "pessimistic"), (0.01, "consistent"), (0.02, "optimistic")])
def test_json_reports_consistency_verdict(boat, sigma, verdict):
    words = ("--no-ideal", "--json", "--set", f"autopilot.estimator.sigma={sigma}", "--backend", "jax")
    found = json.loads(call(boat, *words))["navigation"]
    assert found["verdict"] == verdict
    assert set(found) == {"verdict", "probability", "since_s", "where", "aiding", "errors", "learned"}
    heading = found["aiding"]["heading"]
    assert (heading["white"], heading["unseen"], heading["nis"]["verdict"]) == (True, 0, verdict)
    assert heading["nis"]["factor"] == pytest.approx(sigma / 0.01, rel=0.1)
    assert found["errors"]["heading"]["verdict"] == verdict


@pytest.mark.thorough
def test_prints_navigation_table_and_writes_navigation_plot(boat, tmp_path, wide_screen):
    text = call(boat, "--no-ideal", "--plot", tmp_path / "flight.png", "--backend", "jax")
    assert "heading innovations" in text
    assert "navigation: consistent" in text
    assert "sigma_" not in text
    assert (tmp_path / "flight-navigation.png").read_bytes().startswith(b"\x89PNG")
    assert "flight-navigation.png" in text.replace("\n", "")


@pytest.mark.thorough
def test_run_too_short_for_valid_estimate_still_writes_plots(boat, tmp_path):
    """Samples arrive after 60 ms over Bluetooth, so no estimate becomes valid within 30 ms."""
    (tmp_path / "boat.py").write_text(BOAT.replace("downlink=Wire()", "downlink=made.world.downlink"))
    words = ("--no-ideal", "--duration", "30 ms", "--out", tmp_path / "out", "--backend", "jax")
    call(boat, *words)
    assert {f.name for f in (tmp_path / "out").iterdir()} == {"run.mcap", "run.png", "run-navigation.png"}


@pytest.mark.thorough
def test_scenario_without_sigmas_reports_no_navigation(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path))
    assert "navigation" not in json.loads(call("hovercraft/spin", "--duration", "0.2", "--no-ideal", "--json"))


@pytest.mark.thorough
def test_rejects_navigation_option_for_scenario_without_choices():
    done = CliRunner().invoke(main, ["run", "navigation/platform-encoder", "--navigation", "ins"])
    assert done.exit_code == 2
    for text in ("error: --navigation:", "hovercraft/spin", "trimtab list navigation/platform-encoder"):
        assert text in done.stderr
    assert "--set" not in done.stderr


KEPT = "always[1 s, 2 s](abs(truth.yaw_rate) < 100 rad/s)"
BROKEN = "always(abs(truth.surge_velocity) < 1 mm/s)"


def test_requirements_are_reported_and_decide_the_exit_code():
    def run(*words):
        return CliRunner().invoke(main, ["run", "hovercraft/zero-velocity", "--duration", "2 s", "--no-ideal", *words])

    kept = run("--require", KEPT)
    assert kept.exit_code == 0, kept.output
    assert "require: holds, robustness 9" in kept.output
    assert f"rad/s: {KEPT}" in kept.output
    broken = run("--require", KEPT, "--require", BROKEN, "--json")
    assert broken.exit_code == 1
    first, second = json.loads(broken.stdout)["requirements"]
    assert (first["formula"], first["holds"], first["unit"]) == (KEPT, True, "rad/s")
    assert not second["holds"]
    assert second["robustness"] < 0
    for formula, says in (
        ("always(truth.yaw_rate <)", "at column 24"),
        ("always(truth.yaw_rat < 1)", "truth.yaw_rate"),
        ("truth.yaw_rate < 1", "Fix: --require 'always(truth.yaw_rate < 1)'"),
        ("always[0, 3 s](truth.yaw_rate < 1)", "looks 3 s ahead, but the run lasts 2 s"),
    ):
        refused = run("--require", formula)
        assert refused.exit_code == 2
        assert says in refused.output


@pytest.mark.thorough
def test_monitor_verdict_is_printed_below_the_table():
    monitor = "autopilot.monitor.formulas=quick: eventually(estimate.state.surge_velocity > 100 m/s)"
    command = ["run", "hovercraft/zero-velocity", "--duration", "1 s", "--no-ideal", "--set", monitor]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    assert "monitor quick (real): pending at the end\n" in done.output


@pytest.mark.thorough
def test_size_of_large_log_is_printed_before_writing(tmp_path):
    words = ["run", "hovercraft/zero-velocity", "--duration", "25", "--out", str(tmp_path), "--json"]
    done = CliRunner().invoke(main, words)
    said = re.findall(r"^log: about (\d+) MB$", done.stderr, re.MULTILINE)
    assert len(said) == 1, done.stderr
    size = sum(file.stat().st_size for file in tmp_path.glob("*.mcap"))
    assert size / 2 < int(said[0]) * 1e6 < 2 * size
    assert "\n" not in done.stdout.strip()


@pytest.mark.thorough
def test_size_of_small_log_is_not_printed(tmp_path):
    done = CliRunner().invoke(main, ["run", "hovercraft/spin", "--duration", "1", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "log: about" not in done.output

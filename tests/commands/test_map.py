"""`trimtab map`: text output, JSON, and invalid axes, which are rejected before simulation."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.map import parse_axis

NAME = "hovercraft/zero-velocity"
FEW = {"x": "delay=0:0.6:4", "y": "jitter=0:0.3:3", "runs": 1, "depth": 1, "set": "duration=6 s"}


def call(*words, **changes):
    options = [f"--{name}={value}" for name, value in (FEW | changes).items()]
    return CliRunner().invoke(main, ["map", NAME, "--without", "navigation-error", *options, *words])


@pytest.mark.thorough
def test_json_reports_stability_map_and_plot_is_written(tmp_path):
    picture = tmp_path / "made" / "map.png"
    done = call("--json", plot=picture)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["files"] == [str(picture)]
    assert picture.stat().st_size > 5000
    assert (found["x"]["name"], found["y"]["unit"]) == ("uplink delay", "s")
    assert (len(found["x"]["values"]), len(found["y"]["values"]), found["full_grid"]) == (7, 5, 35)
    assert found["flown"] == len(found["points"]) <= 35
    share = {(a, b): s for a, b, s in found["points"]}
    assert share[0.6, 0.0] == 0  # far beyond the delay margin
    assert set(found["theory"]) == {"delay margin", "jitter margin"}
    (line,) = found["theory"]["delay margin"]
    # at rest the margin is 433 ms, of which 36 ms and 12 ms of waiting are the rest of the loop's, in frames of 20 ms
    assert max(d for d, j in line if j == 0) == pytest.approx(0.385, abs=0.02)


@pytest.mark.thorough
def test_text_output_reports_boundary_and_flown_points():
    done = call("--no-theory", x="delay=0.1:0.6:3", y="autopilot.law.k2=80%:120%:2", set="duration=20 s")
    for text in (
        "of 15 points flown, 1 run each",
        "autopilot.law.k2 0.8 × own: succeeds at 0.1, boundary at uplink delay 0.",
    ):
        assert text in done.stdout


@pytest.mark.thorough("peak:yaw_rate <= 100---x or --y")
@pytest.mark.parametrize(
    ("success", "said"),
    [("peak:yaw_rate <= 0.001", "fails everywhere.*--success 'error_rms:"), ("peak:yaw_rate <= 100", "--x or --y")],
)
def test_missing_boundary_is_reported_with_suggested_option(success, said):
    ends = {"x": "world.vehicle.mass=2:3:2", "y": "delay=0:0.01:2"}
    done = call("--no-theory", **ends, success=success, set="duration=1 s")
    assert re.search(said, done.stdout)


def test_parses_axis_from_text():
    found = parse_axis("--x", "downlink-loss=0:0.5:6")
    assert (found.name, found.link, found.kind, len(found.values)) == ("downlink loss", "downlink", "loss", 6)
    np.testing.assert_allclose(parse_axis("--x", "world.vehicle.mass=80%:120%").values, np.linspace(0.8, 1.2, 5))
    assert parse_axis("--y", "world.vehicle.mass=2:3").name == "world.vehicle.mass"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"x": "delay"}, "not of the form NAME=LOW:HIGH"),
        ({"x": "delay=0:fast"}, "not a range of numbers"),
        ({"x": "delay=0.6:0"}, "LOW below HIGH"),
        ({"x": "delay=-1:0.6"}, "delay must be at least 0 s, got -1:0.6"),
        ({"x": "downlink-jitter=-1:0.6"}, "downlink-jitter must be at least 0 s"),
        ({"y": "loss=0:1.9"}, "loss must be between 0 and 1"),
        ({"x": "world.vehicle.mass=-1:3"}, "--x world.vehicle.mass: -1.0 kg is out of range"),
        ({"x": "delay=0%:50%"}, "cannot be given in per cent"),
        ({"x": "lag=0:1"}, "downlink-jitter"),
        ({"x": "autopilot.law.k9=1:2"}, "autopilot.law.k2"),
        ({"y": "delay=0:0.3"}, "must differ from --x"),
        ({"plot": "map.txt"}, "supported picture format"),
        ({"runs": 0}, "--runs: must be a whole number from 1 to 10000000, got 0"),
        ({"seed": -1}, "seed"),
    ],
)
def test_invalid_axes_are_rejected_before_simulation(tmp_path, monkeypatch, changes, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "trimtab.analysis.campaign.search.stability_map.simulate_batch", lambda *a, **k: pytest.fail("it flew")
    )
    done = call(**changes)
    assert done.exit_code == 2
    assert said in done.stderr

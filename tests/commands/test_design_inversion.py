"""`trimtab design --inversion`: the trajectory as data, and invalid arguments."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main

CART = "examples/my_cart.py"


def call(*words):
    return CliRunner().invoke(main, ["design", *[str(w) for w in words]])


@pytest.mark.thorough
def test_inverted_pendulum_leans_before_cart_moves_to_target(tmp_path):
    file, picture = tmp_path / "course.json", tmp_path / "course.png"
    words = ("--inversion", "--output", "position", "--to", "50 cm", "--in", "2", "--out", file, "--plot", picture)
    done = call(CART, *words)
    assert done.exit_code == 0, done.output
    assert "relative degree position 2" in done.output
    assert picture.stat().st_size > 5000
    course = json.loads(file.read_text(encoding="utf-8"))
    x, times = np.array(course["x"]), np.array(course["times"])
    assert x[-1, 0] == pytest.approx(0.5)
    assert (course["unstable"], course["degrees"]) == (1, {"position": 2})
    assert course["end"] - course["begin"] == pytest.approx(2.0)
    # before it begins the place stands, while the pole leans, by the zero's own exponent
    before = times < course["begin"] - 0.3
    assert np.abs(x[before, 0]).max() < 1e-9
    growth = np.polyfit(times[before][50:], np.log(np.abs(x[before, 2][50:])), 1)[0]
    assert growth == pytest.approx(np.sqrt(9.80665 / 0.5), rel=2e-3)
    said = json.loads(call(CART, *words[:7], "--json").stdout)  # by the schema of answers: tests/answers.py
    assert (said["places"], said["slow"], said["x"]) == ([], [], course["x"])


@pytest.mark.thorough
def test_inversion_of_f16_climb_uses_elevator_and_integrates_position(tmp_path):
    """North, east and heading are integrals. The elevator moves before the altitude does."""
    file = tmp_path / "climb.json"
    words = ("--inversion", "--input", "elevator", "--output", "altitude", "--to", "330 m", "--in", "4", "--out", file)
    done = call("f16/gcas", *words)
    assert done.exit_code == 0, done.output
    assert "positions, integrated from their initial values: yaw, north, east" in done.output
    assert "in speed; stable, solved forwards" in done.output
    course = json.loads(file.read_text(encoding="utf-8"))
    assert (course["inputs"], course["unstable"]) == (["elevator"], 1)
    times = np.array(course["times"])
    x = dict(zip(course["states"], np.array(course["x"]).T, strict=True))
    path = x["pitch"] - x["alpha"]
    np.testing.assert_allclose(x["speed"] * np.sin(path), np.gradient(x["altitude"], times), atol=0.05)
    over_ground = x["speed"] * np.cos(path)
    steps = np.diff(times) * (over_ground[1:] + over_ground[:-1]) / 2
    np.testing.assert_allclose(x["north"][1:], np.cumsum(steps), atol=0.02)
    early = times < course["begin"]
    elevator = np.degrees(np.array(course["u"])[:, 0])
    assert np.ptp(x["altitude"][early]) < 1e-6
    assert np.ptp(elevator[early]) > 0.3


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ((CART, "--inversion"), "--output position --to 0.5 --in 2"),
        ((CART, "--inversion", "--output", "position", "--in", "2"), "one --to for each --output"),
        ((CART, "--output", "position"), "add --inversion"),
        ((CART, "--input", "force"), "add --inversion"),
        (
            (CART, "--inversion", "--output", "position", "--to", "1", "--in", "2", "--input", "farce"),
            "Fix: --input force",
        ),
        ((CART, "--in", "2"), "leave --in out"),
        ((CART, "--inversion", "--lqr"), "leave --lqr out"),
        ((CART, "--inversion", "--limit", "force=1"), "leave --limit out"),
    ],
)
def test_invalid_arguments_are_rejected_with_command_to_type(words, wanted):
    done = call(*words)
    assert done.exit_code == 2, done.output
    assert wanted in " ".join(done.output.split()), done.output

"""Each `--navigation` of the hovercraft: building, `list` and `--help`, and the accuracy on its page.

The table of docs/scenarios.md, Navigation systems, is printed, and compared with the page, by
`pytest -n0 -s -m thorough tests/scenarios/test_navigation_choices.py`.
"""

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import ms
from trimtab.logs.navigation import state_series
from trimtab.run.known_signals import find_signals
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build

NAME = "hovercraft/zero-velocity"
KINDS = catalogue.scenario_choices(NAME)["navigation"]
PAGE = Path(__file__).parents[2] / "docs" / "scenarios.md"
SEEDS, LATE = range(8), 5.0
GROUPS = {"velocity": ("surge_velocity", "sway_velocity"), "position": ("north", "east"), "heading": ("heading",)}


def test_every_navigation_kind_appears_in_list_and_help():
    listed = json.loads(CliRunner().invoke(main, ["list", NAME, "--json"]).output)["choice_lines"]["navigation"]
    assert set(listed) == set(KINDS) >= {"errors", "ins", "tight", "particle"}
    assert len({*listed.values()}) == len(KINDS)
    text, help = (
        "".join(CliRunner().invoke(main, words).output.split()) for words in (["list", NAME], ["run", "--help"])
    )
    for kind, line in listed.items():
        assert kind in text
        assert line.split()[0] in text
        assert kind in help


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_every_navigation_kind_estimates_the_states_of_the_law(kind):
    """The full loop is only traced: mismatched parts would raise here."""
    scenario = build(NAME, {"navigation": kind})
    shapes = find_signals(scenario).shapes
    assert {f"estimate.state.{name}" for name in scenario.autopilot.law.reads} <= shapes.keys()
    assert ("estimate.state.sigma_north" in shapes) == (kind != "errors")


@functools.cache
def flown(kind):
    """Return the rms error and the NEES per dimension of each group of states, over seeds, from LATE on."""
    logs = simulate_many(build(NAME, {"navigation": kind}), seeds=SEEDS, log_period=ms(10))
    errors, normalised = ({group: [] for group in GROUPS} for _ in range(2))
    for log in logs:
        series = state_series(log)
        for group, names in GROUPS.items():
            for one in (series[n] for n in names):
                late = one.t > LATE
                errors[group].append(np.mean(one.error[late] ** 2))
                normalised[group].append(np.mean((one.error[late] / one.sigma[late]) ** 2))
    rms = {group: np.sqrt(np.mean(squares) * len(GROUPS[group])) for group, squares in errors.items()}
    return rms, {group: np.mean(squares) for group, squares in normalised.items()}


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "errors"])
def test_every_navigation_kind_matches_the_accuracy_on_its_page(kind):
    rms, nees = flown(kind)
    sizes = f"{1000 * rms['position']:.1f} | {1000 * rms['velocity']:.0f} | {np.degrees(rms['heading']):.2f}"
    honest = " | ".join(f"{nees[group]:.2f}" for group in ("position", "velocity", "heading"))
    line = f"| `{kind}` | {sizes} | {honest} |"
    print(line)
    assert rms["position"] < 0.03
    assert rms["velocity"] < 0.05
    assert rms["heading"] < 0.03
    assert line in PAGE.read_text(encoding="utf-8")

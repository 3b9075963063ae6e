"""Hovercraft in formation: convergence, separation, decentralised commands, speed, and JAX against C."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from trimtab import Campaign, InputError, build
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.export.export_c import export_c
from trimtab.run.replay import compare_logs
from trimtab.run.simulate import simulate
from trimtab.scenarios.swarm.formation import SPACING, hexagonal_places

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here: JAX takes minutes")
TOUCH = 0.64
"""Distance (m) at which two craft touch: twice the arm, as far as a craft reaches from its centre of mass."""
SEEN = ("truth", "sensors.arena", "law")


def fly(scenario, duration=None, **more):
    return simulate(scenario, duration=duration, log_period=ms(100), signals=SEEN, backend="c", **more)


def benchmark():
    path = Path(__file__).parents[2] / "benchmarks" / "swarm.py"
    spec = importlib.util.spec_from_file_location("benchmark_swarm", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nearest(log):
    """Return the least distance between craft, from the truth."""
    north, east = log["truth.north"], log["truth.east"]
    apart = np.hypot(north[..., None] - north[:, None], east[..., None] - east[:, None])
    n = north.shape[1]
    return apart[:, *np.triu_indices(n, 1)].min(axis=1)


@pytest.mark.thorough
@pytest.mark.parametrize("craft", ["3", "10"])
def test_swarm_forms_without_collision(craft):
    log = fly(build("swarm/formation", {"craft": craft}))
    spacing, formation_error = log["sensors.arena.value.spacing"], log["sensors.arena.value.formation_error"]
    np.testing.assert_allclose(spacing, nearest(log), rtol=1e-12)
    assert spacing.min() > TOUCH
    assert (formation_error[log.t > 45] < 0.6).all()
    assert (log["law.place_error"][log.t > 45] < 0.05).all(), "the points are in their places"
    assert 0.02 < log["law.oldest"][log.t > 1].max() < 1.0


@pytest.mark.real_time
def test_hundred_craft_form_faster_than_real_time():
    import time

    scenario = build("swarm/formation", {"craft": "100"})
    fly(scenario, seconds(1))
    log = fly(scenario)
    began = time.perf_counter()
    fly(scenario)
    factor = 150 / (time.perf_counter() - began)
    print(f"100 craft: {factor:.1f} times real time; least {log['sensors.arena.value.spacing'].min():.2f} m")
    assert log["sensors.arena.value.spacing"].min() > TOUCH
    assert log["sensors.arena.value.formation_error"][-1] < 1.5
    assert factor > 1


@pytest.mark.thorough
def test_ideal_twin_forms_and_is_measured():
    log = fly(build("swarm/formation").ideal())
    assert log["sensors.arena.value.spacing"].min() > 1.0
    assert log["sensors.arena.value.formation_error"][-1] < 0.3
    assert log["law.oldest"][log.t > 1].max() <= 0.02 + 1e-9, "messages come within one control period"


@pytest.mark.thorough
def test_craft_without_messages_are_bit_for_bit_independent():
    """With all messages lost, no craft depends on another: the command is decentralised on the full loop."""
    deaf = build("swarm/formation", {"craft": "3", "world.sensors.craft.radio.loss": "1"})
    east, third = np.array(deaf.initial.east), np.array([0, 0, 1.0])
    moved = replace(deaf, initial=replace(deaf.initial, east=east + 0.7 * third, heading=2 * third))
    one, other = (fly(s, seconds(10)) for s in (deaf, moved))
    for name in ("north", "east", "heading", "surge_velocity"):
        np.testing.assert_array_equal(one[f"truth.{name}"][:, :2], other[f"truth.{name}"][:, :2])
        assert one[f"truth.{name}"][-1, 2] != other[f"truth.{name}"][-1, 2]
    assert (one["law.speed"] == 0).all(), "nobody may move who has not heard the others"
    heard = build("swarm/formation", {"craft": "3"})
    moved = replace(heard, initial=replace(heard.initial, east=east + 0.7 * (np.arange(3) == 0)))
    one, other = (fly(s, seconds(10)) for s in (heard, moved))
    assert (one["truth.north"][-1, 1:] != other["truth.north"][-1, 1:]).all(), "what is heard does change them"


@pytest.mark.thorough
def test_craft_with_swapped_places_pass_without_collision():
    log = fly(build("swarm/formation", {"start": "swapped", "route": "fixed"}), seconds(100))
    assert log["sensors.arena.value.spacing"].min() > TOUCH
    assert log["sensors.arena.value.formation_error"][-1] < 0.6


@pytest.mark.thorough
def test_random_starts_never_collide():
    scenario = build("swarm/formation")
    metrics = ["least:sensors.arena.value.spacing", "final:sensors.arena.value.formation_error"]
    campaign = Campaign(
        "swarm/formation", runs=120, seed=5, spread=benchmark().starts(scenario), metrics=metrics,
        success=[f"{metrics[0]} >= {TOUCH}"],
    )  # fmt: skip
    found = campaign.run()
    print(f"120 random starts: least distance {found.columns[metrics[0]].min():.2f} m")
    assert found.columns["success"].all()
    assert (found.columns[metrics[1]] < 1).mean() > 0.95


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_ten_thousand_random_starts_never_collide(capsys):
    benchmark().fly_campaign(10_000)
    text = capsys.readouterr().out
    print(text)
    assert "never nearer than 0.64 m: 10000 of 10000" in text


@pytest.mark.thorough
def test_jax_and_c_backends_agree():
    scenario = replace(build("swarm/formation", {"craft": "3"}), duration=ms(600))
    logs = [simulate(scenario, backend=b, signals=SEEN) for b in ("jax", "c")]
    found = compare_logs(*logs)
    assert found.is_equal, found.worst


def test_places_are_a_hexagonal_lattice_around_the_leader():
    places = hexagonal_places(19)
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1)) + 1e9 * np.eye(19)
    assert apart.min() == pytest.approx(SPACING)
    assert (np.isclose(apart, SPACING).sum(axis=1) == [6] * 7 + [3, 4] * 6).sum() >= 13
    np.testing.assert_array_equal(places[0], 0)
    assert np.hypot(*places.T).max() == pytest.approx(2 * SPACING)
    assert math.isclose(np.abs(places.sum(axis=0)).max(), 0, abs_tol=1e-9)


@pytest.mark.thorough
def test_rejects_c_export_of_a_swarm_autopilot(tmp_path):
    with pytest.raises(InputError, match="is not logged"):
        export_c(build("swarm/formation", {"craft": "3"}), tmp_path, steps=5)

"""Stability maps compared with linear theory and single flights, and arguments rejected before flying."""

import numpy as np
import pytest

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.analysis.campaign.search.axes import axis_of_link, axis_of_path, enlarge_rings, with_values
from trimtab.analysis.campaign.search.map_theory import loop_delay
from trimtab.analysis.campaign.search.stability_map import parse_success, stability_map, target_success, values_at
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.design.loop_transfer import loop_of_law
from trimtab.design.margins import delay_margin
from trimtab.logs.metrics import Target
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue
from trimtab.scenarios.build import build
from trimtab.vehicles.hovercraft import HovercraftState


@pytest.fixture(scope="module")
def linear():
    """Return forward flight without noise, limits and packet frames, from a small error, as linear theory assumes."""
    s = catalogue.load_scenario("hovercraft/forward")[0].without("navigation-error")
    s = replace(s, world=replace(s.world, actuators=DirectActuation()), duration=seconds(20))
    s = replace(s, autopilot=replace(s.autopilot, allocation=DirectAllocation()))
    return replace(s, initial=HovercraftState(surge_velocity=2.8 / 2.6, sway_velocity=0.02, yaw_rate=0.05))


@pytest.fixture(scope="module")
def found(linear):
    axes = axis_of_link("delay", np.linspace(0.08, 0.24, 3)), axis_of_link("jitter", np.linspace(0.0, 0.16, 3))
    return stability_map(linear, *axes, runs=3, depth=3)


def mean_delay(diagram, delay, y=0.0):
    """Return the mean delay of the loop (s) at one point of a map."""
    values = values_at(diagram.scenario, diagram.x, diagram.y, delay, y)
    return loop_delay(with_values(diagram.scenario, values)).mean


@pytest.mark.thorough
def test_boundary_without_jitter_is_the_delay_margin(found):
    """The mean delay of the loop on both sides of the boundary is 191.2 ms, within a step of the map."""
    law = found.scenario.autopilot.law
    limit = delay_margin(loop_of_law(found.scenario.world.vehicle, law, law.equilibrium())).delay
    ((low, high),) = found.crossings(0.0)
    step = high - low
    assert step == pytest.approx(0.01)
    assert mean_delay(found, low) - step < limit < mean_delay(found, high) + step


@pytest.mark.thorough
def test_limit_cycle_inside_the_bands_counts_as_failure():
    """Forward flight on its own drive: beyond the delay margin it swings for ever, by 12 % of the band of sway.

    The edge is within a step of the margin; judged by the bands alone it lies far beyond.
    """
    start = {"initial.sway_velocity": "0.05", "initial.yaw_rate": "0.15", "duration": "30"}
    real = build("hovercraft/forward", start, without=["navigation-error"])
    axes = axis_of_link("delay", np.linspace(0.08, 0.24, 3)), axis_of_path("initial.yaw_rate", [0.1, 0.15])
    law = real.autopilot.law
    limit = delay_margin(loop_of_law(real.world.vehicle, law, law.equilibrium())).delay
    diagram = stability_map(real, *axes, runs=1, depth=2)
    for yaw_rate in axes[1].values:
        ((low, high),) = diagram.crossings(float(yaw_rate))
        step = high - low
        assert step == pytest.approx(0.02)
        assert mean_delay(diagram, low, yaw_rate) - step < limit < mean_delay(diagram, high, yaw_rate) + step
    assert stability_map(real, *axes, runs=1, depth=0, swing=1.0).share.all()


@pytest.mark.thorough
def test_jitter_moves_the_boundary_to_shorter_delays(found):
    ends = [found.crossings(j)[0][1] for j in (0.0, 0.08)]
    assert 0.02 < ends[0] - ends[1] < 0.08
    assert found.traced_boundary.evaluated_points < 0.45 * found.traced_boundary.of == 0.45 * 17 * 17


def dies_away(x, small):
    """Return True if the amplitude falls by a tenth from the first to the second half, or is negligible."""
    before, last = (part.max() - part.min() for part in (x[: len(x) // 2], x[len(x) // 2 :]))
    return last < 0.9 * before or last / 2 <= small


@pytest.mark.thorough
def test_point_share_equals_single_flight_successes(found):
    edge = np.flatnonzero((found.share > 0) & (found.share < 1))
    for n in edge[:1] if len(edge) else [len(found.share) - 1]:
        a, b = found.sample_points[n]
        scenario = with_values(found.scenario, values_at(found.scenario, found.x, found.y, a, b))
        ok = []
        for seed in range(3):
            log = simulate(scenario, seed=seed, log_period=ms(1))
            late = log.t >= 20 * 2 / 3
            near = all((abs(log[t.path] - t.value)[late] <= t.band).all() for t in scenario.targets)
            ok.append(near and all(dies_away(log[t.path][late], 0.1 * t.band) for t in scenario.targets))
        assert found.share[n] == pytest.approx(np.mean(ok))


@pytest.mark.thorough
def test_swapping_axes_gives_the_same_map(linear, found):
    turned = stability_map(linear, found.y, found.x, runs=3, depth=1)
    shares = {tuple(p): s for p, s in zip(found.sample_points.tolist(), found.share, strict=True)}
    both = [
        (s, shares[b, a])
        for (a, b), s in zip(turned.sample_points.tolist(), turned.share, strict=True)
        if (b, a) in shares
    ]
    assert len(both) >= 9
    assert all(mine == theirs for mine, theirs in both)


@pytest.mark.thorough
def test_user_success_function_is_applied(linear):
    def slow(batch):
        return batch.most["truth.yaw_rate"] < 0.1

    x, y = axis_of_path("initial.yaw_rate", [0.0, 0.2]), axis_of_path("autopilot.law.k1", [0.5, 1.5])
    made = stability_map(linear, x, y, runs=1, depth=3, success=slow, signals=("truth.yaw_rate",))
    ((low, high),) = made.crossings(0.5)
    assert (low, high) == pytest.approx((0.075, 0.1))  # it starts at its highest


def test_angle_targets_are_met_modulo_full_turns(linear):
    s = replace(linear, targets=(Target("truth.heading", 0.1, 0.05),), duration=seconds("0.3"))
    s = replace(s, initial=replace(s.initial, sway_velocity=0.0, yaw_rate=0.0))
    headings = 0.1 + np.array([0.0, 2 * np.pi, -4 * np.pi, 1.0])
    batch = simulate_batch(s, seeds=range(4), spread={"initial.heading": headings}, log=True, signals=("truth",))
    np.testing.assert_array_equal(target_success(s)(batch), [True, True, True, False])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"x": axis_of_path("autopilot.law.k3", [1, 2])}, "autopilot.law.k2"),
        ({"x": axis_of_path("autopilot.law.k2", [-1.0, 2])}, "above 0"),
        ({"x": axis_of_path("autopilot.law.k2", [1.0])}, "increasing"),
        ({"runs": 0}, "one run or more"),
        ({"threshold": 1.5}, "threshold"),
        ({"depth": 99}, "depth"),
    ],
)
def test_rejects_invalid_arguments_before_flying(linear, monkeypatch, change, says):
    monkeypatch.setattr(
        "trimtab.analysis.campaign.search.stability_map.simulate_batch", lambda *a, **k: pytest.fail("it flew")
    )
    axes = {"x": axis_of_path("autopilot.law.k2", [1.0, 2.0]), "y": axis_of_link("delay", [0.0, 0.1])}
    with pytest.raises(InputError, match=says):
        stability_map(linear, **(axes | change))


def test_scenario_without_targets_needs_a_success_function(linear):
    with pytest.raises(InputError, match="no targets"):
        target_success(replace(linear, targets=()))


@pytest.mark.thorough
def test_batch_conditions_match_each_single_log():
    scenario = build("hovercraft/zero-velocity", {"duration": "4"})
    judge, signals = parse_success(scenario, ["peak:truth.surge_velocity <= 0.75", "error_rms:yaw_rate < 3.5"])
    assert signals == ("truth.surge_velocity", "truth.yaw_rate")
    batch = simulate_batch(scenario, seeds=range(24), signals=signals, log=True, log_period=ms(10))
    found = judge(batch)
    assert 0 < found.sum() < 24
    for seed in (0, 5, 11, 23):
        log = simulate(scenario, seed=seed, log_period=ms(10), duration=seconds(4))
        late = log.t >= log.t[-1] / 2
        surge = np.abs(log["truth.surge_velocity"]).max() <= 0.75
        yaw = np.sqrt(np.mean(log["truth.yaw_rate"][late] ** 2)) < 3.5
        assert found[seed] == (surge and yaw)


def test_rejects_condition_without_a_target():
    scenario = build("hovercraft/zero-velocity")
    with pytest.raises(InputError, match="no target"):
        parse_success(scenario, ["settling:heading <= 3"])


@pytest.mark.thorough
def test_predictor_quadruples_the_largest_stable_delay():
    """Forward flight with published navigation errors, 16 equal seeds; success is final sway below 0.2 m/s."""
    edges = {}
    for choice, last in (("off", 0.4), ("on", 1.6)):
        scenario = build("hovercraft/forward", {"predictor": choice})
        success, signals = parse_success(scenario, ["tail_rms:sway_velocity <= 0.2"])
        axes = axis_of_link("delay", np.linspace(0, last, 5)), axis_of_path("world.vehicle.mass", [2.6, 2.7])
        diagram = stability_map(scenario, *axes, runs=16, depth=2, success=success, signals=signals)
        ((edges[choice], high),) = diagram.crossings(2.6)
        assert high - edges[choice] == pytest.approx(last / 16)
    assert edges["off"] == pytest.approx(0.175)
    assert edges["on"] >= 4 * edges["off"]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "start"), [("forward", 2.8 / 2.6), ("reverse", -1.98 / 2.6)])
def test_stability_changes_within_two_percent_of_delay_margin(name, start):
    """A small error decays if the mean delay of the loop is 2 % below the margin, and grows if 2 % above."""
    scenario = catalogue.load_scenario(f"hovercraft/{name}")[0].without("navigation-error")
    scenario = replace(
        scenario,
        world=replace(scenario.world, actuators=DirectActuation()),
        autopilot=replace(scenario.autopilot, allocation=DirectAllocation()),
        initial=HovercraftState(surge_velocity=start, sway_velocity=1e-6, yaw_rate=1e-6),
        duration=seconds(60),
    )
    law = scenario.autopilot.law
    limit = delay_margin(loop_of_law(scenario.world.vehicle, law, law.equilibrium())).delay
    axis = axis_of_link("delay", [0.0, 0.6])
    base = axis.prepare(scenario)
    base = enlarge_rings(base, with_values(base, axis.change(base, 0.6)))
    rest = loop_delay(base).mean
    grows = []
    for share in (0.98, 1.02):
        delay = round(share * limit - rest, 3)
        flown = with_values(base, axis.change(base, delay))
        assert loop_delay(flown).mean == pytest.approx(share * limit, abs=1e-3)
        log = simulate(flown, seed=0, log_period=ms(10))
        yaw = np.abs(log["truth.yaw_rate"])
        grows.append(yaw[-500:].max() > yaw[2500:3000].max())
    assert grows == [False, True]

"""Slopes compared with known functions and finite differences, and tunings compared with validation runs."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from trimtab.analysis.campaign.grammar import parse_cost
from trimtab.analysis.campaign.sampling.spread import parse_factors, resolve_spread
from trimtab.analysis.campaign.search.cost import evaluate_cost, integral_cost
from trimtab.analysis.campaign.search.tune import UNSEEN, Gains, campaign_gains, parse_gain, tune
from trimtab.analysis.campaign.search.tune_methods import (
    combine_estimates,
    descend_gradient,
    estimate_slope,
    fold_points,
    merit,
    search_gains,
)
from trimtab.analysis.campaign.workers.prepare import CampaignPlan, PreparedCampaign, prepare_campaign
from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import leaves, replace
from trimtab.core.time import ms, seconds, to_seconds
from trimtab.run.gradient import gradient, gradients
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.build import build

needs_c = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
NAME = "hovercraft/zero-velocity"
GAINS = {"autopilot.law.k1": "0.5:3", "autopilot.law.k2": "loguniform(0.5, 5)"}
SHORT = {"duration": "6 s"}


def call(gains, settings, *words):
    options = {"--gain": gains, "--set": settings}
    pairs = [word for name, values in options.items() for p, v in values.items() for word in (name, f"{p}={v}")]
    return CliRunner().invoke(main, ["tune", NAME, *pairs, *map(str, words)])


def jump(x, first):
    """A cost that jumps by 1 at x0 = 0.5 and has slope 0.3 in x1; its derivative contains only the slope."""
    noise = np.random.default_rng(first).standard_normal(len(x) // 2).repeat(2)
    return (x[:, 0] > 0.5) + 0.3 * x[:, 1] + noise, np.tile([0.0, 0.3], (len(x), 1))


@pytest.mark.parametrize("x0", [0.42, 0.5, 0.55])
def test_smoothed_slope_includes_the_jump(x0):
    width, eps = 0.08, np.random.default_rng(5).standard_normal((20000, 2))
    cost, found = estimate_slope(jump, np.array([x0, 0.5]), eps, width, 7)
    known = stats.norm.pdf(0.5, x0, width)  # derivative of P(x0 + width eps > 0.5)
    assert found.slope[0] == pytest.approx(known, rel=0.05)
    assert found.weight[0] < 0.05
    assert found.first[0] == 0
    assert found.slope[1] == pytest.approx(0.3, abs=0.1)  # the jump is scatter here
    assert found.weight[1] > 0.1
    assert cost == pytest.approx(stats.norm.cdf(x0, 0.5, width) + 0.15, abs=0.03)


def test_gradient_estimates_are_weighted_by_scatter_and_bias():
    rng = np.random.default_rng(0)
    quiet, loud = 1 + 0.1 * rng.standard_normal((400, 1)), 1 + rng.standard_normal((400, 1))
    assert combine_estimates(quiet, loud).weight[0] > 0.9
    assert combine_estimates(loud, quiet).weight[0] < 0.1
    assert combine_estimates(quiet + 2, loud).weight[0] < 0.05
    assert combine_estimates(quiet + 2, loud).slope[0] == pytest.approx(1, abs=0.2)


def test_fold_is_continuous_and_stays_in_range():
    y = np.linspace(-1.4, 2.4, 4001)
    x, sign = fold_points(y)
    assert x.min() >= 0
    assert x.max() <= 1
    assert np.abs(np.diff(x)).max() < 2e-3
    inner = np.abs(x - 0.5) < 0.499
    assert np.allclose(np.gradient(x, y)[inner], sign[inner], atol=1e-6)


def test_descent_and_search_find_the_minimum_of_a_noisy_bowl():
    least = np.array([0.7, 0.2])

    def bowl(x, first):
        noise = np.random.default_rng(first).standard_normal((len(x) // 2, 2)).repeat(2, axis=0)
        return ((x - least) ** 2).sum(axis=1) + 0.1 * noise[:, 0], 2 * (x - least) + 0.2 * noise

    x, steps, _ = descend_gradient(bowl, np.array([0.1, 0.9]), 64, 80, 0.05, 3)
    assert x == pytest.approx(least, abs=0.05)
    assert steps[-1].cost < steps[0].cost
    words = 0.1 * np.random.default_rng(0).standard_normal(16)
    x, steps = search_gains(lambda x: ((x - least) ** 2).sum(axis=1)[:, None] + words, np.array([0.1, 0.9]), 16, 60, 3)
    assert x == pytest.approx(least, abs=0.02)
    assert steps[-1].flown_runs <= 16 * (60 * 8 + 2)


def test_candidates_with_infinite_costs_rank_last():
    """A candidate with fewer infinite costs is better, for any size of its finite costs."""
    finite = [[-1e3, 0, 0, 0], [1, 1, 1, 1], [2, 2, 2, 2], [9e6, 9e6, 9e6, 9e6]]
    costs = np.array([*finite, [-1, 1, 1, np.inf], [9, 9, 9, np.inf], [1, 1, np.inf, np.inf], [np.inf] * 4])
    assert np.all(np.diff(merit(costs, 1.5)) > 0)


def test_descent_rejects_a_start_of_infinite_cost():
    with pytest.raises(InputError, match="infinite cost"):
        descend_gradient(lambda x, first: (np.full(len(x), np.inf), x), np.array([0.5]), 8, 3, 0.05, 0)


def test_gains_at_their_bounds_are_reported():
    factors = [SimpleNamespace(text=name) for name in ("low", "inside", "high", "other")]
    gains = Gains(SimpleNamespace(spread=SimpleNamespace(factors=factors)), [0, 1, 2], (1.0, 1.0, 1.0), None)
    assert gains.at_bounds(np.array([0.00004, 0.02, 0.995])) == ("low", "high")


@pytest.mark.thorough
@needs_c
def test_cost_slopes_match_finite_differences():
    """Smooth ideal run: the derivative of the metric over integrals against central differences of logged runs."""
    ideal = replace(build(NAME).ideal(), duration=seconds(3))
    terms = parse_cost("error_rms:yaw_rate + 2*rms:truth.sway_velocity + 0.5*mean:truth.surge_velocity")
    plan = CampaignPlan(NAME, metrics=tuple(t.metric for t in terms), log_period=ms(1))
    ready = prepare_campaign(plan, ideal)
    of = integral_cost(terms, ready)
    along = [("autopilot.law.k1", ()), ("autopilot.law.k2", ())]
    k2 = np.array([2.0, 3.0])
    found = gradients(ideal, of.cost, along, seeds=[0, 0], runs=[0, 1], spread={along[1][0]: k2}, since=of.since)
    costs, slopes = of.finish(found.costs, found.slopes)

    def independent(k1, k2):
        wanted = ("truth.yaw_rate", "truth.sway_velocity", "truth.surge_velocity")
        one = {along[0][0]: np.array([k1]), along[1][0]: np.array([k2])}
        b = simulate_batch(ideal, seeds=[0], spread=one, log=True, log_period=ms(1), signals=wanted)
        r, v, u = (b.log[name][0] for name in wanted)
        half = to_seconds(b.ticks) >= 1.5
        return np.sqrt(np.mean(r[half] ** 2)) + 2 * np.sqrt(np.mean(v**2)) + 0.5 * np.mean(u)

    h = 1e-4
    for i, at in enumerate(k2):
        assert costs[i] == pytest.approx(independent(1.0, at), rel=1e-9)
        by_k1 = (independent(1 + h, at) - independent(1 - h, at)) / (2 * h)
        by_k2 = (independent(1.0, at + h) - independent(1.0, at - h)) / (2 * h)
        assert slopes[i] == pytest.approx([by_k1, by_k2], rel=1e-5, abs=1e-8)


@pytest.mark.thorough
@needs_c
def test_batched_gradients_equal_single_run_gradients():
    scenario = replace(build(NAME), duration=seconds(1))
    of = integral_cost(
        parse_cost("rms:truth.yaw_rate"),
        prepare_campaign(CampaignPlan(NAME, metrics=("rms:truth.yaw_rate",)), scenario),
    )
    many = gradients(scenario, of.cost, [("autopilot.law.k2", ())], seeds=[4, 5], runs=[0, 0], since=of.since)
    for i, seed in enumerate((4, 5)):
        one = gradient(scenario, of.cost, ("autopilot.law.k2",), seed=seed)
        assert many.costs[i, 0] == pytest.approx(one.cost, rel=1e-12)
        assert many.slopes[i, 0, 0] == pytest.approx(float(one.slope["autopilot.law.k2"]), rel=1e-9)


@pytest.mark.thorough
@needs_c
def test_noisy_cost_jumps_are_missed_by_its_derivative():
    """In one noisy run over k2 = 2.5 … 2.6, the cost has steps a hundred times larger than its derivative predicts."""
    grid, path = np.linspace(2.5, 2.6, 401), "autopilot.law.k2"
    scenario = build(NAME)
    half = scenario.duration // 2
    of = integral_cost(
        parse_cost("error_rms:yaw_rate"), prepare_campaign(CampaignPlan(NAME, metrics=("error_rms:yaw_rate",)))
    )
    words = np.ones(401, int)
    found = gradients(scenario, of.cost, [(path, ())], seeds=0 * words, runs=words, spread={path: grid}, since=(half,))
    costs, slopes = of.finish(found.costs, found.slopes)
    step, told = np.diff(costs), slopes[1:, 0] * np.diff(grid)
    i = np.argmax(np.abs(step - told))
    assert abs(step[i]) > 100 * abs(told[i])
    usual = np.median(np.abs(step))
    assert np.median(np.abs(step - told)) < 0.1 * usual  # between the jumps the derivative is right
    assert (np.abs(step - told) > 10 * usual).sum() >= 3


@pytest.mark.thorough
@needs_c
@pytest.mark.parametrize("method", ["search", "gradient"])
def test_tuning_improves_held_out_runs(method, tmp_path):
    """From a poor start; held-out costs recomputed from logged rows of the file's scenario and of the old one."""
    poor = SHORT | {"autopilot.law.k2": "0.8"}
    words = (
        "--cost",
        "error_rms:yaw_rate",
        "--method",
        method,
        "--runs",
        32,
        "--judge-runs",
        64,
        "--iterations",
        12,
        "--json",
    )
    done = call(GAINS, poor, *words, "--out", tmp_path / "tuned.py", "--plot", tmp_path / "tune.png")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    words = np.arange(UNSEEN, UNSEEN + 64, dtype=np.uint32)
    costs = []
    for scenario in (build(NAME, poor), build(f"{tmp_path / 'tuned.py'}:scenario")):
        b = simulate_batch(scenario, seeds=[0] * 64, runs=words, log=True, signals=("truth.yaw_rate",))
        late = b.ticks >= (b.ticks[-1] + b.ticks[0]) / 2
        costs.append(np.sqrt(np.mean(b.log["truth.yaw_rate"][:, late] ** 2, axis=1)))
    low, high = stats.ttest_rel(costs[1], costs[0]).confidence_interval(0.95)
    held = found["held_out"]
    assert (held["before"], held["after"]) == pytest.approx([c.mean() for c in costs], rel=1e-6)
    assert (held["low"], held["high"]) == pytest.approx((low, high), rel=1e-4)
    assert high < 0
    values = {p: float(v) for p, v, _ in leaves(build(f"{tmp_path / 'tuned.py'}:scenario")) if p in GAINS}
    assert values == found["after"]
    assert 0.5 <= values["autopilot.law.k1"] <= 3
    assert (tmp_path / "tune.png").stat().st_size > 5000


@pytest.mark.thorough
def test_tuning_without_significant_improvement_is_reported(tmp_path):
    """Good initial gains are tuned on four runs: the result is better in these runs and worse in others."""
    good = {"autopilot.law.k1": "0.5", "autopilot.law.k2": "2"}
    ranges = {"autopilot.law.k1": "0.5:3", "autopilot.law.k2": "0.5:5"}
    words = ("--cost", "error_rms:yaw_rate", "--runs", 4, "--judge-runs", 64, "--iterations", 6, "--seed", 3)
    done = call(ranges, good, *words, "--out", tmp_path / "tuned.py")
    assert done.exit_code == 1, done.output
    assert "no significant improvement in the validation runs" in done.stdout
    assert f"not written: {tmp_path / 'tuned.py'}" in done.stdout
    assert not (tmp_path / "tuned.py").exists()
    done = call(ranges, good, *words, "--json")
    assert done.exit_code == 1, done.output
    found = json.loads(done.stdout)
    assert found["seen"]["difference"] < 0
    assert found["held_out"]["high"] > 0


def test_lost_run_has_infinite_cost():
    columns = {"peak:a": np.array([1.0, 2.0, np.nan]), "lost": np.array([False, True, False])}
    assert evaluate_cost(parse_cost("2*peak:a"), columns).tolist() == [2.0, np.inf, np.inf]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gains": {}}, "no gain given"),
        ({"gains": {"autopilot.law.k1": "2:3"}}, "own value"),
        ({"gains": {"autopilot.law.k1": "-1:3"}}, "can't be flown at an end of its range"),
        ({"gains": {"autopilot.law.k9": "1:3"}}, r"(?s)unknown parameter.*gains={.autopilot\.law\.k\d.: .LOW:HIGH.}"),
        ({"gains": {"duration": "1:3"}}, "gains duration"),
        ({"gains": {"autopilot.law.k1": "normal(1, 2)"}}, "not a valid range"),
        ({"cost": "error_rms:yaw_rate + -2*rms:yaw_rate"}, "weight"),
        ({"cost": "settling:yaw_rate", "method": "gradient"}, "method=.search"),
        ({"method": "newton"}, "search, gradient"),
        ({"held_out": 2}, "held_out: must be at least 16, got 2"),
        ({"width": 0.0}, "width"),
    ],
)
def test_rejects_invalid_arguments_before_flying(change, said):
    with pytest.raises(InputError, match=said):
        tune(NAME, **{"gains": GAINS, "cost": "error_rms:yaw_rate", "settings": SHORT} | change)


def test_gain_range_is_given_in_numbers_or_percent():
    assert parse_gain("a", "50%:200%").is_relative
    assert parse_gain("a", "loguniform(0.1, 10)").kind == "loguniform"
    with pytest.raises(InputError, match="settings need a scenario given by name"):
        tune(build(NAME), gains=GAINS, cost="rms:yaw_rate", settings=SHORT)


@pytest.mark.parametrize(("span", "start"), [("80%:120%", 0.5), ("-4:-0.1", None), ("loguniform(50%, 200%)", 0.5)])
def test_negative_gain_moves_within_its_range(span, start):
    """The range is that of the scaled value; position in the range and slope follow the direction of the gain."""
    path = "world.vehicle.rotors.places[2,0]"
    found = tune_gains({path: span})
    assert start is None or found.start == pytest.approx([start])
    assert found.gain_values(found.start)[path] == pytest.approx(-0.315)
    low, high = (found.gain_values(np.array([end]))[path] for end in (0.0, 1.0))
    assert min(low, high) < -0.315 < max(low, high) < 0
    step = np.array([[1e-6]])
    before, after = (found.gain_values(found.start + s)[path] for s in (-step[0], step[0]))
    assert found.slope(found.start[None]) == pytest.approx((after - before) / 2e-6)


def test_rejects_negative_gain_outside_its_range():
    with pytest.raises(InputError, match=r"-0.315, must lie within -0.63 … -0.3465.*\n.*settings.*places\[2,0\]"):
        tune_gains({"world.vehicle.rotors.places[2,0]": "110%:200%"})


def tune_gains(gains):
    plan = CampaignPlan(
        "quadrotor/track", runs=4, seed=0, spread=tuple((p, parse_gain(p, t)) for p, t in gains.items())
    )
    scenario = build(plan.scenario)
    spread = resolve_spread(scenario, parse_factors(plan.spread))
    return campaign_gains(PreparedCampaign(plan, scenario, spread, (), (), (), 0), tuple(gains))


def test_gain_that_is_an_array_is_rejected_with_one_of_its_elements():
    with pytest.raises(InputError, match=r"has shape \(4, 3\), but uniform\(1, 2\) gives one number") as refused:
        tune("quadrotor/track", gains={"world.vehicle.rotors.places": "1:2"}, cost="rms:truth.position[0]")
    assert refused.value.fix == 'gains={"world.vehicle.rotors.places[0,0]": "LOW:HIGH"}'


def test_rejects_output_that_is_not_a_python_file():
    done = call(GAINS, SHORT, "--out", "tuned")
    assert done.exit_code == 2
    assert "Python file" in done.stderr

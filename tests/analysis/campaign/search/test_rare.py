"""Rare failures of flights: known probabilities, stored rounds, failures that replay bit for bit."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import special, stats

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.analysis.campaign.sampling.distributions import parse_distribution
from trimtab.analysis.campaign.search.falsify import margins, with_margin
from trimtab.analysis.campaign.search.rare import SPREAD_MAX, estimate_rare
from trimtab.analysis.campaign.workers.block import compute_log_metrics, fly_points
from trimtab.analysis.campaign.workers.prepare import plan_campaign, prepare_campaign
from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios.catalogue import load_scenario

HERE = Path(__file__).parents[1]
sys.path.insert(0, str(HERE))
import still  # noqa: E402

STILL = str(HERE / "still.py")
RUNS = 8000


def rate_below(p):
    """The condition that a run at rest violates with probability p."""
    return (f"{STILL}:mean_rate <= {float(-special.ndtri(p) * still.SIGMA)!r}",)


def at_rest(p, **more):
    return estimate_rare(f"{STILL}:scenario", spread=still.SPREAD, success=rate_below(p), **more)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Return a folder with the rounds of a failure of probability 1e-4, and the result."""
    folder = tmp_path_factory.mktemp("rare")
    return folder, at_rest(1e-4, runs=RUNS, folder=folder)


@pytest.mark.thorough
def test_run_at_rest_has_expected_sample_count_and_noise():
    signal = "sensors.imu.value.angular_rate"
    batch = simulate_batch(still.scenario(), seeds=range(2000), log=True, signals=(signal,))
    rate = batch.log[signal][:, :, 2]
    assert rate.shape[1] == still.SAMPLES
    assert rate.std() == pytest.approx(still.NOISE / np.sqrt(still.PERIOD), rel=0.02)
    assert rate.mean(axis=1).std() == pytest.approx(np.sqrt(still.SIGMA**2 - still.BIAS**2), rel=0.06)


@pytest.mark.thorough
def test_estimates_gaussian_of_parameter_and_noise(kept):
    _, found = kept
    assert found.has_noise
    assert found.probability.low < 1e-4 < found.probability.high
    assert found.flown_runs == pytest.approx(RUNS, rel=0.4)
    assert found.new_runs == found.flown_runs  # of a session that nothing went before
    assert found.ladder.estimate == pytest.approx(1e-4, rel=3)


@pytest.mark.thorough
def test_resumed_session_equals_uninterrupted_session(kept, tmp_path):
    folder, found = kept
    state = json.loads((folder / "rare.json").read_text())
    assert len({tuple(kept["sums"]) for kept in state["rounds"]}) == 4
    short = tmp_path / "short"
    short.mkdir()
    (short / "rare.json").write_text(json.dumps(state | {"rounds": state["rounds"][:2]}))
    again = at_rest(1e-4, runs=RUNS, folder=short)
    assert (again.probability, again.flown_runs) == (found.probability, found.flown_runs)
    assert json.loads((short / "rare.json").read_text()) == state
    assert again.worst.words == found.worst.words
    read = at_rest(1e-4, runs=RUNS, folder=folder)
    assert read.new_runs == 0
    assert read.probability == found.probability
    more = at_rest(1e-4, runs=2 * RUNS, folder=short)
    assert more.roots > found.roots
    assert more.probability.trials > found.probability.trials


@pytest.mark.thorough
def test_rejects_folder_of_another_study(kept, tmp_path):
    folder, _ = kept
    with pytest.raises(InputError, match="another study"):
        at_rest(1e-5, runs=RUNS, folder=folder)
    (tmp_path / "rare.json").write_text("{")
    with pytest.raises(InputError, match="can't be read"):
        at_rest(1e-4, runs=RUNS, folder=tmp_path)


@pytest.mark.thorough
def test_failures_replay_bit_for_bit(kept):
    _, found = kept
    for failure in (found.worst, found.likeliest):
        assert failure.margin < 0
        assert float(margins({n: np.array([v]) for n, v in failure.columns.items()})[0]) == failure.margin
    assert found.worst.margin <= found.likeliest.margin
    assert abs(found.likeliest.z[0]) <= abs(found.worst.z[0])


def test_rare_command_writes_failures_that_replay(tmp_path):
    words = ["rare", f"{STILL}:scenario", "--runs", str(RUNS), "--out", str(tmp_path), "--json", "--seed", "2"]
    words += [w for path, text in still.SPREAD.items() for w in ("--spread", f"{path}={text}")]
    done = CliRunner().invoke(main, [*words, "--success", *rate_below(1e-3)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "a plain campaign would take" in done.stderr
    said = json.loads(done.stdout)
    assert said["low"] < 1e-3 < said["high"]
    scenario, _ = load_scenario(f"{tmp_path / 'worst.py'}:scenario", {})
    plan = plan_campaign("test", scenario, None, (), (), 2, runs=1, success=rate_below(1e-3))
    ready = with_margin(prepare_campaign(plan, scenario))
    log = simulate(scenario, seed=2, log_period=plan.log_period, signals=ready.logged_signals)
    assert float(margins(compute_log_metrics(ready, log))[0]) == said["worst"]["margin"] < 0
    other = simulate(scenario, seed=2, run=1, log_period=plan.log_period, signals=ready.logged_signals)
    assert float(margins(compute_log_metrics(ready, other))[0]) > said["worst"]["margin"]
    assert log.metadata["words"] == said["worst"]["words"]


@pytest.mark.thorough
def test_rejects_studies_without_an_estimate():
    for change, message in (
        ({"runs": 100}, "too few"),
        ({"spread": {"world.vehicle.mass": "normal(100%, 20%)"}}, "at an end of its range"),
        ({"spread": {"autopilot.period": "choice(1 ms, 2 ms)"}}, "changes the program"),
    ):
        with pytest.raises(InputError, match=message):
            estimate_rare("hovercraft/spin", **{"spread": still.SPREAD, "runs": RUNS, **change})
    quiet = {"without": ["navigation-error"], "settings": {"duration": "1 s"}, "success": ["peak:yaw_rate <= 9"]}
    with pytest.raises(InputError, match="nothing varies"):
        estimate_rare("hovercraft/zero-velocity", runs=RUNS, **quiet)


MILLIONTH = 1e-6


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_estimates_one_in_a_million_of_parameter_and_noise(capsys):
    """A Gaussian bias and the white noise of an IMU, against the normal distribution."""
    found = at_rest(MILLIONTH, runs=200_000, seed=5).probability
    with capsys.disabled():
        print(f"\nat rest: {found} of {MILLIONTH:g}")
    assert found.low < MILLIONTH < found.high
    assert (found.high - found.low) / 2 < 0.25 * found.value


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_flight_interval_coverage_at_one_in_a_million(capsys):
    """Of 100 intervals at 95 %, each from 20 000 flights, about 95 contain the true value."""
    found = [at_rest(MILLIONTH, runs=20_000, seed=seed).probability for seed in range(100)]
    held = sum(f.low <= MILLIONTH <= f.high for f in found)
    values = np.array([f.value for f in found]) / MILLIONTH
    with capsys.disabled():
        print(f"\nat rest: {held} of 100 hold it; mean {values.mean():.3f}, scatter {values.std():.3f}")
    assert held >= 90
    assert abs(values.mean() - 1) < 4 * values.std() / 10


SPIN = {"initial.yaw_rate": "normal(100%, 5%)", "world.vehicle.inertia": "normal(100%, 5%)"}
BRAKING = {
    "success": ("error_rms:yaw_rate <= 5.85",),
    "settings": {"duration": "3 s"},
    "without": ["navigation-error"],
}


def quadrature(n=161, halvings=26):
    """P(failure) of two parameters without noise: bisection along the first, then a sum over the second."""
    plan = plan_campaign(
        "test",
        "hovercraft/zero-velocity",
        BRAKING["settings"],
        BRAKING["without"],
        (),
        0,
        runs=1,
        spread=tuple((path, parse_distribution(text)) for path, text in SPIN.items()),
        success=BRAKING["success"],
    )
    ready = with_margin(prepare_campaign(plan))

    def fails(rate, inertia):
        u = special.ndtr(np.stack([rate, inertia], axis=1))
        return margins(fly_points(ready, u, np.zeros(n, np.uint32))) < 0

    inertia = np.linspace(-SPREAD_MAX, SPREAD_MAX, n)
    low, high = np.full(n, -1.0), np.full(n, 8.0)
    assert not fails(low, inertia).any()
    assert fails(high, inertia).all()
    for _ in range(halvings):
        middle = (low + high) / 2
        failed = fails(middle, inertia)
        low, high = np.where(failed, low, middle), np.where(failed, middle, high)
    weights = stats.norm.pdf(inertia) * (inertia[1] - inertia[0])
    return float(weights @ special.ndtr(-high))


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_hovercraft_rare_failure_matches_quadrature(capsys):
    """The probability for a braking hovercraft, compared with a quadrature."""
    truth = quadrature()
    found = estimate_rare("hovercraft/zero-velocity", spread=SPIN, **BRAKING, runs=100_000, seed=1)
    p = found.probability
    with capsys.disabled():
        print(f"\nhovercraft brakes: {p} of {truth:.4g}, {found.wall_s:.1f} s")
    assert not found.has_noise
    assert 2e-7 < truth < 5e-6
    assert p.low < truth < p.high
    assert (p.high - p.low) / 2 < 0.25 * p.value


@pytest.mark.thorough
@pytest.mark.timeout(1800)
def test_hovercraft_noise_failures_match_a_plain_campaign(capsys):
    """Only navigation errors make the hovercraft spin too fast; splitting and plain runs draw them alike."""
    limit, settings = ("peak:yaw_rate <= 3.4",), {"duration": "3 s"}
    plain = Campaign("hovercraft/spin", runs=150_000, seed=4, success=limit, settings=settings).run().success
    found = estimate_rare("hovercraft/spin", success=limit, settings=settings, runs=30_000, seed=3).probability
    with capsys.disabled():
        print(f"\nspin: {found}; plain {1 - plain.share:.3g} ({1 - plain.high:.3g} to {1 - plain.low:.3g})")
    assert 100 < plain.trials - plain.successes < 1000
    assert found.low < 1 - plain.low
    assert found.high > 1 - plain.high
    assert (found.high - found.low) / 2 < 0.5 * found.value

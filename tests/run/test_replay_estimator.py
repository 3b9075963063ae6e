"""An estimator alone on a log's samples: exact for recorded flights, and logs of other programs."""

import jax
import numpy as np
import pytest
from estimators.odometry_drives import BEACONS, drive, frames_of

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.rng import key
from trimtab.core.time import ms
from trimtab.estimators.ranging.odometry import OdometryRanging, PlanarStart, RadioErrors
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.samples import SampleSeries, log_samples
from trimtab.run.replay_estimator import replay_estimator
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

START = PlanarStart(heading=0.3, north=1.0, east=-2.0)
FILTER = OdometryRanging(beacons=BEACONS, errors=RadioErrors(noise=0.2, scale=0.05, sigma_scale=0.02), start=START)
BACKENDS = ["jax", pytest.param("c", marks=pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler"))]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A drive as another program logs it, read from its file."""
    world, frames = drive(2), frames_of(drive(2))
    odometry, ranging = frames.samples["odometry"], frames.samples["ranging"]
    rows = np.flatnonzero(ranging.fresh)
    sensors = {
        "odometry": SampleSeries(odometry.t, {"distance": world.distance, "turn": world.turn}),
        "ranging": SampleSeries(ranging.t[rows], {"range": world.range[rows], "arrived": world.arrived[rows]}),
    }
    truth = SampleSeries(odometry.t, {"north": world.north, "east": world.east, "heading": world.heading})
    written = log_samples(sensors, truth, {"name": "drive"})
    return read_mcap(write_mcap(written, tmp_path_factory.mktemp("drive") / "drive.mcap"))


@pytest.mark.thorough
@pytest.mark.parametrize("backend", BACKENDS)
def test_external_log_gives_the_same_estimate_as_its_frames(log, backend):
    """Row by row: in the frames, ranges come with the odometry; in this log each sample has its own row."""
    replayed = replay_estimator(log, FILTER, backend=backend)
    frames = frames_of(drive(2))
    state, estimates = jax.jit(
        lambda f: jax.lax.scan(lambda s, now: FILTER.step(now.t, s, now), FILTER.init(key(0)), f)
    )(frames)
    np.testing.assert_allclose(replayed["estimate.state.north"][-1], state.x[1], atol=1e-9)
    rows = np.flatnonzero(np.isin(replayed.ticks, np.asarray(frames.t)))
    np.testing.assert_allclose(replayed["estimate.state.east"][rows], estimates.state.east, atol=1e-9)
    assert replayed.unit("estimate.state.sigma_north") == "m"
    assert "truth.north" in replayed
    assert replayed.metadata["backend"] == backend


@pytest.mark.thorough
def test_estimator_replay_of_a_flight_is_bit_exact():
    scenario, _ = catalogue.load_scenario("hovercraft/zero-velocity", {"navigation": "ins"})
    flown = simulate(scenario, seed=3, duration=ms(500), log_period=scenario.autopilot.period, backend="jax")
    again = replay_estimator(flown, scenario.autopilot.estimator, seed=3, backend="jax")
    for path in [p for p in flown.paths if p.startswith("estimate.state")]:
        np.testing.assert_array_equal(again[path], flown[path])


def test_rejects_a_log_without_the_required_samples(log):
    other = OdometryRanging(beacons=BEACONS, ranging="radar")
    with pytest.raises(InputError, match=r"no samples of 'radar'.*\n?.*odometry"):
        replay_estimator(log, other)


def test_rejects_an_invalid_estimator(log):
    with pytest.raises(InputError, match="beacons"):
        replay_estimator(log, OdometryRanging(beacons=np.zeros((4, 2))))

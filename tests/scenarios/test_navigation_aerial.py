"""The aerial figure of eight: navigation accuracy, and the effect of the outage on each kind of aiding."""

import jax
import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core import quaternion
from trimtab.core.imperfections import imperfections
from trimtab.core.rotation import DEG
from trimtab.core.time import ms
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")


@pytest.fixture(scope="module")
def logs():
    """One flight with each kind of aiding."""
    both = {g: catalogue.load_scenario("navigation/aerial", {"gnss": g})[0] for g in ("fixes", "ranges")}
    return {g: simulate(scenario, seed=2, log_period=ms(20)) for g, scenario in both.items()}


def errors(log):
    """Time (s), errors and sigmas of position (m), velocity (m/s) and attitude (rad)."""
    told = {n: log[f"estimate.state.{n}"] for n in ("position", "velocity", "attitude")}
    turn = jax.vmap(quaternion.local)(log["truth.attitude"], told["attitude"])
    error = told["position"] - log["truth.position"], told["velocity"] - log["truth.velocity"], np.asarray(turn)
    sigma = [log[f"estimate.state.sigma_{n}"] for n in told]
    return np.arange(len(log)) * 0.02, error, sigma


@pytest.mark.thorough
@pytest.mark.parametrize("gnss", ["fixes", "ranges"])
def test_navigation_errors_are_small_and_within_five_sigma(logs, gnss):
    """Bounds on position, velocity and attitude from 3 s on, except in the outage; always within five sigma."""
    t, error, sigma = errors(logs[gnss])
    seen = (t > 3) & ((t < 9) | (t > 13.5))
    for e, s, most in zip(error, sigma, (1.2, 0.3, 4 * DEG), strict=True):
        assert np.abs(e[seen]).max() < most
        assert (np.abs(e[t > 1]) < 5 * s[t > 1]).all()
    late = t > 16
    print(gnss, "rms from 16 s on:", *(np.sqrt((e[late] ** 2).mean()) for e in error))
    assert np.sqrt((error[2][late] ** 2).mean()) < 0.5 * DEG


@pytest.mark.thorough
def test_satellite_ranges_limit_drift_during_the_fix_outage(logs):
    for gnss, log in logs.items():
        used = log["estimate.state.gnss_fix.used"]
        t = np.arange(len(log)) * 0.02
        during = used[np.searchsorted(t, 13.0)] - used[np.searchsorted(t, 9.2)]
        assert during == (0 if gnss == "fixes" else 19)
    grown = {g: np.linalg.norm(log["estimate.state.sigma_velocity"][int(12.9 / 0.02)]) for g, log in logs.items()}
    print("sigma of velocity after the outage:", grown)
    assert grown["ranges"] < 0.6 * grown["fixes"]


@pytest.mark.thorough
@pytest.mark.parametrize("gnss", ["fixes", "ranges"])
def test_gnss_fixes_are_used_and_navigation_stays_healthy(logs, gnss):
    log = logs[gnss]
    assert log["estimate.state.gnss_fix.late"][-1] == 0
    assert log["estimate.state.gnss_fix.rejected"][-1] <= 1
    assert log["estimate.state.gnss_fix.used"][-1] >= 78
    assert log["estimate.state.healthy"].all()
    assert log["estimate.valid"][10:].all()
    np.testing.assert_allclose(log["estimate.state.horizon"][10:], 0.15, atol=1e-9)


@pytest.mark.thorough
def test_start_error_exists_and_imperfections_can_be_disabled(logs):
    _, error, sigma = errors(logs["fixes"])
    assert (np.abs(error[0][0]) > 0.4 * sigma[0][0]).all()
    scenario, _ = catalogue.load_scenario("navigation/aerial")
    names = set(imperfections(scenario))
    assert {"gnss-noise", "gnss-latency", "gnss-outages", "gnss-correlated-error", "imu-noise"} <= names
    assert scenario.without("gnss-outages").world.sensors["gnss"].outages.length == 0
    assert scenario.without("gnss-correlated-error").autopilot.estimator.receiver.constant == 0

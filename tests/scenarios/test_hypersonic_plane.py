"""The choice `truth=plane`: its imperfections, off by default, and each can be disabled."""

import numpy as np
import pytest

from trimtab import build
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.time import seconds
from trimtab.environment.turbulence import Turbulence
from trimtab.run.simulate import simulate
from trimtab.scenarios.hypersonic.modal_mismatch import scenario

NAMES = ("turbulence", "actuator-lag", "rate-limit")
PARTS = ("noise", "offset", "scale-factor", "bandwidth", "delay", "place")


@pytest.mark.thorough
def test_default_truth_has_no_plane_imperfections():
    world = build("hypersonic/noise").world
    assert world.turbulence is None
    assert not set(NAMES) & set(build("hypersonic/noise").imperfections())


@pytest.mark.thorough
def test_plane_truth_imperfections_can_each_be_disabled():
    plane = build("hypersonic/noise", {"truth": "plane"})
    assert isinstance(plane.world.turbulence, Turbulence)
    assert {*NAMES, *(f"angular-accelerometer-{n}" for n in PARTS)} <= set(plane.imperfections())
    plane.check()


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_plane_flight_has_servo_lag_and_turbulence():
    """The elevator lags like a servo of 100 rad/s, by 2 z/w, and the turbulence is as specified."""
    log = simulate(scenario(truth="plane"), duration=seconds(20))
    asked, done = log["law.demand.delta_e"], log["actuators.u.delta_e"]
    lag = np.array([np.std(done[k:] - asked[: len(asked) - k]) for k in range(60)])
    assert 8 <= np.argmin(lag) <= 20  # ms
    gust = log["gust.velocity"] / 0.3048
    assert 3 < gust.std() < 8
    assert np.abs(log["law.h_error"]).max() < 10

"""The F-16 that avoids the ground: lowest altitude, failing starts, and the effect of actuator lag.

Bands are regression bands over eight seeds; the altitudes of the published flights are in the study stevens_lewis.
"""

import numpy as np
import pytest

from trimtab import build
from trimtab.analysis.campaign.campaign import Campaign
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.rotation import DEG
from trimtab.core.signals import new_sample
from trimtab.core.time import ms
from trimtab.run.simulate import simulate_many
from trimtab.scenarios.f16._gains import design_load_factor_control
from trimtab.scenarios.f16.gcas import surfaces
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.imperial import FOOT

LOWEST = {"dive": (360, 410), "inverted": (800, 960)}
"""ft: of eight flights with errors, the lowest and the highest least altitude lie in here."""


@pytest.mark.thorough
@pytest.mark.parametrize("start", LOWEST)
def test_aircraft_stays_above_the_ground(start):
    logs = simulate_many(build("f16/gcas", {"start": start}), seeds=range(8), log_period=ms(20))
    least = np.array([np.min(log["truth.altitude"]) for log in logs]) / FOOT
    low, high = LOWEST[start]
    print(f"{start}: least altitude {least.min():.0f} to {least.max():.0f} ft")
    assert low < least.min() < least.max() < high
    for log in logs:
        assert np.max(log["truth.alpha"]) < 25 * DEG
        assert abs(log["truth.roll"][-1]) < 10 * DEG
        assert log["truth.altitude"][-1] > np.min(log["truth.altitude"]), "it climbs at the end"


@pytest.mark.thorough
def test_aircraft_stays_above_the_ground_on_gnss_inertial_navigation():
    """Fixes are 120 ms late, with an outage from 2 s to 4.5 s; waiting for the first fix costs altitude."""
    scenario = build("f16/gcas", {"navigation": "gnss-inertial"})
    logs = simulate_many(scenario, seeds=range(40), log_period=ms(20))
    least = np.array([np.min(log["truth.altitude"]) for log in logs]) / FOOT
    print(f"least altitude {least.min():.0f} to {least.max():.0f} ft")
    assert 330 < least.min() < least.max() < 370
    seconds = np.arange(len(logs[0])) * 0.02
    steady = seconds > 0.5
    squares = []
    for log in logs:
        used = log["estimate.state.inertial.gnss_fix.used"]
        hidden = (seconds > 2.4) & (seconds < 4.5)
        assert np.ptp(used[hidden]) == 0
        assert used[-1] > used[hidden][0]
        assert log["estimate.state.inertial.gnss_fix.rejected"][-1] <= 1
        assert abs(log["truth.roll"][-1]) < 10 * DEG
        error = log["estimate.state.altitude"] - log["truth.altitude"]
        squares.append((error / log["estimate.state.inertial.sigma_position"][:, 2])[steady] ** 2)
    print("mean square of the altitude's error in sigmas:", np.mean(squares))
    assert 0.7 < np.mean(squares) < 1.4


@pytest.mark.thorough
def test_actuator_lag_destabilises_the_published_roll_loop():
    """Linear poles of roll angle, roll loop and surfaces: unstable with the published gains, stable with ours."""
    lag = 20.2

    def rightmost(weights, bank, damping):
        design = design_load_factor_control(weights)
        aside = design.linear.part(["beta", "roll_rate", "yaw_rate"], ["aileron", "rudder"], ["side_load"])
        A = np.zeros((8, 8))  # beta, p, r, two integrals, two surfaces, bank about the path
        A[:3, :3], A[:3, 5:7] = aside.A, aside.B
        about_path = np.array([0.0, 1.0, design.level.x[1]])
        A[3, :3] = about_path + damping * np.array([0.0, 1.0, 0.0])
        A[3, 7] = bank
        A[4, :3], A[4, 5:7] = aside.C[0] + np.array([0.0, 0.0, 1.0]), aside.D[0]
        A[5:7, :5], A[5:7, 5:7] = lag * design.aside.K, -lag * np.eye(2)
        A[7, :3] = about_path
        return np.max(np.linalg.eigvals(A).real)

    assert rightmost("published", 4.0, 2.0) > 1
    assert rightmost("actuators", 2.0, 0.0) < -0.5


@pytest.mark.thorough
def test_published_gains_miss_the_ground_only_without_lag():
    """The dive with AeroBenchVV's gains: with lag the aircraft stalls, without lag and rate limit it climbs away."""
    lagged = build("f16/gcas", {"gains": "published"})
    quick = lagged.without("actuator-lag").without("rate-limit")
    stalls, climbs = (simulate_many(s, seeds=[0], log_period=ms(20))[0] for s in (lagged, quick))
    assert np.max(stalls["truth.alpha"]) > 45 * DEG
    assert np.max(climbs["truth.alpha"]) < 25 * DEG
    assert np.min(climbs["truth.altitude"]) > 100


@pytest.mark.thorough
def test_only_steep_dives_from_the_deck_hit_the_ground():
    """Campaign: all shallow dives miss the ground, and all steep dives hit it."""
    for spread, success in (("uniform(-0.5, -0.1)", 1.0), ("uniform(-1.2, -1.0)", 0.0)):
        result = Campaign(
            "f16/gcas",
            runs=64,
            seed=1,
            spread={"initial.pitch": spread},
            metrics=["least:truth.altitude"],
            success=["least:truth.altitude > 0"],
        ).run()
        assert result.columns["success"].mean() == success


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "most", "rate"), [("elevator", 25, 60), ("aileron", 21.5, 80), ("rudder", 30, 120)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_surface_stops_and_rates_match_the_published_values(name, most, rate, side):
    trim = F16Controls(-0.01, 0.0, 0.0, 0.14)
    bank, state, angles, limited = surfaces(trim), surfaces(trim).init(key(0)), [], []
    for k in range(200):
        state, out = bank.step(k * bank.period, state, new_sample(k * bank.period, replace(trim, **{name: side * 2.0})))
        angles.append(float(getattr(out.u, name)) / DEG)
        limited.append(bool(out.limited))
    assert np.max(np.abs(np.diff(angles))) / 0.005 == pytest.approx(rate, rel=1e-9)
    assert angles[-1] == pytest.approx(side * most, abs=1e-3)
    assert np.max(np.abs(angles)) <= most + 1e-9
    assert all(limited), "its command lies beyond a stop"


def test_surfaces_have_the_published_lag_and_throttle_has_none():
    trim = F16Controls(-0.01, 0.0, 0.0, 0.14)
    bank, state = surfaces(trim), surfaces(trim).init(key(0))
    for k in range(1, 41):
        state, out = bank.step(0, state, new_sample(0, F16Controls(0.0, 0.02, -0.03, 1.7)))
        share = 1 - np.exp(-20.2 * 0.005 * k)
        np.testing.assert_allclose(
            [out.u.elevator, out.u.aileron, out.u.rudder, out.u.throttle],
            [-0.01 * (1 - share), 0.02 * share, -0.03 * share, 1.0],
            atol=1e-13,
        )

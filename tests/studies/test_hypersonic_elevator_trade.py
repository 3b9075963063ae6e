"""The trade of elevator activity: the loop as a matrix against independent numbers and flights; the rows hold.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import numpy as np
import pytest

from studies.hypersonic2022 import _linear_loop as loop
from studies.hypersonic2022 import _trade as trade
from studies.hypersonic2022 import elevator_trade
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.estimators.flexible.discrete import EQUAL_Q, PRINTED_Q
from trimtab.laws.stable_inversion import K_FLOWN
from trimtab.scenarios.hypersonic import _loop as whole
from trimtab.scenarios.hypersonic._internal import level_trim
from trimtab.vehicles.hypersonic import Hypersonic


@pytest.mark.thorough
def test_level_flight_is_an_equilibrium_with_detuned_modes():
    assumed = Hypersonic()
    at = level_trim(assumed, loop.H, loop.V)
    plant = replace(assumed, modes=assumed.modes.detune(0.9))
    kept = loop.FlexibleModeFilter(craft=assumed, period=loop.TICK)
    z = whole.rest_state(plant, assumed, at)
    moved = whole.step_period(plant, kept, np.asarray(K_FLOWN), np.eye(4), at, z, 0.0)
    assert np.abs(np.asarray(moved) - z).max() < 1e-11


@pytest.mark.thorough
def test_loop_poles_match_gain_and_filter_poles_of_oracle(monkeypatch):
    """With a 1 ms step and an exact model, the poles are close to the oracle's continuous-time poles."""
    monkeypatch.setattr(loop, "TICK", ms(1))
    F, _ = loop.loop_matrices(EQUAL_Q, 5e-4, K_FLOWN)
    found = np.linalg.eigvals(F)
    motions = np.log(found[np.abs(found) > 0.3]) / 1e-3
    for pole in (-3.9716, -2.8106, -0.4996, -0.4262, -0.2266, -0.5200 + 18.509j, -0.3361 + 16.031j):
        assert np.abs(motions - pole).min() < 0.01 * abs(pole)


@pytest.mark.thorough
def test_growth_rate_matches_slowest_pole_of_oracle():
    """The oracle's slowest pole."""
    assert loop.growth_rate(EQUAL_Q, 1e-4) == pytest.approx(-0.2266, abs=1e-4)


@pytest.mark.thorough
def test_loop_is_unstable_without_feedback_of_flexible_modes():
    """The oracle's `gain/blind`: the columns of the modes set to zero, the fastest growth is +2.05 1/s."""
    K = np.array(K_FLOWN)
    K[:, 5:] = 0.0
    assert loop.growth_rate(EQUAL_Q, 1e-4, K) == pytest.approx(2.05, abs=0.05)


@pytest.mark.thorough
def test_steady_state_noise_matches_stepped_loop():
    F, N = loop.loop_matrices(EQUAL_Q, 1e-4, K_FLOWN)
    g = np.random.default_rng(0)
    z, total, count = np.zeros((20, 400)), 0.0, 0
    for k in range(8000):
        z = F @ z + np.outer(N, 0.01 * g.standard_normal(400))
        if k >= 4000 and k % 20 == 0:
            total, count = total + np.mean(z[19] ** 2), count + 1
    assert np.sqrt(total / count) == pytest.approx(loop.loop_quality().elevator, rel=0.02)


@pytest.mark.thorough
def test_stability_verdicts_for_ten_percent_detuned_modes():
    """The shipped filter holds errors of 10 %, one with Qacc = 1 is marginal at 0.90, the printed one fails."""
    assert loop.loop_quality().worst < -0.1
    assert loop.growth_rate((1e-5, 1.0, 1e-5, 1.0), 1e-4, detuned=(0.9, 0.9)) > 0
    assert loop.growth_rate(PRINTED_Q, 10.0, detuned=(1.1, 1.1)) > 0.1
    assert 0.14 < loop.widest_error(EQUAL_Q, 1e-4) < 0.15


@pytest.mark.thorough
def test_shipped_filter_survives_and_printed_fails_with_detuned_modes():
    shipped, printed = trade.fly_detuned((trade.EQUAL, trade.PRINTED), seeds=2)
    assert not shipped.lost.any()
    assert shipped.h.max() < 0.027
    assert printed.lost.all()


@pytest.mark.thorough
def test_growth_rate_matches_a_simulated_flight():
    """Qacc = 1 on both modes, both frequencies 0.90: the oscillation of eta1's error, logarithm of its size by time."""
    setting = trade.EQUAL_SETTINGS[0]
    flown = trade.noise.scenario(integral="off")
    x, modes = flown.initial, flown.world.vehicle.modes
    more = {"world.vehicle.modes.w1": [0.9 * modes.w1], "world.vehicle.modes.w2": [0.9 * modes.w2]}
    more |= {"initial.eta1": [float(x.eta1) / 0.81], "initial.eta2": [float(x.eta2) / 0.81]}
    batch = trade._fly_settings(flown, [setting], [0], {k: np.array(v) for k, v in more.items()})
    t = batch.ticks * 1e-7
    off = np.abs(batch.log["estimate.state.eta1"] - batch.log["truth.eta1"])[0]
    windows = [(a, off[(t >= a) & (t < a + 2)].max()) for a in range(20, 70, 2)]
    rate = np.polyfit([a for a, _ in windows], np.log([size for _, size in windows]), 1)[0]
    assert rate == pytest.approx(loop.growth_rate(setting.Q, setting.R, detuned=(0.9, 0.9)), abs=0.03)


@pytest.mark.thorough
@pytest.mark.timeout(1200)
def test_rows_hold_and_the_picture_is_drawn(tmp_path):
    rows = list(elevator_trade.rows())
    assert [r.id for r in rows if not r.holds] == []
    assert len({r.id for r in rows}) == len(rows)
    (picture,) = elevator_trade.figures(tmp_path)
    assert picture.read_bytes().startswith(b"\x89PNG")

"""The ideal twins against tests/oracles/hovercraft.py and the text of [1].

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 6.1.
"""

from functools import cache

import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.loop.settings import with_settings
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue

ARM = 0.32


@cache
def ideal(name, *settings, duration=None):
    """Return the log of the ideal twin, every millisecond."""
    scenario, rest = catalogue.load_scenario(f"hovercraft/{name}", dict(settings))
    return simulate(with_settings(scenario, rest).ideal(), duration=duration)


def first(log, signal, holds):
    return log.t[holds(log[signal]).argmax()]


@pytest.mark.thorough
def test_zero_velocity_extremes_match_the_figure():
    """Fig. 6.7: extremes within 2 %, the turn stopped at 4.09 s."""
    log = ideal("zero-velocity")
    surge, sway = log["truth.surge_velocity"], log["truth.sway_velocity"]
    assert surge.min() == pytest.approx(-0.299, rel=0.02)
    assert surge.max() == pytest.approx(0.223, rel=0.02)
    assert sway.max() == pytest.approx(0.300, rel=0.02)
    assert first(log, "truth.yaw_rate", lambda r: np.abs(r) < 0.32) == pytest.approx(4.09, rel=0.02)


SLOW = (("autopilot.period", "10 ms"), ("world.max_step", "10 ms"))  # 2000 s in a tenth of the instants


@pytest.mark.thorough
def test_zero_velocity_ends_on_the_slow_manifold():
    """Section 1.4: the rudder pivot stops slipping, then yaw decays algebraically: d(1/(2 r^2))/dt = c = 1.911."""
    log = ideal("zero-velocity", *SLOW, duration=seconds(2000))
    late = log.t > 1000
    rate, sway = log["truth.yaw_rate"][late], log["truth.sway_velocity"][late]
    np.testing.assert_allclose(sway, ARM * rate, rtol=5e-3)
    slope = np.polyfit(log.t[late], 1 / (2 * rate**2), 1)[0]
    assert slope == pytest.approx(1.911, rel=0.01)


@pytest.mark.thorough
def test_zero_velocity_never_holds_a_heading():
    """Section 1.4: with 1/(2 r^2) = c (t + t0), the heading drifts like sqrt(2 (t + t0)/c), without bound."""
    log = ideal("zero-velocity", *SLOW, duration=seconds(2000))
    c, start = 1.911, np.searchsorted(log.t, 1000.0)
    t0 = 1 / (2 * c * log["truth.yaw_rate"][start] ** 2) - 1000
    drift = log["truth.heading"][-1] - log["truth.heading"][start]
    assert drift == pytest.approx(np.sqrt(2 / c) * (np.sqrt(2000 + t0) - np.sqrt(1000 + t0)), rel=0.01)


def test_spin_extremes_match_the_figure():
    """Fig. 6.10: extremes within 1.5 %."""
    log = ideal("spin")
    wanted = {"surge_velocity": (-0.239, 0.169), "sway_velocity": (-0.197, 0.180)}
    for signal, (low, high) in wanted.items():
        assert log[f"truth.{signal}"].min() == pytest.approx(low, rel=0.015)
        assert log[f"truth.{signal}"].max() == pytest.approx(high, rel=0.015)
    assert log["truth.yaw_rate"].max() == pytest.approx(3.438, rel=0.015)


def test_spin_brakes_before_spinning_from_a_fast_slide():
    """Section 1.5: from a fast slide the supervisor damps until V < eps(Pi), then spins and reaches the good point."""
    start = (("initial.sway_velocity", "-1.0"), ("initial.yaw_rate", "-4.0"))
    log = ideal("spin", *start, duration=seconds(60))
    assert log["law.mode"][0] == 0
    assert log["law.mode"][-1] == 1
    assert log["law.switches"][-1] == 1
    assert log["truth.yaw_rate"][-1] == pytest.approx(3.0, abs=0.01)


@pytest.mark.thorough
def test_bang_bang_chatters_at_the_tolerance_edge():
    """Fig. 6.12: the heading stays at the edge of the tolerance, with over 400 switches and remaining sway."""
    log = ideal("heading-bang-bang")
    error = log["law.heading_error"][log.t > 30]
    assert 0.012 <= np.abs(error).mean() <= 0.02
    assert log["law.switches"][-1] > 400
    assert np.abs(log["truth.sway_velocity"][-1]) == pytest.approx(0.05, abs=0.01)
    rate = log["truth.yaw_rate"]
    assert rate.min() == pytest.approx(-0.679, rel=0.02)
    assert rate.max() == pytest.approx(1.163, rel=0.02)


LITERAL = (("autopilot.law.form", "literal"),)


@pytest.mark.thorough
def test_literal_proportional_freezes_at_the_wrong_equilibrium():
    """Fig. 6.12 and section 1.6: a steady error whose real cause is the bad equilibrium: v = -d Om_ref, no turn."""
    log = ideal("heading-proportional", *LITERAL)
    error = log["law.heading_error"][-1]
    assert 0.055 <= abs(error) <= 0.085
    reference = log["law.spin_reference"][-1]
    assert log["truth.sway_velocity"][-1] == pytest.approx(-ARM * reference, rel=0.02)
    assert abs(log["truth.yaw_rate"][-1]) < 1e-3
    assert log["law.mode"][-1] == 1  # still asked to turn


def test_proportional_is_slower_than_bang_bang_and_slides_less():
    """Fig. 6.12: 3.3 s against 1.1 s to the tolerance; sway closer to zero."""
    tolerance = np.pi / 180
    bang, literal = ideal("heading-bang-bang"), ideal("heading-proportional", *LITERAL)
    within = lambda e: np.abs(e) <= tolerance  # noqa: E731
    assert first(bang, "law.heading_error", within) == pytest.approx(1.1, abs=0.1)
    assert first(literal, "law.heading_error", within) == pytest.approx(3.3, abs=0.1)
    assert abs(literal["truth.sway_velocity"][-1]) < abs(bang["truth.sway_velocity"][-1])


@pytest.mark.thorough
def test_floored_proportional_has_no_steady_error():
    """Section 1.6: the floor on the reference prevents the freezing."""
    log = ideal("heading-proportional")
    assert np.abs(log["law.heading_error"][log.t > 30]).max() < 3 * np.pi / 180
    literal = ideal("heading-proportional", *LITERAL)
    assert abs(log["law.heading_error"][-1]) < abs(literal["law.heading_error"][-1]) / 2


@pytest.mark.thorough("heading-proportional")
@pytest.mark.parametrize("name", ["heading-bang-bang", "heading-proportional"])
def test_moving_start_heading_settles_at_five_radians(name):
    """Fig. 6.11: from the slide the heading settles at 5 rad, not a full turn away."""
    log = ideal(name, ("initial", "moving"))
    assert log["truth.heading"][-1] == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(("name", "momentum"), [("forward", 2.8), ("reverse", -1.98)])
def test_momentum_laws_reach_their_reference(name, momentum):
    """Figs. 6.8 and 6.9, ideal."""
    log = ideal(name)
    assert log["truth.surge_velocity"][-1] == pytest.approx(momentum / 2.6, rel=0.01)
    assert abs(log["truth.yaw_rate"][-1]) < 0.01


def test_lyapunov_functions_fall_along_ideal_runs():
    """Equations 2.17, 2.23 and 2.37: the logged value of V or W never rises while one law is on."""
    for name in ("zero-velocity", "forward", "spin"):
        value = ideal(name)["law.lyapunov"]
        assert np.diff(value).max() <= 1e-12 * value.max()


def test_log_period_does_not_change_the_flight():
    """A sparser log contains the same flight at fewer instants."""
    scenario = replace(catalogue.load_scenario("hovercraft/zero-velocity")[0], duration=seconds(2))
    fine, coarse = simulate(scenario), simulate(scenario, log_period=ms(6))
    np.testing.assert_array_equal(coarse["truth.yaw_rate"], fine["truth.yaw_rate"][::6])

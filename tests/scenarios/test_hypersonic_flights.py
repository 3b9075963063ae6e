"""Requirements on the hypersonic vehicle's flights."""

import math

import numpy as np
import pytest

from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms, seconds
from trimtab.laws.path_command import FilteredClimb
from trimtab.loop.model_mismatch import model_mismatches
from trimtab.run.simulate import simulate, simulate_batch
from trimtab.scenarios import catalogue
from trimtab.scenarios.hypersonic._flight import hypersonic_scenario
from trimtab.vehicles.hypersonic import Hypersonic

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
SEEDS = 20
SIGNALS = (
    "law.h_error",
    "law.V_error",
    "law.saturated",
    "law.outside",
    "actuators.u.delta_e",
    "estimate.state.eta1",
    "truth.eta1",
)
NOISE = "world.sensors.angular-accelerometer.noise"


class Flights:
    """Many runs of the large climb: rows after 20 s of each, by (noise, factor of the frequencies)."""

    def __init__(self, cases):
        scenario, _ = catalogue.load_scenario("hypersonic/noise")
        modes, x = scenario.world.vehicle.modes, scenario.initial
        by = np.array([factor for _, factor, _ in cases])
        spread = {
            NOISE: np.array([noise for noise, _, _ in cases]),
            "world.vehicle.modes.w1": modes.w1 * by,
            "world.vehicle.modes.w2": modes.w2 * by,
            "initial.eta1": x.eta1 / by**2,
            "initial.eta2": x.eta2 / by**2,
        }
        options = {"signals": SIGNALS, "log": True, "log_period": ms(50), "spread": spread}
        found = simulate_batch(scenario, seeds=[seed for *_, seed in cases], **options)
        late = found.ticks >= seconds(20)
        self.cases, self.late = cases, {path: values[:, late] for path, values in found.log.items()}
        self.all = found.log

    def rows(self, path, noise, factor):
        return np.array([r for r, c in zip(self.late[path], self.cases, strict=True) if c[:2] == (noise, factor)])


@pytest.fixture(scope="module")
def flights():
    wanted = [(0.0, 1.0)] + [(0.01, factor) for factor in (1.0, 0.9, 1.1)]
    return Flights([(n, f, seed) for n, f in wanted for seed in range(SEEDS if n else 1)])


def rms(x):
    return np.sqrt(np.mean(x**2, axis=-1))


@pytest.mark.thorough
def test_nominal_large_climb_tracks_without_saturation(flights):
    """+5000 ft, +1000 ft/s, 200 s: no saturation; rms after 20 s below 0.05 ft and 0.01 ft/s."""
    assert rms(flights.rows("law.h_error", 0.0, 1.0)) < 0.05
    assert rms(flights.rows("law.V_error", 0.0, 1.0)) < 0.01
    assert not flights.all["law.saturated"][0].any()
    assert not flights.all["law.outside"].any()


@pytest.mark.thorough
def test_noisy_climb_error_stays_below_its_bound(flights):
    """Better than 0.05 ft rms with 0.01 rad/s^2 over 20 seeds.

    Bounds are what is measured, 0.0146 ft and 0.0010 ft/s, rounded up.
    """
    h, V = rms(flights.rows("law.h_error", 0.01, 1.0)), rms(flights.rows("law.V_error", 0.01, 1.0))
    print(f"h {h.min():.4f} to {h.max():.4f} ft, V {V.min():.4f} to {V.max():.4f} ft/s")
    assert len(h) == SEEDS
    assert h.max() < 0.015
    assert V.max() < 0.0011


@pytest.mark.thorough
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_mode_frequencies_10_percent_off_stay_inside_the_envelope(flights, factor):
    """Required of the shipped setting, with noise: h rms 0.008-0.027 ft, as without mismatch.

    Bounds are what is measured, 0.0146 ft and 0.64, rounded up: mode 1 is estimated worse than with equal noise (0.37),
    the price of less noise on mode 2.
    """
    h = rms(flights.rows("law.h_error", 0.01, factor))
    off = np.abs(flights.rows("estimate.state.eta1", 0.01, factor) - flights.rows("truth.eta1", 0.01, factor))
    print(f"x {factor}: h {h.min():.4f} to {h.max():.4f} ft; eta1 up to {off.max():.2f} off")
    assert len(h) == SEEDS
    assert h.max() < 0.015
    assert not flights.rows("law.saturated", 0.01, factor).any()
    assert not flights.rows("law.outside", 0.01, factor).any()
    assert off.max() < 0.65


@pytest.mark.thorough
def test_noise_moves_the_elevator_below_a_third_degree(flights):
    """Requirement: below 0.3 deg rms. The effect of noise is the difference from the same climb without it."""
    moved = flights.rows("actuators.u.delta_e", 0.01, 1.0) - flights.rows("actuators.u.delta_e", 0.0, 1.0)
    activity = np.rad2deg(rms(moved))
    print(f"elevator {activity.min():.3f} to {activity.max():.3f} deg rms")
    assert 0.2 < activity.min() <= activity.max() < 0.22


@pytest.mark.thorough
def test_only_nonlinear_internal_motion_leaves_no_steady_error():
    """Steady h error below 0.01 ft with the nonlinear internal motion, above 5 ft with the linear."""
    ends = {}
    for form in ("noncausal", "linear"):
        scenario, _ = catalogue.load_scenario("hypersonic/climb-large", {"internal": form, "integral": "off"})
        log = simulate(scenario, log_period=ms(100))
        ends[form] = np.abs(log["law.h_error"][log.t > 180]).max()
    print(ends)
    assert ends["noncausal"] < 0.01
    assert ends["linear"] > 5


@pytest.mark.thorough
def test_printed_filter_fails_with_modes_two_percent_off():
    """With the printed Q and R 2 % already drives a saturated oscillation, h rms 1e2-4e2 ft; here 431 ft."""
    scenario, _ = catalogue.load_scenario(
        "hypersonic/modal-mismatch", {"filter": "printed", "frequency": "1.02", "integral": "off"}
    )
    log = simulate(scenario, log_period=ms(100))
    h = rms(log["law.h_error"][log.t > 20])
    print(f"h {h:.1f} ft, saturated {log['law.saturated'][log.t > 100].mean():.3f} of the time")
    assert log["law.saturated"][log.t > 100].mean() > 0.99
    assert 400 < h < 460


@pytest.mark.thorough
def test_rejects_a_table_of_another_climb_or_vehicle():
    scenario, _ = catalogue.load_scenario("hypersonic/climb-small")
    law = scenario.autopilot.law
    with pytest.raises(InputError, match="another command or vehicle"):
        replace(law, command=replace(law.command, dh=900.0)).check()
    with pytest.raises(InputError, match="another command or vehicle"):
        replace(law, craft=replace(law.craft, m=301.0)).check()
    law.check()


@pytest.mark.thorough
def test_rejects_a_climb_beyond_the_engine_before_the_run():
    """Requirement: commands that saturate the engine are rejected with the violated limit."""
    climb = FilteredClimb(dh=1000.0, dV=200.0, wh=0.5, wV=0.5)
    with pytest.raises(InputError, match=r"at \d+\.?\d* s needs fuel ratio 1\.\d+, but the limits are 0\.02 and 1\.5"):
        hypersonic_scenario("mine", climb, 60.0).check()
    with pytest.raises(InputError, match="without pitching moment"):
        hypersonic_scenario("mine", replace(climb, dh=5000.0), 60.0)


@pytest.mark.thorough
@pytest.mark.parametrize("integral", ["on", "off"])
def test_gain_filter_law_and_table_use_the_assumed_vehicle(integral):
    """A 10 % heavier vehicle is tracked like the nominal one only if all parts assume it."""
    heavy = replace(Hypersonic(), m=330.0)
    climb = FilteredClimb(dh=500.0, dV=100.0)
    apart, alike = (
        hypersonic_scenario("mine", climb, 30.0, plant=heavy, integral=integral, **more)
        for more in ({}, {"assumed": heavy})
    )
    assert model_mismatches(alike.autopilot, alike.world.vehicle) == []
    assert [m.path for m in model_mismatches(apart.autopilot, apart.world.vehicle)] == ["m"]
    assert not np.allclose(alike.autopilot.law.K, apart.autopilot.law.K, rtol=1e-3)
    alike.check()
    off = [np.abs(simulate(s, log_period=ms(100))["law.h_error"][-50:]).max() for s in (apart, alike)]
    assert off[1] < off[0] / 10


@pytest.mark.thorough
def test_rejects_a_run_longer_than_its_table():
    scenario, _ = catalogue.load_scenario("hypersonic/climb-small")
    with pytest.raises(
        InputError, match=r"autopilot\.law\.internal.*ends at 150 s, before the end of the run at 200 s"
    ):
        replace(scenario, duration=seconds(200)).check()


@pytest.mark.thorough
def test_mode_references_scale_with_the_estimated_frequency():
    """The static deflection of a mode scales with 1/w^2, so its reference scales with the estimate of w."""
    scenario, _ = catalogue.load_scenario("hypersonic/modal-mismatch", {"filter": "adaptive", "frequency": "1.10"})
    log = simulate(scenario, seed=1, log_period=ms(100))
    late = log.t > 60
    print(f"h up to {np.abs(log['law.h_error'][late]).max():.3f} ft")
    assert np.abs(log["law.h_error"][late]).max() < 0.15
    wanted, w2 = log["law.eta2_reference"][late], log["estimate.state.frequencies.w2"][late]
    fixed, _ = catalogue.load_scenario("hypersonic/modal-mismatch", {"frequency": "1.10"})
    told = simulate(fixed, seed=1, log_period=ms(100))["law.eta2_reference"][late]
    np.testing.assert_allclose(wanted, told * (20.0 / w2) ** 2, rtol=1e-9)
    assert math.isclose(float(np.median(w2)), 22.0, rel_tol=0.05)

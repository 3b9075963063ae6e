"""Parameters that a campaign draws from a calibration: covariances, tables, and reported omissions."""

import numpy as np
import pytest

from trimtab.actuators.lookup import thrust_table
from trimtab.actuators.thruster import Thruster
from trimtab.analysis.campaign.sampling.distributions import parse_distribution
from trimtab.analysis.campaign.sampling.spread import parse_factors, resolve_spread, spread_arrays, spread_values
from trimtab.core.errors import InputError
from trimtab.core.record import replace, with_leaf
from trimtab.links.latency import gamma_table, mean_latency, normal_scores
from trimtab.loop.calibrated import with_calibration
from trimtab.loop.calibrated_spread import calibrated_spread, follow_tables
from trimtab.loop.calibration import Calibration, Covariance, Entry
from trimtab.scenarios.build import build

NAME = "hovercraft/forward"
REVERSE = tuple(f"Thruster.reverse_ratio[{i}]" for i in range(4))
RATIO, TABLE = "world.actuators.thruster.reverse_ratio", "world.actuators.table.values"
LATENCY = "world.uplink.latency"
MEAN, SD, SHIFT = 0.045, 0.009, 0.02
LINK_COVARIANCE = [[2.5e-7, 1e-7], [1e-7, 1.6e-7]]


def reverse_calibration(size=1.0):
    """Return a cubic fitted to ratios with 2 % noise at 13 speeds, three times: nearly collinear coefficients."""
    n = np.repeat(np.arange(6, 12.1, 0.5), 3)
    A = np.stack([n**3, n**2, n, np.ones_like(n)], 1)
    P = np.linalg.inv(A.T @ A) * (0.02 * size) ** 2
    ratio = np.asarray(Thruster().reverse_ratio).tolist()
    entry = Entry(ratio, "1", np.sqrt(np.diagonal(P)).tolist(), procedure="reverse")
    return Calibration({"Thruster.reverse_ratio": entry}, (Covariance(REVERSE, P.tolist(), "reverse"),)), P


def link_calibration():
    entries = {
        LATENCY: Entry(gamma_table(MEAN, SD, SHIFT).tolist(), "s"),
        "uplink.mean": Entry(MEAN, "s", 5e-4),
        "uplink.deviation": Entry(SD, "s", 4e-4),
        "uplink.shift": Entry(SHIFT, "s"),
    }
    return Calibration(entries, (Covariance(("uplink.mean", "uplink.deviation"), LINK_COVARIANCE),))


def link_and_inertia():
    link = link_calibration()
    return Calibration({**link.entries, "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002)}, link.covariances)


def draw(scenario, calibration, n=4000):
    """Return the arrays of n draws."""
    found = calibrated_spread(scenario, calibration)
    factors = parse_factors((path, parse_distribution(text)) for path, text in found.drawn.items())
    spread = resolve_spread(scenario, factors, found.correlate)
    u = np.random.default_rng(0).uniform(size=(n, len(factors)))
    return found, spread_arrays(spread, scenario, spread_values(spread, scenario, u))


def test_draws_parameters_with_their_covariance():
    entries = {
        "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002),
        "Thruster.coefficient": Entry(0.0125, "N/krpm^2", 1e-4),
        "RudderGeometry.ratio": Entry(1.3, "1", 0.01),
        "RudderGeometry.offset": Entry(0.02, "rad", 0.004),
    }
    boat = Calibration(
        entries, (Covariance(("RudderGeometry.ratio", "RudderGeometry.offset"), [[1e-4, 2e-5], [2e-5, 1.6e-5]]),)
    )
    found = calibrated_spread(with_calibration(build(NAME), boat).scenario, boat)
    assert found.drawn["world.vehicle.inertia"] == "normal(0.11, 0.002)"
    assert found.drawn["world.actuators.effectiveness"] == "normal(1.0, 0.008)"
    pair = ("world.actuators.geometry.ratio", "world.actuators.geometry.offset", pytest.approx(0.5))
    assert found.correlate == [pair]
    assert found.notes == ()


def test_draws_reverse_thrust_with_its_covariance_and_rebuilds_the_table():
    calibration, P = reverse_calibration()
    scenario = with_calibration(build(NAME), calibration).scenario
    found, arrays = draw(scenario, calibration)
    assert set(found.drawn) == {f"{RATIO}:{k}" for k in (1, 2, 3, 4)}
    assert found.correlate == []
    white = np.linalg.solve(np.linalg.cholesky(P), (arrays[RATIO] - Thruster().reverse_ratio).T)
    np.testing.assert_allclose(np.cov(white), np.eye(4), atol=0.09)  # four standard errors of 4000 draws
    for k in (0, 17):
        thruster = replace(Thruster(), reverse_ratio=arrays[RATIO][k])
        thruster.check()
        wanted = np.asarray(thrust_table(thruster).values)
        np.testing.assert_allclose(arrays[TABLE][k], wanted, atol=1e-12)
        assert np.abs(wanted - np.asarray(scenario.world.actuators.table.values)).max() > 1e-3


def test_non_monotonic_reverse_thrust_draw_is_moved_back():
    calibration, _ = reverse_calibration(size=20.0)
    scenario = with_calibration(build(NAME), calibration).scenario
    found, arrays = draw(scenario, calibration, 500)
    own = np.asarray(Thruster().reverse_ratio)
    for ratio in arrays[RATIO]:
        replace(Thruster(), reverse_ratio=ratio).check()
    moved = np.linalg.norm((arrays[RATIO] - own) / own, axis=1)
    assert (moved > 1e-3).mean() > 0.99  # and not to where it was
    assert any("moved towards the calibrated" in note for note in found.notes)


@pytest.mark.thorough
def test_draws_latencies_from_errors_of_mean_and_deviation():
    calibration = link_calibration()
    scenario = with_calibration(build(NAME, {"links": "measured"}), calibration).scenario
    found, arrays = draw(scenario, calibration)
    assert set(found.drawn) == {f"{LATENCY}:1", f"{LATENCY}:2"}
    assert found.notes == ()
    tables = arrays[LATENCY]
    assert (np.diff(tables, axis=1) > 0).all()
    g = np.random.default_rng(1).standard_normal(20_000)
    means = np.array([mean_latency(t) for t in tables])
    deviations = np.array([np.std(np.interp(g, normal_scores(), t)) for t in tables[:1000]])
    assert np.mean(means) == pytest.approx(MEAN, abs=4 * 5e-4 / np.sqrt(4000))
    assert np.std(means) == pytest.approx(5e-4, rel=0.06)
    assert np.std(deviations) == pytest.approx(4e-4, rel=0.12)
    assert np.corrcoef(means[:1000], deviations)[0, 1] == pytest.approx(0.5, abs=0.1)


def test_reports_calibration_entries_that_are_not_drawn():
    entries = {
        "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002),
        "Thruster.offset": Entry(0.02, "rad", 0.004),
        "IdentifiedGyro.b0": Entry(0.3, "1", 0.01),
        **link_calibration().entries,
    }
    boat = Calibration(entries)
    notes = calibrated_spread(with_calibration(build(NAME), boat).scenario, boat).notes
    assert [n.partition(" ")[0] for n in notes] == ["Thruster.offset", "IdentifiedGyro.b0", "uplink.mean"]
    assert 'settings={"links": "measured"}' in notes[-1]
    del entries["uplink.shift"]
    boat = Calibration(entries)
    measured = with_calibration(build(NAME, {"links": "measured"}), boat).scenario
    assert "Calibrate the link again" in calibrated_spread(measured, boat).notes[-1]
    changed = build(NAME, {"links": "measured", "world.vehicle.inertia": "0.11"})
    assert "it differs from the table for" in calibrated_spread(changed, link_and_inertia()).notes[-1]


def test_reverse_thrust_without_covariance_is_not_drawn():
    calibration = Calibration(reverse_calibration()[0].entries | {"Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002)})
    found = calibrated_spread(with_calibration(build(NAME), calibration).scenario, calibration)
    assert set(found.drawn) == {"world.vehicle.inertia"}
    assert "has no [[covariance]] of its coefficients. Calibrate it again" in found.notes[-1]


@pytest.mark.parametrize(
    ("name", "entry", "said"),
    [
        ("Hovercraft.mass", Entry(2.6, "kg", 2.6), r"the 95 % interval, -2.49591 to 7.69591 kg, must be above 0 kg"),
        ("RudderGeometry.offset", Entry(0.0, "rad", 9.0), "must be less than a turn"),
        ("RudderGeometry.offset", Entry(0.0, "rad", 1.65), "-3.23394 to 3.23394 rad, must be less than a turn"),
    ],
)
def test_rejects_an_implausibly_large_standard_error(name, entry, said):
    boat = Calibration({name: entry})
    with pytest.raises(InputError, match=said):
        calibrated_spread(with_calibration(build(NAME), boat).scenario, boat)


def test_setting_that_differs_from_the_calibration_is_not_drawn():
    boat = Calibration({"Hovercraft.mass": Entry(2.6, "kg", 0.1), "Hovercraft.inertia": Entry(0.11, "kg m^2", 0.002)})
    scenario = with_leaf(with_calibration(build(NAME), boat).scenario, "world.vehicle.mass", lambda old, _: 5.0)
    found = calibrated_spread(scenario, boat)
    assert set(found.drawn) == {"world.vehicle.inertia"}
    assert found.notes == ("world.vehicle.mass is not varied: its value is 5, not the calibrated 2.6",)


def test_rejects_a_calibration_without_uncertainty():
    boat = Calibration({"Hovercraft.inertia": Entry(0.11, "kg m^2")})
    with pytest.raises(InputError, match="contains no standard error"):
        calibrated_spread(with_calibration(build(NAME), boat).scenario, boat)


def test_rudder_stops_follow_the_drawn_angle_table():
    scenario = build(NAME)
    servo = scenario.world.actuators.rudder
    angles = np.stack([np.asarray(servo.angles) * k for k in (1.0, 0.5, 1.5)])
    arrays = follow_tables(scenario, {"world.actuators.rudder.angles": angles})
    low, high = float(servo.angle_min), float(servo.angle_max)
    np.testing.assert_allclose(arrays["world.actuators.rudder.angle_min"], np.maximum(low, angles[:, 0]))
    np.testing.assert_allclose(arrays["world.actuators.rudder.angle_max"], np.minimum(high, angles[:, -1]))
    assert arrays["world.actuators.rudder.angle_max"][1] < high


def test_accepts_large_standard_errors_that_are_plausible():
    boat = Calibration({"Hovercraft.mass": Entry(20.0, "kg", 5.0), "RudderGeometry.offset": Entry(0.0, "rad", 1.0)})
    found = calibrated_spread(with_calibration(build(NAME), boat).scenario, boat)
    assert {"world.vehicle.mass"} < set(found.drawn)


def test_error_without_any_drawn_setting_gives_the_reasons():
    boat = Calibration({"IdentifiedGyro.b0": Entry(0.3, "1", 0.01), "Hovercraft.mass": Entry(2.6, "kg")})
    with pytest.raises(InputError, match=r"in the world of this scenario; IdentifiedGyro\.b0 is not varied"):
        calibrated_spread(with_calibration(build(NAME), boat).scenario, boat)

"""Air data against printed Mach numbers and against the wind that no inertial sensor knows."""

import jax
import numpy as np
import pytest

from trimtab.core.imperfections import without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion, SurroundingAir
from trimtab.sensors.air_data import AirData, impact_pressure, mach_of_impact

O = np.zeros(3)
IDEAL = without_any(AirData())


def motion(v, w=O, wind=O, turn=O, height=0.0):
    air = SurroundingAir(height=np.float64(height), velocity=np.array(wind, float), rate=np.array(turn, float))
    return Motion(np.int64(0), np.array([0.0, 0.0, -height]), O, np.array(v, float), np.array(w, float), O, O, air)


@pytest.mark.parametrize(
    ("mach", "ratio"), [(0.5, 1.1862), (1.0, 1.8929), (2.0, 5.6404), (4.0, 21.068), (10.0, 129.22)]
)
def test_pitot_ratios_match_naca_1135(mach, ratio):
    """NACA report 1135, table I (subsonic) and table II (p02/p1 behind a normal shock)."""
    assert float(impact_pressure(mach, 1.0)) + 1 == pytest.approx(ratio, rel=2e-4)
    assert float(mach_of_impact(ratio - 1)) == pytest.approx(mach, rel=2e-4)


def test_impact_pressure_inverts_to_mach_number():
    for mach in (0.0, 0.01, 0.3, 0.999, 1.001, 1.5, 3.0, 8.0, 25.0):
        assert float(mach_of_impact(impact_pressure(mach, 1.0))) == pytest.approx(mach, rel=1e-9, abs=1e-7)
    assert np.isfinite(mach_of_impact(-0.2))


def test_airspeed_and_flow_angles_account_for_wind():
    seen = IDEAL.measure(motion([60.0, 5.0, 8.0], wind=[10.0, 0.0, -2.0], height=3000.0))
    speed = np.sqrt(50**2 + 5**2 + 10**2)
    assert float(seen.airspeed) == pytest.approx(speed, rel=1e-9)
    assert float(seen.equivalent_airspeed) == pytest.approx(speed * np.sqrt(0.90925 / 1.225), rel=1e-4)
    assert float(seen.alpha) == pytest.approx(np.arctan2(10, 50))
    assert float(seen.beta) == pytest.approx(np.arcsin(5 / speed))


def test_probe_offset_adds_rotation_relative_to_the_air():
    nose = replace(IDEAL, position=(3.0, 0.0, 0.0))
    turning = motion([60.0, 0.0, 0.0], w=[0.0, 0.2, 0.1])
    seen = nose.measure(turning)
    assert float(seen.alpha) == pytest.approx(np.arctan2(-0.6, 60.0))
    assert float(seen.beta) == pytest.approx(np.arcsin(0.3 / np.sqrt(60**2 + 0.6**2 + 0.3**2)))
    carried = nose.measure(motion([60.0, 0.0, 0.0], w=[0.0, 0.2, 0.1], turn=[0.0, 0.2, 0.1]))
    assert float(carried.alpha) == pytest.approx(0.0, abs=1e-15)


def samples(sensor, at, n, seed=0):
    return rollout(to_arrays(sensor), key(seed), at, np.arange(n, dtype=np.int64))


@jax.jit
def rollout(sensor, key, at, k):
    state = sensor.init(key)
    return jax.vmap(lambda k: sensor.step(k * sensor.period, state, at)[1].value)(k)


@pytest.mark.thorough
def test_each_error_has_the_given_size():
    at = motion([60.0, 4.0, 3.0])
    true = IDEAL.measure(at)
    seen = samples(replace(IDEAL, pressure_noise=20.0, vane_noise=0.01), at, 4000)
    assert np.std(seen.impact_pressure) == pytest.approx(20.0, rel=0.05)
    assert np.std(seen.alpha) == pytest.approx(0.01, rel=0.05)
    assert np.std(seen.beta) == pytest.approx(0.01, rel=0.05)
    assert np.std(seen.airspeed) == pytest.approx(20.0 / (1.225 * 60.2), rel=0.1)
    zeros = replace(IDEAL, pressure_bias=20.0, vane_bias=0.02)
    runs = [samples(zeros, at, 1, seed) for seed in range(100)]
    assert np.std([r.impact_pressure[0] for r in runs]) == pytest.approx(20.0, rel=0.3)
    assert np.std([r.alpha[0] for r in runs]) == pytest.approx(0.02, rel=0.3)
    bent = samples(replace(IDEAL, upwash=0.1), at, 1)
    assert float(bent.alpha[0]) == pytest.approx(1.1 * float(true.alpha))

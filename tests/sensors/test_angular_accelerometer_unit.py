"""An angular accelerometer of finite grade: band, delay, place on the bending body, and what is drawn for each run."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections, without_any
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Bending, Motion
from trimtab.core.time import to_seconds
from trimtab.sensors.angular_accelerometer import AngularAccelerometerUnit
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

O = np.zeros(3)
IDEAL = without_any(AngularAccelerometerUnit())
TICK = to_seconds(IDEAL.period)


def samples(unit, felt, seed=0):
    """Outputs (n,) of pitch accelerations (n,)."""
    return np.asarray(rollout(to_arrays(unit), key(seed), np.asarray(felt, float)))


@jax.jit
def rollout(unit, key, felt):
    def one(state, now):
        k, a = now
        motion = Motion(k * unit.period, O, O, O, O, O, np.array([0.0, 1.0, 0.0]) * a)
        state, sample = unit.step(motion.t, state, motion)
        return state, sample.value.pitch_acceleration

    return jax.lax.scan(one, unit.init(key), (np.arange(len(felt), dtype=np.int64), felt))[1]


def response(unit, frequency):
    """Gain and phase (rad) at a frequency (Hz)."""
    t = TICK * np.arange(4000)
    y = samples(unit, np.sin(2 * np.pi * frequency * t))[1000:]
    z = 2 * np.mean(y * np.exp(-2j * np.pi * frequency * t[1000:])) * 1j
    return abs(z), np.angle(z)


def test_gain_at_the_bandwidth_is_minus_3_db():
    unit = replace(IDEAL, bandwidth=20.0)
    assert response(unit, 20.0)[0] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert response(unit, 2.0)[0] == pytest.approx(1.0, abs=2e-3)
    assert samples(unit, [0.7] * 5) == pytest.approx(0.7)


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.0125, 0.075])
def test_phase_at_low_frequency_matches_the_delay(delay):
    """Between samples the line is straight, so that at low frequency the phase is that of the delay."""
    gain, phase = response(replace(IDEAL, delay=delay), 1.0)
    assert gain == pytest.approx(1.0, abs=1e-3)
    assert phase == pytest.approx(-2 * np.pi * delay, abs=1e-4)


def test_reading_includes_rotation_due_to_bending():
    craft = Hypersonic()
    x, u = HypersonicState(85000.0, 7702.0, 0.028, 0.028, 0.0, 1.5, 3.0, 1.1, -2.0), HypersonicInput(0.26, 0.217)
    motion = craft.motion(0, x, u)
    rate = craft.dynamics(0.0, x, u)
    assert isinstance(motion.bending, Bending)
    np.testing.assert_allclose(motion.bending.rate, [3.0, -2.0])
    seen = replace(IDEAL, slope1=2e-4, slope2=-3e-4).measure(motion).pitch_acceleration
    assert float(seen) == pytest.approx(float(rate.q + 2e-4 * rate.eta1_rate - 3e-4 * rate.eta2_rate), rel=1e-12)


def test_bias_and_scale_factor_are_drawn_per_run():
    unit = replace(IDEAL, bias=0.1, scale_factor=0.05)
    runs = np.array([samples(unit, [0.0, 1.0, 0.0], seed) for seed in range(300)])
    np.testing.assert_array_equal(runs[:, 0], runs[:, 2])
    assert runs[:, 0].std() == pytest.approx(0.1, rel=0.15)
    assert (runs[:, 1] - runs[:, 0]).std() == pytest.approx(0.05, rel=0.15)
    assert samples(replace(IDEAL, noise=0.01), np.zeros(4000)).std() == pytest.approx(0.01, rel=0.05)


def test_ideal_unit_returns_the_true_acceleration():
    names = {f"angular-accelerometer-{n}" for n in ("noise", "offset", "scale-factor", "bandwidth", "delay", "place")}
    assert set(imperfections(IDEAL)) == names
    felt = np.random.default_rng(1).normal(size=20)
    np.testing.assert_array_equal(samples(IDEAL, felt), felt)


def test_rejects_excessive_bandwidth_and_delay():
    with pytest.raises(InputError, match="is too high"):
        replace(IDEAL, bandwidth=120.0).check()
    with pytest.raises(InputError, match="longer than"):
        replace(IDEAL, delay=0.08).check()

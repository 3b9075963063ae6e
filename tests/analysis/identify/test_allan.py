"""Allan deviation: the textbook's values, exact covariances, and recovery of simulated noise within its interval."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

from trimtab.analysis.identify.allan import (
    _covariance,
    _moments,
    confidence_interval,
    filter_noise,
    fit_allan,
    octave_averages,
    overlapping_variance,
    refuse_motion,
    refuse_stuck,
)
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.sensors.imu import Imu

DT = 0.0065536
N_SAMPLES = 16_384
SIZE = 20_000


def flicker(rng, n, B):
    """Gaussian noise of two-sided spectral density B²/(2 pi f), made of sines: four times as long as what is used."""
    f = np.fft.rfftfreq(4 * n, DT)
    shape = np.append(0.0, np.sqrt(B**2 / (2 * np.pi * f[1:]) / DT))
    return np.fft.irfft(np.fft.rfft(rng.normal(size=4 * n)) * shape, 4 * n)[:n]


def still_log(seed, n, N, B, K):
    rng = np.random.default_rng(seed)
    return rng.normal(size=n) * N / np.sqrt(DT) + flicker(rng, n, B) + np.cumsum(rng.normal(size=n)) * K * np.sqrt(DT)


def test_overlapping_deviation_matches_nist_1000_point_set():
    """Riley, NIST SP 1065, section 12.4: n' = 16807 n mod 2147483647, overlapping deviations at 1, 10 and 100."""
    n, y = 1234567890, []
    for _ in range(1000):
        y.append(n / 2147483647)
        n = 16807 * n % 2147483647
    wanted = [2.922319e-01, 9.159953e-02, 3.241343e-02]
    np.testing.assert_allclose(np.sqrt(overlapping_variance(y, (1, 10, 100))), wanted, rtol=2e-7)


def test_overlapping_variance_matches_explicit_averages():
    y = np.random.default_rng(0).normal(size=200)
    for m in (1, 3, 8):
        means = np.array([y[i : i + m].mean() for i in range(200 - m + 1)])
        wanted = np.mean((means[m:] - means[:-m]) ** 2) / 2
        assert overlapping_variance(y, (m,))[0] == pytest.approx(wanted, rel=1e-10)


@pytest.mark.thorough("theta0", "theta1")
@pytest.mark.parametrize("theta", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 1e-3)])
def test_covariance_of_variances_matches_monte_carlo(theta):
    """4000 logs of 256 samples: each covariance within 5 standard errors of what the second differences say."""
    rng, averages, n, runs = np.random.default_rng(2), (1, 2, 4, 8, 16, 32), 256, 4000
    white, walk = rng.normal(size=(2, runs, n))
    logs = np.sqrt(theta[0]) * white + np.sqrt(theta[2]) * np.cumsum(walk, 1)
    v = np.array([overlapping_variance(y, averages) for y in logs])
    C = _covariance(np.array(theta), _moments(n, averages))
    d = v - v.mean(0)
    products = d[:, :, None] * d[:, None, :]
    error = products.std(0) / np.sqrt(runs)
    assert (np.abs(products.mean(0) - C) <= 5 * error).all()


@pytest.mark.thorough("0.001-0.0-0.001", "0.001-0.001-0.0")
@pytest.mark.parametrize(("N", "B", "K"), [(1e-3, 0.0, 1e-3), (1e-3, 1e-3, 0.0), (1e-3, 1e-3, 5e-4)])
def test_noise_coefficient_intervals_have_the_stated_coverage(N, B, K):
    """95 % intervals of 80 logs: each coefficient is inside in about 95 % of logs, or more if it is zero."""
    fits = [fit_allan(still_log(seed, N_SAMPLES, N, B, K), DT) for seed in range(80)]
    for name, true in (("white", N), ("flicker", B), ("walk", K)):
        found = [getattr(f, name) for f in fits]
        inside = sum(c.low <= true <= c.high for c in found)
        assert inside >= binom.ppf(0.001, 80, 0.95), f"{name}: {inside} of 80"
        if true:
            spread = np.std([c.value for c in found])
            assert 0.5 < np.median([c.standard_error for c in found]) / spread < 2, name
    assert np.mean([f.misfit for f in fits]) == pytest.approx(1, abs=0.25)


@pytest.mark.thorough
def test_simulated_imu_noise_parameters_are_recovered():
    """Six axes of two simulated 3DM-GX1, still; its quantisation's step²/12 is below the interval of the noise.

    The bias walk is made twenty times the unit's, so that a log of two minutes shows it.
    """
    imu = Imu.microstrain_3dm_gx1()
    imu = replace(imu, gyro=replace(imu.gyro, bias_walk=2e-3, bandwidth=0.0))
    imu = replace(imu, accelerometer=replace(imu.accelerometer, bias_walk=1e-2, bandwidth=0.0))
    o = jnp.zeros(3)

    def run(seed):
        def body(state, k):
            state, sample = imu.step(k * imu.period, state, Motion(0, o, o, o, o, o, o))
            return state, (sample.value.angular_rate, sample.value.specific_force)

        return jax.lax.scan(body, imu.init(replace(key(0), seed=seed)), jnp.arange(N_SAMPLES))[1]

    rates, forces = (np.asarray(a) for a in jax.jit(jax.vmap(run))(jnp.arange(2, dtype=np.uint32)))
    inside = 0
    for logs, errors in ((rates, imu.gyro), (forces, imu.accelerometer)):
        for y in np.moveaxis(logs, 2, 1).reshape(6, -1):
            fit = fit_allan(y, DT)
            assert fit.white.value == pytest.approx(errors.noise, rel=0.03)
            inside += fit.white.low <= errors.noise <= fit.white.high
            inside += fit.walk.low <= errors.bias_walk <= fit.walk.high
    assert inside >= binom.ppf(0.001, 24, 0.95)


def test_filter_noise_gives_variances_per_filter_step():
    fit = fit_allan(still_log(0, N_SAMPLES, 1e-3, 0.0, 1e-3), DT)
    fit = replace(fit, flicker=replace(fit.flicker, value=0.0))
    noise = filter_noise(fit)
    assert noise.sample_variance == pytest.approx(1e-6 / DT, rel=0.05)
    assert noise.integral_variance == pytest.approx(1e-6 * DT, rel=0.05)
    assert noise.bias_variance == pytest.approx(fit.walk.value**2 * DT, rel=1e-12)
    assert filter_noise(fit, 10 * DT).integral_variance == pytest.approx(10 * noise.integral_variance)
    # Flicker's walk has the flicker's Allan variance where the white noise has fallen to it.
    shaky = replace(fit, flicker=replace(fit.flicker, value=1e-3), walk=replace(fit.walk, value=0.0))
    K2 = filter_noise(shaky).bias_variance / DT
    floor = 2 * np.log(2) / np.pi * 1e-6
    tau = shaky.white.value**2 / floor
    assert K2 * tau / 3 == pytest.approx(floor, rel=1e-9)


def test_degrees_of_freedom_match_monte_carlo_scatter():
    """2 mean²/variance of the estimates of 3000 logs of white noise; the standard error of that is 3 %."""
    averages = (1, 2, 4, 8, 16)
    logs = np.random.default_rng(5).normal(size=(3000, 1024))
    v = np.array([overlapping_variance(y, averages) for y in logs])
    fit = fit_allan(logs[0], 1.0, averages)
    assert fit.walk.value < 0.01
    np.testing.assert_allclose(fit.freedom, 2 * v.mean(0) ** 2 / v.var(0), rtol=0.12)


def test_error_bars_enclose_deviation_and_widen_with_averaging():
    fit = fit_allan(still_log(1, N_SAMPLES, 1e-3, 0.0, 1e-3), DT)
    low, high = confidence_interval(fit)
    assert (low < fit.deviation).all()
    assert (fit.deviation < high).all()
    assert (np.diff(high / low) > 0).all(), "longer averages are less certain"


@pytest.mark.parametrize(
    ("y", "averages", "says"),
    [
        (np.zeros(50), None, "shape"),
        (np.append(np.ones(200), np.nan), None, "not finite"),
        (np.ones(200), None, "the same"),
        (np.random.default_rng(0).normal(size=200), (1, 2, 4, 90), "averages"),
    ],
)
def test_rejects_short_constant_or_non_finite_logs(y, averages, says):
    with pytest.raises(InputError, match=says):
        fit_allan(y, DT, averages)
    assert octave_averages(1024) == (1, 2, 4, 8, 16, 32, 64, 128)


def long_noise(seed, walk=1e-4):
    g = np.random.default_rng(seed)
    return g.standard_normal(SIZE) * 1e-3 / np.sqrt(DT) + np.cumsum(g.standard_normal(SIZE)) * walk * np.sqrt(DT)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda y: np.where(np.abs(np.arange(len(y)) - 600) < 100, y[600], y),
            "in 199 successive samples from 5.01 s on",
        ),
        (lambda y: np.clip(y, -np.inf, 0.01), r"is saturated: \d+ of 2000 samples are 0.01, the greatest value"),
        (lambda y: np.repeat(y[::4], 4), "75 % of the samples equal the one before, must be at most 70 %"),
        (lambda y: np.clip(y, -0.01, np.inf), r"is saturated: \d+ of 2000 samples are -0.01, the least value"),
        (lambda y: np.round(y / 0.04) * 0.04, "resolution 0.04, which is too coarse: .* must be at most 0.7"),
        (lambda y: np.floor(y / 0.1) * 0.1, "has only the values -0.1 and 0"),
        (lambda y: 1e200 * y, "which is not plausible"),
        (lambda y: 1e-200 * y, "which is not plausible"),
    ],
)
def test_rejects_stuck_saturated_and_repeated_samples(change, said):
    y = 0.01 * np.random.default_rng(0).standard_normal(2000)
    refuse_stuck("gyro", y, 0.01)
    refuse_stuck("gyro", np.round(y / 0.02) * 0.02, 0.01)
    with pytest.raises(InputError, match=said):
        refuse_stuck("gyro", change(y), 0.01)


def test_accepts_coarse_resolution_with_filter_drift_and_short_runs():
    """Of a filtered gyro of 12 bits, 80 % of the samples may be repeated, but averages over 1 s give N within 5 %."""
    g = np.random.default_rng(0)
    white = g.standard_normal(21000)
    for width in (10, 20):
        y = np.convolve(white, np.ones(width), "valid")[:20000]
        refuse_stuck("gyro", np.round(y / y.std()), 0.01)
        refuse_stuck("gyro", 2 * np.round(y / y.std() / 2), 0.01)
    for step in (3.0, 3.5):  # the longest of the runs comes while the drift passes the middle of a step
        for seed in range(5):
            y = np.random.default_rng(seed).standard_normal(20000) / step + 3 * np.linspace(0, 1, 20000)
            refuse_stuck("gyro", np.round(y), 0.01)
    short = white[:2000].copy()
    short[100:115] = short[100]
    refuse_stuck("gyro", short, 0.01)
    refuse_stuck("gyro", np.round(g.uniform(-3, 3, 2000)), 0.01)


@pytest.mark.parametrize(("spacing", "length", "end"), [(3000, 1500, 18000), (380, 340, 12000)])
def test_rejects_log_with_many_stuck_parts(spacing, length, end):
    y = np.random.default_rng(0).standard_normal(20000)
    for start in range(0, end, spacing):
        y[start : start + length] = y[start]
    with pytest.raises(InputError, match=f"in {length} successive samples from 0.00 s on"):
        refuse_stuck("gyro", y, 0.01)


def test_motion_check_accepts_quantised_noise_and_random_walk():
    for seed in range(8):
        for y in (long_noise(seed), long_noise(seed, 0.05), np.round(long_noise(seed) / 0.02) * 0.02):
            refuse_motion("gyro", y, fit_allan(y, DT))


t = np.arange(SIZE) * DT
MOTIONS = {
    "knock": (np.where(np.arange(SIZE) == 9_000, 0.3, 0.0), "times the usual change, at 58.9"),
    "step": (np.where(t > 60, 0.3, 0.0), "times the usual"),
    "swinging": (0.1 * np.sin(2 * np.pi * t / 3), "not the noise of a sensor at rest"),
    "turned by hand": (0.5 * np.exp(-(((t - 40) / 2) ** 2)), "not the noise of a sensor at rest"),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motion_check_rejects_motion_and_names_it(name):
    motion, wanted = MOTIONS[name]
    for seed in range(5):
        y = long_noise(seed) + motion
        with pytest.raises(InputError, match=wanted):
            refuse_motion("gyro", y, fit_allan(y, DT))

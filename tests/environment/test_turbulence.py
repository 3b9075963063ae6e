"""Turbulence against the printed spectra, standard deviations and lengths, whatever the step."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import welch

from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.imperfections import without
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key, key
from trimtab.core.signals import Motion, SurroundingAir
from trimtab.core.time import ms, to_seconds
from trimtab.environment import turbulence
from trimtab.environment.turbulence import FILTERS, FOOT, Turbulence

O = np.zeros(3)
V = 120.0
LOW = 60.0
RUNS, LENGTH = 64, 8192


def motion(height=LOW, speed=V):
    return Motion(np.int64(0), np.array([0.0, 0.0, -height]), O, np.array([speed, 0.0, 0.0]), O, O, O)


def gusts(model, at, runs=RUNS, n=LENGTH):
    """Velocities and rates (runs, n, 6)."""

    def one(run):
        def body(state, k):
            state, gust = model.step(k * model.period, state, at)
            return state, jnp.concatenate([gust.velocity, gust.rate])

        return jax.lax.scan(body, model.init(Key(np.uint32(7), run, 5)), jnp.arange(n, dtype=np.int64))[1]

    return np.asarray(jax.jit(jax.vmap(one))(jnp.arange(runs, dtype=np.uint32)))


def dryden(f, field, b):
    """One-sided densities by f (Hz) of u, v, w, p, q, r, as MIL-F-8785C prints them over the wave number."""
    (Lu, Lv, Lw), (su, sv, sw) = np.asarray(field.lengths), np.asarray(field.sigmas)
    k = 2 * np.pi * f / V
    u = su**2 * 2 * Lu / np.pi / (1 + (Lu * k) ** 2)
    v, w = (s**2 * L / np.pi * (1 + 3 * (L * k) ** 2) / (1 + (L * k) ** 2) ** 2 for s, L in ((sv, Lv), (sw, Lw)))
    p = sw**2 / Lw * 0.8 * (np.pi * Lw / (4 * b)) ** (1 / 3) / (1 + (4 * b * k / np.pi) ** 2)
    q = k**2 / (1 + (4 * b * k / np.pi) ** 2) * w
    r = k**2 / (1 + (3 * b * k / np.pi) ** 2) * v
    return np.stack([u, v, w, p, q, r]) * 2 * np.pi / V


def fold(density, f, rate):
    """What a spectrum is once it is sampled: all that differs by multiples of the rate lies on one another."""
    return sum(density(np.abs(f + k * rate)) for k in range(-400, 401))


def bands(f, *spectra):
    """Means of spectra over bands of a quarter decade, the first cells left out, and how many cells are in each."""
    edges = np.logspace(np.log10(f[4]), np.log10(f[-1]), 12)
    cells = [(f >= a) & (f < b) for a, b in itertools.pairwise(edges)]
    return [np.stack([s[..., c].mean(-1) for c in cells], -1) for s in spectra], np.array([c.sum() for c in cells])


@pytest.mark.thorough
def test_spectra_match_the_specification():
    """Within four standard deviations of what 64 flights of 164 s can tell; Hann's window makes 1.9 cells one."""
    model = to_arrays(Turbulence(period=ms(20), span=12.0))
    rate = 50.0
    f, seen = welch(gusts(model, motion()), rate, nperseg=LENGTH, axis=1, detrend=False)
    field = model.at(LOW)
    (seen, wanted), n = bands(f, seen.mean(0).T, fold(lambda f: dryden(f, field, 12.0), f, rate))
    doubt = np.sqrt(1.9 / (RUNS * n))
    assert (np.abs(seen / wanted - 1) < 4 * doubt + 0.01).all(), np.round((seen / wanted - 1) / doubt, 1)
    assert (doubt < 0.11).all()


@pytest.mark.thorough
@pytest.mark.parametrize("form", list(FILTERS))
@pytest.mark.parametrize("period", [ms(5), ms(50)])
def test_standard_deviation_is_independent_of_period(form, period):
    model = to_arrays(Turbulence(form=form, period=period, exceedance=1e-4))
    at = motion(3000.0)
    seen = gusts(model, at, runs=400, n=3)[..., :3].std((0, 1))
    # the rational forms of von Kármán's spectra hold 97 and 96 % of the variance: what lies beyond their band is lost
    share = {"dryden": (1.0, 1.0, 1.0), "von-karman": (0.9687, 0.9623, 0.9623)}[form]
    np.testing.assert_allclose(seen, np.sqrt(share) * model.at(3000.0).sigmas, rtol=4 / np.sqrt(2 * 400))


@pytest.mark.parametrize("form", list(FILTERS))
def test_filters_match_the_published_spectra(form):
    """|H|² of each filter against the printed spectra: exact for Dryden; within 5 % for von Kármán while L k < 10."""
    Lk = np.logspace(-2, 1, 40)
    s = 1j * Lk
    for name, (numerator, denominator) in FILTERS[form].items():
        H = np.polyval(numerator[::-1], s) / np.polyval(denominator[::-1], s)
        if form == "dryden":
            law = {"along": 2 / (1 + Lk**2), "across": (1 + 3 * Lk**2) / (1 + Lk**2) ** 2}[name]
        else:
            a = (1.339 * Lk) ** 2
            law = {"along": 2 / (1 + a) ** (5 / 6), "across": (1 + 8 / 3 * a) / (1 + a) ** (11 / 6)}[name]
        np.testing.assert_allclose(np.abs(H) ** 2, law, rtol=1e-12 if form == "dryden" else 0.05)


def test_lengths_and_deviations_match_published_values():
    """Low: figures 10 and 11 at 200 ft, 30 kt. High: 1750 ft, and figure 7 at 15 000 ft, 1e-3. Between: a line."""
    model, at = Turbulence(wind=30 * 1852 / 3600), jax.jit(Turbulence.at)
    low = at(model, 200 * FOOT)
    ratio = 0.177 + 0.000823 * 200
    np.testing.assert_allclose(low.lengths, np.array([200 / ratio**1.2, 200 / ratio**1.2, 200]) * FOOT, rtol=1e-12)
    np.testing.assert_allclose(low.sigmas / model.wind, [0.1 / ratio**0.4, 0.1 / ratio**0.4, 0.1], rtol=1e-12)
    high = at(model, 15e3 * FOOT)
    np.testing.assert_allclose(high.lengths, 1750 * FOOT)
    np.testing.assert_allclose(high.sigmas, 8.0 * FOOT, rtol=1e-12)
    np.testing.assert_allclose(at(replace(model, exceedance=1e-5), 80e3 * FOOT).sigmas, 5.1 * FOOT, rtol=1e-12)
    below, above = at(model, 1000 * FOOT), at(model, 2000 * FOOT)
    np.testing.assert_allclose(at(model, 1250 * FOOT).sigmas, 0.75 * below.sigmas + 0.25 * above.sigmas, rtol=1e-12)
    np.testing.assert_allclose(below.lengths, np.full(3, 1000 * FOOT), rtol=1e-3)
    for height in (-50.0, 3.0):
        np.testing.assert_array_equal(at(model, height).lengths, at(model, 10 * FOOT).lengths)


@pytest.mark.thorough
def test_step_matches_exact_discretisation():
    """The mean follows scipy's exponential; what noise adds keeps the steady covariance."""
    filter = FILTERS["von-karman"]["across"]
    A, C = turbulence._system(filter), turbulence._output(filter)
    frequency, lag, dt = 3.0, 0.05, 0.02
    whole = np.zeros((4, 4))
    whole[:3, :3] = A * frequency
    whole[3] = np.append(C, -1.0) / lag
    start = jnp.array([0.3, -0.2, 0.5, 0.1])
    moved = turbulence._advance(filter, start, frequency, lag, dt, jnp.zeros(4))
    np.testing.assert_allclose(moved, expm(whole * dt) @ start, rtol=1e-11)
    root = turbulence._steady_root(filter)
    P = root @ root.T
    noise = np.stack([turbulence._advance(filter, jnp.zeros(3), frequency, None, dt, z) for z in np.eye(3)], 1)
    F = expm(A * frequency * dt)
    np.testing.assert_allclose(F @ P @ F.T + noise @ noise.T, P, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
def test_two_half_steps_match_one_full_step():
    """Of the component, its rate and the time between them: 4 % is four times what 20 000 pairs can tell."""
    half, whole = (to_arrays(Turbulence(period=p)) for p in (ms(50), ms(100)))
    a = gusts(half, motion(), runs=40, n=1001)[:, ::2]
    b = gusts(whole, motion(), runs=40, n=501)
    for lag in (0, 1):
        one, two = ((x[:, 1 : 501 - lag] * x[:, 1 + lag : 501]).mean((0, 1)) for x in (a, b))
        scale = (b**2).mean((0, 1))
        assert (np.abs(one - two) < 0.08 * scale).all(), (one - two) / scale


@pytest.mark.thorough
def test_gust_rates_match_velocity_gradients():
    """A gust down that grows along the way lifts the tail: slowly, q = -dw/dx and r = dv/dx."""
    model = to_arrays(Turbulence(period=ms(1), span=1.0))
    g = gusts(model, motion(3000.0), runs=1, n=8000)[0]
    n = 500
    slope = (g[n:, :3] - g[:-n, :3]) / (n * to_seconds(ms(1)) * V)
    pitch, yaw = (np.convolve(g[1:, i], np.full(n, 1 / n), "valid") for i in (4, 5))
    for turn, of_air in ((pitch, -slope[:, 2]), (yaw, slope[:, 1])):
        assert np.corrcoef(turn, of_air)[0, 1] > 0.9
        assert np.std(turn) == pytest.approx(np.std(of_air), rel=0.1)


@pytest.mark.thorough
def test_reproducible_per_seed_and_zero_when_switched_off():
    model = to_arrays(Turbulence())
    a, b = gusts(model, motion(), runs=2, n=50)
    again = gusts(model, motion(), runs=1, n=50)[0]
    np.testing.assert_allclose(a, again, rtol=1e-12, atol=1e-14)  # lanes of XLA round sums differently
    assert not np.allclose(a, b)
    assert not gusts(without(model, "turbulence"), motion(), runs=1, n=50).any()


@pytest.mark.thorough
def test_turbulence_uses_airspeed_relative_to_mean_wind():
    """In a tailwind, a vehicle meets the gusts more slowly. Without air data of the vehicle the air is still."""
    wind = np.array([V - 40.0, 0.0, 0.0])
    at = replace(motion(), air=SurroundingAir(height=np.float64(LOW), velocity=wind, rate=O))
    model = to_arrays(Turbulence(period=ms(20)))
    np.testing.assert_allclose(
        gusts(model, at, runs=1, n=20), gusts(model, motion(speed=40.0), runs=1, n=20), rtol=1e-12
    )


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("form", list(FILTERS))
def test_turbulence_in_c_matches_jax(form):
    model, at = to_arrays(Turbulence(form=form)), motion()

    def fly(model, run):
        def body(state, k):
            state, gust = model.step(k * model.period, state, at)
            return state, gust

        return jax.lax.scan(body, model.init(key(3, 0).at("x")), jnp.arange(200, dtype=np.int64))[1]

    wanted, got = jax.jit(fly)(model, 0), compile(fly, model, 0)(model, 0)
    for a, b in zip(jax.tree.leaves(wanted), jax.tree.leaves(got), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)

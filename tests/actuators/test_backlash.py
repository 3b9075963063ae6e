"""Gaps: describing functions in closed form, and properties for any command."""

import jax
import numpy as np
import pytest

from trimtab.actuators.backlash import Backlash, DeadBand

N = 4000
PHASE = 2 * np.pi * np.arange(2 * N) / N


def fly(stage, command):
    """What comes out of a stage for each number of a command."""
    return np.asarray(
        jax.jit(lambda u: jax.lax.scan(lambda s, v: stage.step(s, v, 1e-3), stage.init(0.0), u)[1].value)(command)
    )


def first_harmonic(out, amplitude):
    """Of the second period, over that of the sine that went in: a complex gain."""
    return 2j / N * np.sum(out[N:] * np.exp(-1j * PHASE[N:])) / amplitude


@pytest.mark.parametrize("ratio", [1.2, 2.0, 5.0])
def test_backlash_matches_its_describing_function(ratio):
    """Gelb and Vander Velde, appendix B; ratio: amplitude over half of the gap."""
    b = 0.3
    A = ratio * b
    k = 1 - 2 * b / A
    real = (np.pi / 2 + np.arcsin(k) + k * np.sqrt(1 - k**2)) / np.pi
    imaginary = -4 * b / (np.pi * A) * (1 - b / A)
    gain = first_harmonic(fly(Backlash(width=2 * b), A * np.sin(PHASE)), A)
    assert gain == pytest.approx(real + 1j * imaginary, abs=2e-5)


@pytest.mark.parametrize("ratio", [1.2, 2.0, 5.0])
def test_dead_band_matches_its_describing_function(ratio):
    d = 0.3
    A, k = ratio * d, 1 / ratio
    shifted = 1 - 2 / np.pi * (np.arcsin(k) + k * np.sqrt(1 - k**2))
    assert first_harmonic(fly(DeadBand(half_width=d), A * np.sin(PHASE)), A) == pytest.approx(shifted, abs=2e-5)
    whole = 1 - 2 / np.pi * (np.arcsin(k) - k * np.sqrt(1 - k**2))
    cut = fly(DeadBand(half_width=d, cuts=True), A * np.sin(PHASE))
    assert first_harmonic(cut, A) == pytest.approx(whole, abs=1e-3)  # a jump lies between two samples


def test_backlash_output_moves_only_when_pushed():
    u = np.random.default_rng(0).normal(0, 1, 500)
    y = fly(Backlash(width=1.0), u)
    assert (np.abs(y - u) <= 0.5 + 1e-15).all()
    moved = np.diff(np.r_[0.0, y]) != 0
    assert 50 < moved.sum() < 450
    np.testing.assert_allclose(np.abs(y - u)[moved], 0.5)  # it moves only when it is pushed


def test_zero_gap_passes_the_command_unchanged():
    u = np.random.default_rng(1).normal(0, 1, 50)
    for stage in (Backlash(width=0.0), DeadBand(half_width=0.0), DeadBand(half_width=0.0, cuts=True)):
        np.testing.assert_array_equal(fly(stage, u), u)

"""Noise of every kind passes; knocks, steps and motions don't."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.identify.allan import fit_allan, refuse_motion

DT, N, K = 0.0065536, 1.0e-3, 1.0e-4
SIZE = 20_000


def noise(seed, walk=K):
    g = np.random.default_rng(seed)
    return g.standard_normal(SIZE) * N / np.sqrt(DT) + np.cumsum(g.standard_normal(SIZE)) * walk * np.sqrt(DT)


def test_noise_passes_also_quantised_and_with_a_walk_that_leads_far():
    for seed in range(30):
        for y in (noise(seed), noise(seed, 0.05), np.round(noise(seed) / 0.02) * 0.02):
            refuse_motion("gyro", y, fit_allan(y, DT))


t = np.arange(SIZE) * DT
MOTIONS = {
    "knock": (np.where(np.arange(SIZE) == 9_000, 0.3, 0.0), "times the usual, 58.9"),
    "step": (np.where(t > 60, 0.3, 0.0), "times the usual"),
    "swinging": (0.1 * np.sin(2 * np.pi * t / 3), "not the noise of a still sensor"),
    "turned by hand": (0.5 * np.exp(-(((t - 40) / 2) ** 2)), "not the noise of a still sensor"),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motion_is_refused_with_what_was_seen(name):
    motion, wanted = MOTIONS[name]
    for seed in range(5):
        y = noise(seed) + motion
        with pytest.raises(InputError, match=wanted):
            refuse_motion("gyro", y, fit_allan(y, DT))

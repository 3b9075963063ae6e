"""Transport delay: whole periods to the bit, fractions as the exact sampled system has them."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

from trimtab.actuators.transport_delay import TransportDelay
from trimtab.core.errors import InputError
from trimtab.core.time import ms

DT = 0.01


def fly(stage, command, rest=0.0):
    """What comes out of a stage for each number of a command."""
    return np.asarray(
        jax.jit(lambda u: jax.lax.scan(lambda s, v: stage.step(s, v, DT), stage.init(rest), u)[1].value)(command)
    )


@pytest.mark.parametrize("n", [0, 1, 3, 7])
def test_whole_period_delay_shifts_bit_for_bit(n):
    u = np.random.default_rng(0).normal(0, 1, 40)
    got = fly(TransportDelay(delay=n * DT, capacity=9), u, rest=2.0)
    np.testing.assert_array_equal(got, np.r_[np.full(n, 2.0), u][:40])


@pytest.mark.parametrize("delay", [0.3, 1.5, 4.9])
def test_ramp_is_delayed_by_fractional_periods(delay):
    t = DT * np.arange(50)
    got = fly(TransportDelay(delay=delay * DT), t)
    np.testing.assert_allclose(got[10:], t[10:] - delay * DT, atol=1e-14)


def test_fractional_delay_conserves_the_impulse():
    """An integrator behind it ends where that behind the exactly delayed held command ends; a lag nearly does."""
    u = np.r_[np.random.default_rng(2).normal(0, 1, 30), np.zeros(10)]
    late, A, B = 0.34, np.array([[-2.0]]), 1.0
    got = fly(TransportDelay(delay=(2 + late) * DT), u)
    assert got.sum() == pytest.approx(u.sum(), abs=1e-13)
    # x' = -2 x + u(t - delay): the exact sampled system, Åström and Wittenmark section 2.3
    whole, early = expm(A * DT)[0, 0], expm(A * (1 - late) * DT)[0, 0]
    newer, older = B * (1 - early) / 2, B * early * (1 - expm(A * late * DT)[0, 0]) / 2
    x = y = 0.0
    for k in range(40):
        a, b = (u[k - n] if k >= n else 0.0 for n in (2, 3))
        x = whole * x + newer * a + older * b
        y = whole * y + got[k] * (1 - whole) / 2
    assert y == pytest.approx(x, rel=0.02)


def test_rejects_delay_beyond_the_capacity():
    TransportDelay(delay=0.0629, capacity=64).check_period(ms(1))
    with pytest.raises(InputError, match="set capacity to 82"):
        TransportDelay(delay=0.08, capacity=64).check_period(ms(1))

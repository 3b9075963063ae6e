"""Jitter margins: the source's numbers, closed forms, and flights with delays that vary as they like."""

import numpy as np
import pytest
from design import hovercraft_loops as loops

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import loop_of_polynomials
from trimtab.design.margins import delay_margin, jitter_margin, jitter_margin_samples


@pytest.mark.parametrize(("loop", "milliseconds"), [(loops.zero, 276), (loops.forward, 172), (loops.reverse, 365)])
def test_check_25_jitter_margins(loop, milliseconds):
    """Specification of the hovercraft, check 25 and section 4.4, [1] section 5.3.3: within 2 %."""
    assert jitter_margin(loop()) == pytest.approx(milliseconds * 1e-3, rel=0.02)


def test_first_and_second_order_by_hand():
    """T = a/(s + a): w |T| rises to a.  T = w^2/(s^2 + 2 z w s + w^2): highest at w, w/(2 z)."""
    assert jitter_margin(loop_of_polynomials([2.5], [1.0, 0.0])) == pytest.approx(0.4, rel=1e-12)
    w, z = 3.0, 1e-3
    assert jitter_margin(loop_of_polynomials([w * w], [1.0, 2 * z * w, 0.0])) == pytest.approx(2 * z / w, rel=1e-9)


def test_with_a_constant_delay_it_falls_to_nothing_at_the_delay_margin():
    loop = loops.forward()
    limit = delay_margin(loop).delay
    delays = limit * np.array([0.0, 0.2, 0.5, 0.9, 0.999])
    found = np.array([jitter_margin(loop, delay=d) for d in delays])
    assert (np.diff(found) < 0).all()
    assert found[0] == jitter_margin(loop)
    assert jitter_margin(loop, delay=limit) == 0.0
    assert found[-1] < 0.01 * found[0]
    # a varying delay may as well stay: the theorem promises nothing that a constant delay breaks
    assert (delays + found <= limit).all()
    # oracle: brute force over a fine grid
    w = np.geomspace(1e-3, 1e4, 400_000)
    for d, value in zip(delays[:4], found[:4], strict=True):
        L = loop.frequency_response(w)[:, 0, 0] * np.exp(-1j * w * d)
        assert value == pytest.approx(1 / (w * np.abs(L / (1 + L))).max(), rel=1e-4)


def test_samples_by_hand():
    """L = k/(z - 1): |z - 1| |T| is highest at z = -1, 2k/(2 - k)."""
    loop = loop_of_polynomials([0.3], [1.0, 0.0]).discretise(1.0)
    assert jitter_margin_samples(loop) == pytest.approx(1.7 / 0.6, rel=1e-9)


def test_samples_of_a_fast_clock_are_the_continuous_margin():
    loop, h = loops.forward(), 1e-3
    assert jitter_margin_samples(loop.discretise(h)) * h == pytest.approx(jitter_margin(loop), rel=0.01)


@pytest.mark.parametrize("pattern", ["random", "constant", "saw"])
def test_flights_with_varying_delays_inside_the_margin_come_to_rest(pattern):
    loop = loops.forward().discretise(0.02)
    N = int(np.ceil(jitter_margin_samples(loop)) - 1)
    assert N == 8  # 172 ms in periods of 20 ms
    assert _late(loop, N, pattern) < 1e-6
    assert _late(loop, 2 * N, "constant") > 1.0  # the test can fail: far outside it does not


def _late(loop, N, pattern, steps=3000):
    """Size of the signals of x+ = A x - B y(k - delay(k)) after many steps from an error of 1."""
    delay = {
        "random": np.random.default_rng(3).integers(0, N + 1, steps),
        "constant": np.full(steps, N),
        "saw": np.arange(steps) % (N + 1),
    }[pattern]
    x, history = np.array([0.3, -1.0]), []
    for k in range(steps):
        history.append(loop.C @ x)
        x = loop.A @ x - loop.B @ history[max(k - delay[k], 0)]
        if np.abs(history[-1]) > 1e6:
            break
    return np.abs(history[-50:]).max()


def test_a_direct_part_leaves_no_margin_and_misuse_is_refused():
    assert jitter_margin(loop_of_polynomials([0.5, 1.0], [1.0, 0.0])) == 0.0
    with pytest.raises(InputError, match="continuous"):
        jitter_margin_samples(loops.forward())
    with pytest.raises(InputError, match="sampled"):
        jitter_margin(loops.forward().discretise(0.1))
    with pytest.raises(InputError, match="delay -1"):
        jitter_margin(loops.forward(), delay=-1.0)

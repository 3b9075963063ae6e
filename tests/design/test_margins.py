"""Margins of delay, jitter and packet loss: the source's numbers, closed forms, delayed loops, patterns of losses."""

import itertools
import math

import numpy as np
import pytest
from design import hovercraft_loops as loops

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import loop_of_gain, loop_of_polynomials
from trimtab.design.margins import (
    critical_loss,
    delay_margin,
    jitter_margin,
    jitter_margin_samples,
    mean_square,
    mean_square_growth,
    mean_squares,
)


@pytest.mark.parametrize(
    ("loop", "milliseconds"),
    [(loops.zero, 433), (loops.forward, 191), (loops.spin, 279), (loops.reverse, 380)],
)
def test_delay_margins_match_the_source(loop, milliseconds):
    """[1] section 5.3.3, from the loop's gain and phase: within 2 %."""
    assert delay_margin(loop()).delay == pytest.approx(milliseconds * 1e-3, rel=0.02)


def test_forward_crossover_and_phase_margin():
    """[1] section 5.3.3: crossover 6.244 rad/s, phase margin 68.4 deg."""
    (first,) = delay_margin(loops.forward()).crossovers
    assert first.frequency == pytest.approx(6.244, abs=1e-3)
    assert math.degrees(first.phase_margin) == pytest.approx(68.4, abs=0.05)


@pytest.mark.parametrize("loop", [loops.zero, loops.forward, loops.reverse, loops.spin])
def test_delayed_loop_poles_cross_axis_at_delay_margin(loop):
    found = delay_margin(loop()).delay
    assert loops.rightmost(loop(), 0.98 * found) < -1e-3
    assert loops.rightmost(loop(), 1.02 * found) > 1e-3
    assert loops.rightmost(loop(), found) == pytest.approx(0, abs=1e-6)


def test_integrator_delay_margin_matches_analytic_value():
    found = delay_margin(loop_of_polynomials([3.0], [1.0, 0.0]))
    assert found.delay == pytest.approx(math.pi / 6, rel=1e-12)
    assert found.crossovers[0].frequency == pytest.approx(3.0, rel=1e-12)


def test_shortest_delay_of_several_crossovers_decides():
    """An integrator beside a light mode that peaks above 1 far beyond the first crossover: L = 1/s + c s/(mode)."""
    zeta, w, c = 0.01, 30.0, 1.2
    mode = np.poly1d([1.0, 2 * zeta * w, w * w])
    num, den = mode + np.poly1d([c, 0, 0]), mode * np.poly1d([1.0, 0])
    found = delay_margin(loop_of_polynomials(num.c, den.c))
    assert len(found.crossovers) == 3
    assert found.delay < 0.1  # the integrator's own crossover alone would say pi/2
    # oracle: real roots of |N(j w)|^2 - |D(j w)|^2, each squared size a polynomial N(s) N(-s)
    mirror = [p * np.poly1d(p.c * (-1.0) ** np.arange(p.order, -1, -1)) for p in (num, den)]
    s = (mirror[0] - mirror[1]).roots
    wanted = np.sort([r.imag for r in s if abs(r.real) < 1e-6 and r.imag > 0])
    np.testing.assert_allclose(sorted(k.frequency for k in found.crossovers), wanted, rtol=1e-7)
    for crossover in found.crossovers:  # a pair of poles sits on the axis at each
        L = num(1j * crossover.frequency) / den(1j * crossover.frequency)
        assert abs(1 + L * np.exp(-1j * crossover.frequency * crossover.delay)) < 1e-9


def test_finds_crossovers_of_a_peak_just_above_one():
    zeta, w = 1e-3, 11.0
    peak = 2 * zeta * math.sqrt(1 - zeta**2)
    above = delay_margin(loop_of_polynomials([-peak * w * w * (1 + 1e-6)], [1, 2 * zeta * w, w * w]))
    below = delay_margin(loop_of_polynomials([-peak * w * w * (1 - 1e-6)], [1, 2 * zeta * w, w * w]))
    assert len(above.crossovers) == 2
    assert below == (math.inf, ())


def test_two_signal_loop_margin_uses_eigenvalue_loci():
    """Two integrators coupled by a rotation: eigenvalues k exp(+-j angle)/(j w), so margin (pi/2 - angle)/k."""
    angle, k = 0.7, 2.0
    turn = k * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    found = delay_margin(loop_of_gain(np.zeros((2, 2)), np.eye(2), -turn))
    assert found.delay == pytest.approx((math.pi / 2 - angle) / k, rel=1e-9)


def test_delay_margin_without_crossover_and_with_feedthrough():
    assert delay_margin(loop_of_polynomials([0.5], [1.0, 1.0])).delay == math.inf
    assert delay_margin(loop_of_polynomials([2.0, 1.0], [1.0, 1.0])).delay == 0.0


def test_delay_margin_rejects_unstable_and_sampled_loops():
    with pytest.raises(InputError, match="not stable even without delay; it has the pole \\+2"):
        delay_margin(loop_of_polynomials([-3.0], [1.0, 1.0]))
    with pytest.raises(InputError, match="sampled"):
        delay_margin(loop_of_polynomials([1.0], [1.0, 0.0]).discretise(0.1))


@pytest.mark.parametrize(("loop", "milliseconds"), [(loops.zero, 276), (loops.forward, 172), (loops.reverse, 365)])
def test_jitter_margins_match_the_source(loop, milliseconds):
    """[1] section 5.3.3, from the loop's gain and phase: within 2 %."""
    assert jitter_margin(loop()) == pytest.approx(milliseconds * 1e-3, rel=0.02)


def test_first_and_second_order_jitter_margins_match_analytic():
    """T = a/(s + a): w |T| rises to a.  T = w^2/(s^2 + 2 z w s + w^2): highest at w, w/(2 z)."""
    assert jitter_margin(loop_of_polynomials([2.5], [1.0, 0.0])) == pytest.approx(0.4, rel=1e-12)
    w, z = 3.0, 1e-3
    assert jitter_margin(loop_of_polynomials([w * w], [1.0, 2 * z * w, 0.0])) == pytest.approx(2 * z / w, rel=1e-9)


@pytest.mark.thorough
def test_jitter_margin_falls_to_zero_at_the_delay_margin():
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


def test_sampled_jitter_margin_matches_analytic_value():
    """L = k/(z - 1): |z - 1| |T| is highest at z = -1, 2k/(2 - k)."""
    loop = loop_of_polynomials([0.3], [1.0, 0.0]).discretise(1.0)
    assert jitter_margin_samples(loop) == pytest.approx(1.7 / 0.6, rel=1e-9)


def test_fast_sampled_jitter_margin_approaches_the_continuous():
    loop, h = loops.forward(), 1e-3
    assert jitter_margin_samples(loop.discretise(h)) * h == pytest.approx(jitter_margin(loop), rel=0.01)


@pytest.mark.parametrize("pattern", ["random", "constant", "saw"])
def test_varying_delays_inside_the_margin_stay_stable(pattern):
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


def test_jitter_margin_with_feedthrough_and_invalid_arguments():
    assert jitter_margin(loop_of_polynomials([0.5, 1.0], [1.0, 0.0])) == 0.0
    with pytest.raises(InputError, match="continuous"):
        jitter_margin_samples(loops.forward())
    with pytest.raises(InputError, match="sampled"):
        jitter_margin(loops.forward().discretise(0.1))
    with pytest.raises(InputError, match="delay must be at least 0 s, got -1"):
        jitter_margin(loops.forward(), delay=-1.0)


def by_every_pattern(a, q, steps, start, tries):
    """E x^2 after `steps`, as the sum over all patterns of lost steps, x propagated through each."""
    total = 0.0
    for pattern in itertools.product((True, False), repeat=steps):
        weight, square = 1.0, start
        for lost in pattern:
            weight *= q**tries if lost else 1 - q**tries
            square = (a * a * square if lost else 0.0) + 1.0
        total += weight * square
    return total


@pytest.mark.parametrize(("a", "q"), [(1.5, 0.6), (1.5, 2 / 3), (-3.0, 0.4), (0.5, 0.9)])
def test_mean_squares_match_enumerated_loss_patterns(a, q):
    """[1] eqs. 5.2, 5.3: exact."""
    found = mean_squares(a, q, 9, start=2.0)
    for k in range(10):
        assert found[k] == pytest.approx(by_every_pattern(a, q, k, 2.0, 2), rel=1e-13)


def test_mean_square_limit_under_packet_loss():
    """[1] eq. 5.3: 1/(1 - a^2 q^2), 5.263 at a = 1.5, q = 0.6; without bound from |a| q = 1 on."""
    assert mean_square(1.5, 0.6) == pytest.approx(1 / 0.19, rel=1e-14)
    assert mean_squares(1.5, 0.6, 400)[-1] == pytest.approx(1 / 0.19, rel=1e-13)
    np.testing.assert_array_equal(np.isinf(mean_square(2.0, [0.49, 0.5, 0.51])), [False, True, True])
    np.testing.assert_allclose(np.diff(mean_squares(2.0, 0.5, 50)), 1.0)  # at the bound it grows by one each step
    assert mean_squares(2.0, 0.51, 1000)[-1] > 1e15


@pytest.mark.parametrize("retransmissions", [0, 1, 3])
def test_mean_squares_with_any_number_of_retransmissions(retransmissions):
    a, q = 1.4, 0.6
    found = mean_squares(a, q, 6, retransmissions=retransmissions)
    assert found[-1] == pytest.approx(by_every_pattern(a, q, 6, 0.0, 1 + retransmissions), rel=1e-13)
    limit = critical_loss(a, retransmissions=retransmissions)
    assert mean_square_growth(a, limit, retransmissions=retransmissions) == pytest.approx(1.0)


def test_critical_loss_probability_matches_formula():
    np.testing.assert_allclose(critical_loss([-4.0, 1.25, 0.3]), [0.25, 0.8, 1.0])


def test_packet_loss_functions_reject_invalid_arguments():
    with pytest.raises(InputError, match="q within"):
        mean_square_growth(1.5, 1.2)
    with pytest.raises(InputError, match="a must be finite"):
        mean_square_growth(np.nan, 0.2)
    with pytest.raises(InputError, match="whole number"):
        mean_square_growth(1.5, 0.2, retransmissions=-1)

"""Delay margins: the source's numbers, closed forms, and the poles of the delayed loop itself."""

import math

import numpy as np
import pytest
from design import hovercraft_loops as loops

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import loop_of_gain, loop_of_polynomials
from trimtab.design.margins import delay_margin


@pytest.mark.parametrize(
    ("loop", "milliseconds"),
    [(loops.zero, 433), (loops.forward, 191), (loops.spin, 279), (loops.reverse, 380)],
)
def test_check_25_delay_margins(loop, milliseconds):
    """Specification of the hovercraft, check 25 and section 4.4, [1] section 5.3.3: within 2 %."""
    assert delay_margin(loop()).delay == pytest.approx(milliseconds * 1e-3, rel=0.02)


def test_forward_crossover_and_phase_margin():
    """[1] section 5.3.3: crossover 6.244 rad/s, phase margin 68.4 deg."""
    (first,) = delay_margin(loops.forward()).crossovers
    assert first.frequency == pytest.approx(6.244, abs=1e-3)
    assert math.degrees(first.phase_margin) == pytest.approx(68.4, abs=0.05)


@pytest.mark.parametrize("loop", [loops.zero, loops.forward, loops.reverse, loops.spin])
def test_poles_of_the_delayed_loop_cross_exactly_there(loop):
    found = delay_margin(loop()).delay
    assert loops.rightmost(loop(), 0.98 * found) < -1e-3
    assert loops.rightmost(loop(), 1.02 * found) > 1e-3
    assert loops.rightmost(loop(), found) == pytest.approx(0, abs=1e-6)


def test_an_integrator_by_hand():
    found = delay_margin(loop_of_polynomials([3.0], [1.0, 0.0]))
    assert found.delay == pytest.approx(math.pi / 6, rel=1e-12)
    assert found.crossovers[0].frequency == pytest.approx(3.0, rel=1e-12)


def test_of_several_crossovers_the_shortest_delay_decides():
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


def test_a_peak_that_hardly_passes_one_is_not_missed():
    zeta, w = 1e-3, 11.0
    peak = 2 * zeta * math.sqrt(1 - zeta**2)
    above = delay_margin(loop_of_polynomials([-peak * w * w * (1 + 1e-6)], [1, 2 * zeta * w, w * w]))
    below = delay_margin(loop_of_polynomials([-peak * w * w * (1 - 1e-6)], [1, 2 * zeta * w, w * w]))
    assert len(above.crossovers) == 2
    assert below == (math.inf, ())


def test_of_two_signals_the_eigenvalue_loci_decide():
    """Two integrators coupled by a rotation: eigenvalues k exp(+-j angle)/(j w), so margin (pi/2 - angle)/k."""
    angle, k = 0.7, 2.0
    turn = k * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    found = delay_margin(loop_of_gain(np.zeros((2, 2)), np.eye(2), -turn))
    assert found.delay == pytest.approx((math.pi / 2 - angle) / k, rel=1e-9)


def test_no_crossover_no_limit_and_a_direct_part_of_one_none_at_all():
    assert delay_margin(loop_of_polynomials([0.5], [1.0, 1.0])).delay == math.inf
    assert delay_margin(loop_of_polynomials([2.0, 1.0], [1.0, 1.0])).delay == 0.0


def test_refusals():
    with pytest.raises(InputError, match="not stable without a delay: pole \\+2"):
        delay_margin(loop_of_polynomials([-3.0], [1.0, 1.0]))
    with pytest.raises(InputError, match="sampled"):
        delay_margin(loop_of_polynomials([1.0], [1.0, 0.0]).discretise(0.1))

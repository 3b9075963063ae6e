"""Packet loss: the recursion of the mean square against every pattern of losses there can be."""

import itertools

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.margins import critical_loss, mean_square, mean_square_growth, mean_squares


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
def test_check_25_packet_loss_recursion(a, q):
    """Specification of the hovercraft, check 25, [1] eqs. 5.2, 5.3: exact."""
    found = mean_squares(a, q, 9, start=2.0)
    for k in range(10):
        assert found[k] == pytest.approx(by_every_pattern(a, q, k, 2.0, 2), rel=1e-13)


def test_check_25_packet_loss_limit():
    """[1] eq. 5.3: 1/(1 - a^2 q^2), 5.263 at a = 1.5, q = 0.6; without bound from |a| q = 1 on."""
    assert mean_square(1.5, 0.6) == pytest.approx(1 / 0.19, rel=1e-14)
    assert mean_squares(1.5, 0.6, 400)[-1] == pytest.approx(1 / 0.19, rel=1e-13)
    np.testing.assert_array_equal(np.isinf(mean_square(2.0, [0.49, 0.5, 0.51])), [False, True, True])
    np.testing.assert_allclose(np.diff(mean_squares(2.0, 0.5, 50)), 1.0)  # at the bound it grows by one each step
    assert mean_squares(2.0, 0.51, 1000)[-1] > 1e15


@pytest.mark.parametrize("retransmissions", [0, 1, 3])
def test_other_numbers_of_retransmissions(retransmissions):
    a, q = 1.4, 0.6
    found = mean_squares(a, q, 6, retransmissions=retransmissions)
    assert found[-1] == pytest.approx(by_every_pattern(a, q, 6, 0.0, 1 + retransmissions), rel=1e-13)
    limit = critical_loss(a, retransmissions=retransmissions)
    assert mean_square_growth(a, limit, retransmissions=retransmissions) == pytest.approx(1.0)


def test_critical_loss():
    np.testing.assert_allclose(critical_loss([-4.0, 1.25, 0.3]), [0.25, 0.8, 1.0])


def test_refusals():
    with pytest.raises(InputError, match="q in"):
        mean_square_growth(1.5, 1.2)
    with pytest.raises(InputError, match="finite pole"):
        mean_square_growth(np.nan, 0.2)
    with pytest.raises(InputError, match="whole number"):
        mean_square_growth(1.5, 0.2, retransmissions=-1)

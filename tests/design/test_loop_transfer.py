"""Loops from polynomials, gains, laws and vehicles, against hand-written transfer functions."""

import numpy as np
import pytest
from design import hovercraft_loops as loops

from trimtab.core.errors import InputError
from trimtab.design.loop_transfer import FeedbackLoop, loop_of_gain, loop_of_law, loop_of_polynomials
from trimtab.laws.spin import SpinSupervisorState, SupervisedSpin
from trimtab.laws.velocity import ForwardMomentum, ReverseMomentum, ZeroVelocity
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

W = np.geomspace(0.05, 50, 17)


def test_loop_of_polynomials_matches_the_transfer_function():
    loop = loop_of_polynomials([2.0, 1.0], [1.0, 0.3, 4.0, 0.0])
    s = 1j * W
    np.testing.assert_allclose(
        loop.frequency_response(W)[:, 0, 0], (2 * s + 1) / (s**3 + 0.3 * s**2 + 4 * s), rtol=1e-12
    )
    np.testing.assert_allclose(loop_of_polynomials([0.5], [2.0]).frequency_response(W)[:, 0, 0], 0.25)
    closed = loop.complementary_sensitivity()
    L = loop.frequency_response(W)
    np.testing.assert_allclose(closed.frequency_response(W), L / (1 + L), rtol=1e-10)


def test_loop_with_direct_feedthrough_is_closed_correctly():
    loop = loop_of_polynomials([1.0, 3.0], [2.0, 1.0])
    L = loop.frequency_response(W)
    np.testing.assert_allclose(loop.complementary_sensitivity().frequency_response(W), L / (1 + L), rtol=1e-12)
    with pytest.raises(InputError, match="no inverse"):
        loop_of_polynomials([-1.0, 3.0], [1.0, 1.0]).complementary_sensitivity()


@pytest.mark.thorough("law1-forward", "law2-reverse")
@pytest.mark.parametrize(
    ("law", "by_hand"),
    [
        (ZeroVelocity(k1=1.0, k2=2.5), loops.zero),
        (ForwardMomentum(k1=1.0, k2=4.0, reference=2.8), loops.forward),
        (ReverseMomentum(k1=1.5, k2=1.0, theta=1.44, reference=-1.98), loops.reverse),
    ],
)
def test_hovercraft_loop_matches_hand_written_lateral_loop(law, by_hand):
    found = loop_of_law(Hovercraft(), law, law.equilibrium()).frequency_response(W)
    np.testing.assert_allclose(found[:, 1, 1], by_hand().frequency_response(W)[:, 0, 0], rtol=1e-9)
    np.testing.assert_allclose(found[:, 0, 0], law.k1 / (2.6j * W), rtol=1e-9)
    np.testing.assert_allclose(found[:, [0, 1], [1, 0]], 0, atol=1e-12)


@pytest.mark.thorough
def test_law_with_modes_gives_the_loop_of_one_mode():
    law, trim = SupervisedSpin(), HovercraftState(yaw_rate=3.0)
    spins = SpinSupervisorState(mode=np.int32(1), switches=np.int32(1))
    found = loop_of_law(Hovercraft(), law, trim, spins)
    np.testing.assert_allclose(found.frequency_response(W), loops.spin().frequency_response(W), rtol=1e-9, atol=1e-12)
    with pytest.raises(InputError, match="must be constant at this state"):
        loop_of_law(Hovercraft(), law, HovercraftState(surge_velocity=1.0, yaw_rate=3.0), spins)


def test_discretised_loop_matches_the_exact_step():
    a, h = 1.5, 0.1
    loop = loop_of_gain([[a]], [[2.0]], [[-3.0]]).discretise(h)
    np.testing.assert_allclose(loop.A, np.exp(a * h))
    np.testing.assert_allclose(loop.B, 2 * (np.exp(a * h) - 1) / a)
    z = np.exp(1j * h)
    np.testing.assert_allclose(loop.frequency_response(1.0)[0, 0, 0], 3 * loop.B[0, 0] / (z - np.exp(a * h)))
    with pytest.raises(InputError, match="continuous"):
        loop.discretise(h)


def test_unstable_poles_exclude_hidden_poles():
    assert loops.zero().unstable_poles() == ()  # a pole at 0 that neither moves nor is seen
    bad = loop_of_gain([[0.5, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[-0.2, 0.0]])
    assert bad.unstable_poles() == pytest.approx((0.3,))
    integrator = FeedbackLoop(*(np.array(m, float) for m in ([[0.0]], [[1.0]], [[0.0]], [[0.0]])))
    assert integrator.unstable_poles() == ()
    assert loop_of_gain([[0.0]], [[1.0]], [[-3.0]]).discretise(1.0).unstable_poles() == pytest.approx((-2.0,))


def test_frequency_grid_is_dense_at_a_lightly_damped_mode():
    w, zeta = 7.0, 1e-4
    grid = loop_of_polynomials([1e-3], [1, 2 * zeta * w, w * w]).grid()
    assert (np.abs(grid - w) < zeta * w).sum() > 20
    assert grid[0] < 1e-3 * w
    assert grid[-1] > 1e3 * w


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: loop_of_polynomials([1, 0, 0], [1, 2]), "not a proper"),
        (lambda: loop_of_polynomials([1], [0]), "not a proper"),
        (lambda: loop_of_gain([[1.0]], [[1.0]], [[1.0, 2.0]]), "don't fit"),
    ],
)
def test_rejects_invalid_loops(make, says):
    with pytest.raises(InputError, match=says):
        make()

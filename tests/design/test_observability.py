"""Gramians with answers known by hand."""

import numpy as np
import pytest
from estimators.flights import DT, rest, ticks, weave

from trimtab.core.errors import InputError
from trimtab.design.observability import constant_rank, observability, observability_gramian
from trimtab.estimators.inertial.coupled import coupled_transition

SIGMAS = np.array([0.1, 0.5, 0.5, 1.0, 1.0, 0.02, 0.2, 0.2])


def test_constant_velocity_gramian_matches_analytic_sum():
    """Sum of [1, t]' [1, t] / r at t = 0, 1, 2."""
    F, H, R = np.array([[1.0, 1], [0, 1]]), np.array([[1.0, 0]]), np.array([[0.5]])
    G = observability_gramian([F, F], [H] * 3, [R] * 3)
    np.testing.assert_allclose(G, 2 * np.array([[3.0, 3], [3, 5]]), rtol=1e-14)
    found = observability([F, F], [H] * 3, [R] * 3, [1.0, 1.0])
    assert found.rank == 2
    np.testing.assert_allclose(found.remaining_sigmas, np.sqrt(np.diag(np.linalg.inv(np.eye(2) + G))), rtol=1e-12)


def test_unmeasured_directions_are_hidden():
    found = observability([np.eye(2)] * 3, [np.array([[1.0, 1]])] * 4, [np.eye(1)] * 4, [1.0, 2.0])
    assert found.rank == 1
    want = np.array([2.0, -1]) / np.sqrt(5)  # x0 = -x1, in units of the sigmas
    np.testing.assert_allclose(np.abs(found.hidden_directions[0] @ want), 1.0, rtol=1e-12)
    unseen = observability([np.eye(2)], [np.zeros((1, 2))] * 2, [np.eye(1)] * 2, [3.0, 4.0])
    assert unseen.rank == 0
    np.testing.assert_allclose(unseen.remaining_sigmas, [3, 4])


def along(truth):
    """The coupled filter's model on a flight, positions at each tenth of its steps of ten ticks."""
    phi, f = np.asarray(truth.heading)[::10], np.asarray(truth.imu_reading)[::10, 1:]
    F = np.array([np.asarray(coupled_transition(10 * DT, a, b)) for a, b in zip(phi[:-1], f[:-1], strict=True)])
    H = np.zeros((len(phi), 2, 8))
    H[::10, 0, 3] = H[::10, 1, 4] = 1
    return observability(F, H, np.tile(5.6e-4 * np.eye(2), (len(phi), 1, 1)), SIGMAS)


@pytest.mark.thorough
def test_heading_is_observable_only_while_accelerating():
    still, moving = along(rest(ticks(1000))), along(weave(ticks(1000)))
    assert still.rank == 6
    np.testing.assert_allclose(
        np.abs(still.hidden_directions[:, [1, 2, 3, 4, 6, 7]]), 0.0, atol=1e-9
    )  # heading and gyro bias
    np.testing.assert_allclose(still.remaining_sigmas[[0, 5]], SIGMAS[[0, 5]], rtol=1e-9)
    assert moving.rank == 8
    assert (moving.remaining_sigmas[[0, 5]] < still.remaining_sigmas[[0, 5]]).all()
    scaled = moving.gramian / SIGMAS[:, None] / SIGMAS
    left = np.linalg.inv(np.diag(SIGMAS**-2.0) + scaled)  # prior and measurements put together, by inverses
    np.testing.assert_allclose(moving.remaining_sigmas, np.sqrt(np.diag(left)), rtol=1e-9)


def test_rejects_mismatched_shapes_and_zero_sigmas():
    with pytest.raises(InputError, match="must fit together"):
        observability_gramian([np.eye(2)], [np.ones((1, 2))], [np.eye(1)])
    with pytest.raises(InputError, match="prior sigmas"):
        observability([np.eye(2)], [np.ones((1, 2))] * 2, [np.eye(1)] * 2, [1.0, 0.0])


def test_constant_rank_does_not_depend_on_units():
    A = np.array([[0, 1.0, 0, 0], [-3e12, -10, 0, 0], [0, 0, 0, 1], [0, 0, -4e12, -20]])
    C = np.array([[1.0, 0, 1e-3, 0]])
    plain = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(4)])
    assert np.linalg.matrix_rank(plain) < 4  # so it is no idle scaling
    found = constant_rank(A, C)
    assert found.rank == 4
    assert found.hidden_directions.shape == (0, 4)
    other = constant_rank(A * 1e-6, C)  # another unit of time
    np.testing.assert_allclose(other.singular, found.singular, rtol=1e-2)


def test_constant_rank_reports_hidden_directions():
    A, C = np.array([[0, 1.0, 0], [0, -2.0, 0], [1.0, 0, 0]]), np.array([[0, 1.0, 0], [0, 2.0, 0]])
    found = constant_rank(A, C, scale=[10.0, 1.0, 3.0])
    assert found.rank == 1
    np.testing.assert_allclose(np.abs(found.hidden_directions @ [0, 1.0, 0]), 0, atol=1e-12)
    nilpotent = np.array([[0, 1.0], [0, 0]])
    assert constant_rank(nilpotent, [[1.0, 0]]).rank == 2
    with pytest.raises(InputError, match="must fit together"):
        constant_rank(A, [[1.0, 0]])
    with pytest.raises(InputError, match="3 finite sizes"):
        constant_rank(A, C, scale=[1.0, 0.0, 1.0])

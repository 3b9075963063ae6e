"""Proofs of closed loops: decay is proved where it exists, and otherwise the proof fails with the number."""

import itertools

import numpy as np
import pytest
from design.systems import ball_system

from trimtab.design.certificate import design_certificate
from trimtab.design.loop_proof import SHARE, prove_boxes, prove_level, prove_sampled

NAMES = ("x", "x'", "y", "y'")


def oscillators(stiffness, damping):
    """Two, loosely coupled."""
    (k1, k2), (c1, c2) = stiffness, damping
    return np.array([[0.0, 1, 0, 0], [-k1, -c1, 0.1, 0], [0, 0, 0, 1], [0.1, 0, -k2, -c2]])


def box(error, damping=0.5):
    """Vertices of both stiffnesses, 1 and 4, off by `error` either way."""
    signs = itertools.product((-1, 1), repeat=2)
    return np.array([oscillators((1 + a * error, 4 * (1 + b * error)), (damping, damping)) for a, b in signs])


def sampled(rate, T=0.1):
    """A rotation that decays by `rate` (1/s), seen in coordinates that hide it."""
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.kron(np.diag([1.0, 0.5]), np.array([[c, -s], [s, c]])) * np.exp(-rate * T)
    W = np.random.default_rng(0).standard_normal((4, 4)) * np.array([[1e3], [1.0], [1e-3], [1.0]])
    return W @ turn @ np.linalg.inv(W)


SIZE = np.array([1e3, 1.0, 1e-3, 1.0])


@pytest.mark.parametrize("rate", [1e-3, 0.2, 3.0])
def test_decay_of_a_sampled_loop_is_proved(rate):
    line = prove_sampled(sampled(rate), SIZE, 0.1, NAMES)
    assert line.holds, line
    assert line.number == pytest.approx(SHARE * rate, rel=1e-6)
    assert line.how == "exact, 4 states at 10 Hz"


@pytest.mark.parametrize("rate", [0.0, -1e-9, -0.2])
def test_sampled_loop_without_decay_is_not_proved(rate):
    line = prove_sampled(sampled(rate) + (0.0 if rate else 1e-12), SIZE, 0.1, NAMES)
    assert not line.holds
    assert line.number <= 1e-9


def test_wrong_lyapunov_matrix_fails_the_sampled_proof(monkeypatch):
    """The float matrix is only a candidate: a wrong one fails in exact arithmetic, and the pivot is named."""
    for wrong in (lambda A, Q: -np.eye(4), lambda A, Q: np.eye(4)):
        monkeypatch.setattr("trimtab.design.loop_proof.solve_discrete_lyapunov", wrong)
        line = prove_sampled(sampled(0.2), np.ones(4), 0.1, NAMES)
        assert not line.holds
        assert line.why.startswith("pivot at")


@pytest.mark.parametrize("error", [0.0, 0.1, 0.15])
def test_all_plants_of_a_parameter_box_are_proved(error):
    line = prove_boxes([box(error)], np.ones(4), 0.05, NAMES)
    assert line.holds, line
    assert line.number == 0.05
    assert line.how == "exact, 4 vertices of 1 boxes"


def test_box_with_an_unstable_vertex_fails():
    """Unstable only where both parameters are at their ends: each parameter alone would pass."""
    vertices = box(0.1)
    vertices[3, 1, 1] = 0.01
    line = prove_boxes([box(0.1), vertices], np.ones(4), 0.0, NAMES)
    assert not line.holds
    assert line.why.startswith("box 2: ")
    assert line.number == pytest.approx(-np.linalg.eigvals(vertices).real.max())


def test_box_with_stable_vertices_but_unstable_interior_fails():
    """Two stable matrices whose mean is not: eigenvalues at the corners prove nothing, one Lyapunov matrix does."""
    corners = np.array([[[-1.0, 10.0], [0.0, -1.0]], [[-1.0, 0.0], [10.0, -1.0]]])
    assert np.linalg.eigvals(corners).real.max() < 0 < np.linalg.eigvals(corners.mean(axis=0)).real.max()
    assert not prove_boxes([corners], np.ones(2), 0.0, "xy").holds


@pytest.mark.parametrize("wrong", [-np.eye(4), np.eye(4)])
def test_wrong_common_lyapunov_matrix_fails_the_box(monkeypatch, wrong):
    monkeypatch.setattr("trimtab.design.loop_proof._common_lyapunov", lambda v, r, m: (wrong, m))
    assert not prove_boxes([box(0.1)], np.ones(4), 0.05, NAMES).holds


def test_faster_decay_rate_than_true_is_not_proved():
    """A loop that decays at 0.25 1/s is not proved to decay at 0.3 1/s."""
    slow = box(0.0)
    assert np.linalg.eigvals(slow).real.max() == pytest.approx(-0.25)
    assert prove_boxes([slow], np.ones(4), 0.24, NAMES).holds
    assert not prove_boxes([slow], np.ones(4), 0.3, NAMES).holds


def test_proved_level_is_largest_within_one_percent():
    """By random points on the set: no input exceeds its limit, one nearly reaches it, twice the level exceeds it."""
    certificate = design_certificate(ball_system())
    o = certificate.observer
    K = certificate.K
    slope, room = np.vstack([np.hstack([K, -K[:, 2:]]), np.eye(1, 6)]), np.array([3.0, 0.4])
    line = prove_level(certificate, o, slope, room)
    assert line.holds
    S = np.zeros((6, 6))
    S[:4, :4], S[4:, 4:] = certificate.P / 2, o.weight * np.linalg.inv(o.P)
    rng = np.random.default_rng(0)
    z = rng.standard_normal((200_000, 6)) @ np.linalg.inv(np.linalg.cholesky(S)).real
    z = z / np.sqrt(np.einsum("ni,ij,nj->n", z, S, z) / line.number)[:, None]
    use = np.abs(z @ slope.T).max(axis=0) / room
    assert 0.9 < use.max() < 1.0
    worst = np.linalg.solve(S, slope.T)
    worst = worst / np.sqrt(np.einsum("in,ij,jn->n", worst, S, worst) / line.number)
    assert (np.abs(slope @ worst).diagonal() / room).max() == pytest.approx(np.sqrt(0.99), rel=1e-9)
    assert "largest single errors within the level: r " in line.why


def test_saturated_input_has_no_proved_level():
    certificate = design_certificate(ball_system())
    line = prove_level(certificate, certificate.observer, np.ones((1, 6)), np.array([0.0]))
    assert (line.holds, line.why) == (False, "an input is at or beyond its limit at rest")


def test_both_sides_of_the_inequalities_are_checked(monkeypatch):
    """A Lyapunov matrix that satisfies only a weaker inequality (2 P, or no decay rate) is rejected."""
    monkeypatch.setattr("trimtab.design.loop_proof.solve_discrete_lyapunov", lambda A, Q: np.eye(2))
    F = np.array([[0.5, 1.0], [0.0, 0.5]])
    assert 1 < np.linalg.norm(F, 2) ** 2 < 2
    assert not prove_sampled(F, np.ones(2), 0.1, "xy").holds
    monkeypatch.setattr("trimtab.design.loop_proof._common_lyapunov", lambda v, r, m: (np.eye(2), m))
    slow = np.array([-0.1 * np.eye(2)])
    assert prove_boxes([slow], np.ones(2), 0.05, "xy").holds
    assert not prove_boxes([slow], np.ones(2), 0.2, "xy").holds

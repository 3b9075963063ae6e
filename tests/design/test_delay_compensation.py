"""Predictive feedback: poles, a simulation with the delay itself, and the effect of errors of the assumed delay."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from trimtab.core.errors import InputError
from trimtab.design.delay_compensation import compensate_delay, plain_feedback
from trimtab.design.lqr import lqr

A = np.array([[0.0, 1.0, 0.0], [2.0, -0.3, 1.0], [0.0, -0.5, 0.4]])
B = np.array([[0.0, 0.2], [1.0, 0.0], [0.3, 1.0]])
PERIOD = 0.02
M, J, ARM, K2, PXR = 2.6, 0.096, 0.32, 4.0, 2.8


def gain():
    return np.asarray(lqr(A, B, np.eye(3), np.eye(2)).K)


def forward_lateral():
    """Sway and yaw of ForwardMomentum about its equilibrium, [1] tables 6.2: plant and gain."""
    plant = np.array([[0.0, -PXR / M], [0.0, 0.0]])
    return plant, np.array([[1 / M], [-ARM / J]]), np.array([[-K2, K2 * ARM]])


@pytest.mark.thorough("0.005", "0.05", "0.06", "0.333")
@pytest.mark.parametrize("delay", [0.0, 0.005, 0.02, 0.05, 0.06, 0.1 + 1e-12, 0.333, 1.0])
def test_compensated_delay_does_not_move_the_poles(delay):
    K = gain()
    feedback = compensate_delay(A, B, K, delay, PERIOD)
    held = np.hstack([expm(A * PERIOD), quad_vec(lambda s: expm(A * s) @ B, 0, PERIOD)[0]])
    wanted = np.linalg.eigvals(held[:, :3] + held[:, 3:] @ K)
    # poles at 0 are a Jordan block, which rounding moves by the N-th root of it: traces of powers are compared instead
    F = feedback.loop_matrix()
    for k in range(1, 6):
        assert np.trace(np.linalg.matrix_power(F, k)) == pytest.approx((wanted**k).sum().real, rel=1e-8)
    assert np.abs(feedback.poles()[0]) == pytest.approx(np.abs(wanted).max(), rel=1e-5)


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.2, 0.29])
def test_predicted_state_matches_delayed_simulation(delay):
    """Flown with the delay itself, in small steps: the plant's state at now + delay is what was predicted now."""
    K, step = gain(), 1e-3
    feedback = compensate_delay(A, B, K, delay, PERIOD)
    fine, held = expm(A * step), quad_vec(lambda s: expm(A * s) @ B, 0, step)[0]
    sent = np.zeros((len(feedback.input_gains), 2))
    late, per = round(delay / step), round(PERIOD / step)
    arriving = [np.zeros(2)] * late
    x, u, states, predicted = np.array([1.0, -0.5, 0.3]), np.zeros(2), [], []
    for k in range(1500):
        states.append(x)
        if k % per == 0:
            u = feedback.command(x, sent)
            predicted.append((k + late, u))
            sent = np.vstack([u[None], sent])[: len(feedback.input_gains)]
        arriving.append(u)
        x = fine @ x + held @ arriving.pop(0)
    for at, command in predicted:
        if at < len(states):
            np.testing.assert_allclose(command, K @ states[at], rtol=1e-7, atol=1e-9)
    assert sum(at < len(states) for at, _ in predicted) > 50


def test_long_delay_is_unstable_without_compensation():
    """Forward, sway and yaw: 191 ms are the margin of the law as it is (continuous; the hold takes half a period)."""
    plant, inputs, K = forward_lateral()
    plain = plain_feedback(plant, inputs, K, 1e-3)
    assert np.abs(plain.poles(0.190)).max() < 1 < np.abs(plain.poles(0.192)).max()
    for delay in (0.192, 0.4, 0.8):
        late = compensate_delay(plant, inputs, K, delay, 0.02)
        assert np.abs(late.poles()).max() < 1 - 0.02  # as without delay: pole -2.9 1/s
        assert np.abs(plain_feedback(plant, inputs, K, 0.02).poles(delay)).max() > 1


def test_compensated_loop_tolerates_small_delay_error():
    """Stable near the assumed delay, and unstable far from it."""
    plant, inputs, K = forward_lateral()
    late = compensate_delay(plant, inputs, K, 0.4, 0.02)
    sizes = {d: np.abs(late.poles(d)).max() for d in (0.0, 0.35, 0.38, 0.4, 0.42, 0.45, 1.2)}
    assert all(sizes[d] < 1 for d in (0.38, 0.4, 0.42))
    assert sizes[1.2] > 1
    assert sizes[0.4] < sizes[0.42] or sizes[0.4] < sizes[0.38]


def test_zero_delay_gives_plain_feedback():
    K = gain()
    plain = plain_feedback(A, B, K, PERIOD)
    assert plain.input_gains.shape == (0, 2, 2)
    np.testing.assert_array_equal(plain.state_gain, K)
    np.testing.assert_array_equal(plain.command(np.ones(3), np.zeros((0, 2))), K @ np.ones(3))


@pytest.mark.parametrize(
    ("change", "why"),
    [({"K": np.zeros((3, 2))}, "don't fit"), ({"delay": -0.1}, "at least 0 s"), ({"period": 0.0}, "above 0"),
     ({"delay": float("nan")}, "at least 0 s"), ({"A": np.eye(2)}, "don't fit")],
)  # fmt: skip
def test_rejects_invalid_arguments(change, why):
    with pytest.raises(InputError, match=why):
        compensate_delay(**({"A": A, "B": B, "K": gain(), "delay": 0.1, "period": PERIOD} | change))

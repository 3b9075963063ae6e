"""Small systems for the tests of gains and certificates."""

import numpy as np

DOUBLE_INTEGRATOR = (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]))
G = 9.81
BALL_AND_BEAM = (
    np.array([[0.0, 1, 0, 0], [0, 0, -5 * G / 7, 0], [0, 0, 0, 1], [0, 0, 0, 0]]),
    np.array([[0.0], [0], [0], [1.0]]),
)
"""Position, its rate, beam angle, its rate; angular acceleration commanded. Unstable chain of four integrators."""


def left_side(A, B, K, P, Qe, Re):
    """Of (14), written out."""
    closed = A + B @ K
    return P @ closed + closed.T @ P + P @ B @ np.linalg.inv(Re) @ B.T @ P + Qe

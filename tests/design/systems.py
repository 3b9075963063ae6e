"""Small systems for the tests of gains and certificates."""

import numpy as np

from trimtab.design.certified_system import CertifiedSystem, LimitedNumber

DOUBLE_INTEGRATOR = (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]))
G = 9.81
BALL_AND_BEAM = (
    np.array([[0.0, 1, 0, 0], [0, 0, -5 * G / 7, 0], [0, 0, 0, 1], [0, 0, 0, 0]]),
    np.array([[0.0], [0], [0], [1.0]]),
)
"""Position, its rate, beam angle, its rate; angular acceleration commanded. Unstable chain of four integrators."""


def integrators(n: int):
    """A and B of a chain of n integrators."""
    return np.diag(np.ones(n - 1), 1), np.eye(n)[:, -1:]


def left_side(A, B, K, P, Qe, Re):
    """Left side of (14), written out."""
    closed = A + B @ K
    return P @ closed + closed.T @ P + P @ B @ np.linalg.inv(Re) @ B.T @ P + Qe


def ball_system(method: str = "lqr", observer: bool = True, kappa: float = 0.3) -> CertifiedSystem:
    """Ball and beam, named and weighted; the beam's angle is measured with noise, or all states are."""
    A, B = BALL_AND_BEAM
    Qe, states = np.diag([4.0, 0.1, 1.0, 0.1]), ("r", "r'", "theta", "theta'")
    system = CertifiedSystem(
        name="ball and beam",
        about={"beam_m": 1.0},
        method=method,
        states=states,
        inputs=("w",),
        A=A,
        B=B,
        Qe=Qe,
        Re=np.array([[0.01]]),
        Q=1.01 * Qe if method == "lqr" else None,
        scale=np.array([0.5, 3.0, 1.0, 3.0]),
        numbers=lambda K: {"kappa": LimitedNumber(kappa, 0.0, 1.0, "by hand", 1e-9)},
    )
    if not observer:
        return system
    noise = {"C": np.array([[1.0, 0.0]]), "Q_eta": np.diag([0.1, 0.3]), "R": np.array([[0.02]])}
    return system._replace(estimated=states[2:], **noise)

"""Loops of the hovercraft's laws, by hand: lateral motion about a trim, and the spin; gains of the source."""

import numpy as np

from trimtab.design.loop_transfer import FeedbackLoop, loop_of_gain

M, J, D = 2.6, 0.096, 0.32


def lateral(k2, speed, weight=-1.0):
    """v' = -U r + FY/m, r' = -d FY/J, with FY = -k2 (v - d r) forward and FY = +k2 (v + weight d r) in reverse."""
    A, B = [[0.0, -speed], [0.0, 0.0]], [[1 / M], [-D / J]]
    sign = -1 if weight < 0 else 1
    return loop_of_gain(A, B, [[sign * k2, sign * k2 * weight * D]])


def zero():
    return lateral(2.5, 0.0)


def forward():
    return lateral(4.0, 2.8 / M)


def reverse():
    return lateral(1.0, -1.98 / M, weight=1.44)


def spin():
    """Surge, sway and yaw rate about 3 rad/s on the spot; FX = -k1 u, FY = -k2 (v - d (r - 3))."""
    A = [[0.0, 3.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    return loop_of_gain(A, [[1 / M, 0], [0, 1 / M], [0, -D / J]], [[-0.5, 0, 0], [0, -3.5, 3.5 * D]])


def rightmost(loop: FeedbackLoop, delay, nodes=40):
    """Largest real part of the poles of x' = A x - B C x(t - delay), hidden ones at 0 left out.

    Chebyshev collocation of the history: Trefethen, "Spectral methods in MATLAB", programs 6 and 33.
    """
    n, k = len(loop.A), np.arange(nodes + 1)
    theta = np.cos(np.pi * k / nodes)
    c = np.where((k == 0) | (k == nodes), 2.0, 1.0) * (-1.0) ** k
    gap = theta[:, None] - theta[None, :] + np.eye(nodes + 1)
    diff = np.outer(c, 1 / c) / gap
    diff -= np.diag(diff.sum(axis=1))
    whole = np.kron(diff * 2 / delay, np.eye(n))
    whole[:n] = 0.0
    whole[:n, :n], whole[:n, -n:] = loop.A, -loop.B @ loop.C
    poles = np.linalg.eigvals(whole)
    return poles[np.abs(poles) > 1e-6].real.max()

"""Aided INS of filters.py in plain numpy: mechanisation and two error-state filters.

The filter class is an argument, so that the numpy filter and a library's use the same matrices. A filter has x, P,
predict(F, Q) and update(z, R).
Source of the equations: [1] chapter 3, as on the page of the aided INS; matrices as printed (literal).
"""

import numpy as np


class Kalman:
    """Kalman filter with the update in Joseph's form."""

    def __init__(self, x, P, H):
        self.x, self.P, self.H, self.eye = x, P, H, np.eye(len(x))

    def predict(self, F, Q):
        self.x = F @ self.x
        self.P = F @ self.P @ F.T + Q

    def update(self, z, R):
        H, P = self.H, self.P
        y = z - H @ self.x
        PHt = P @ H.T
        K = PHt @ np.linalg.inv(H @ PHt + R)
        self.x = self.x + K @ y
        A = self.eye - K @ H
        self.P = A @ P @ A.T + K @ R @ K.T


def navigate(make, setting, felt, headings, positions):
    """Return the estimates (n, 8) and the last covariances in one array.

    An estimate is heading, velocity, position, and biases of gyro and accelerometers.
    make: function of (x, P, H) that returns a filter.  setting: dt, every, variances, and initial P1, P2.
    felt: IMU samples (n, 3).  headings (n,), positions (n, 2): aiding measurements.
    """
    dt, every = setting["dt"], setting["every"]
    a = make(np.zeros(2), np.diag(setting["P1"]), np.array([[1.0, 0.0]]))
    b = make(np.zeros(6), np.diag(setting["P2"]), np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, 2))]))
    F1, Q1, R1 = np.array([[1.0, dt], [0.0, 1.0]]), np.diag(setting["Q1"]), np.array([[setting["R1"]]])
    R2, F2, Q2 = setting["R2"] * np.eye(2), np.eye(6), np.zeros((6, 6))
    F2[2:4, 0:2] = dt * np.eye(2)
    heading, v, r, last = 0.0, np.zeros(2), np.zeros(2), felt[0]
    told = np.empty((len(felt), 8))
    for k in range(len(felt)):
        B = planar(heading - a.x[0])
        f0, heading = B @ last[1:], heading + dt / 2 * (felt[k, 0] + last[0])
        a.predict(F1, Q1)
        f1 = planar(heading - a.x[0]) @ felt[k, 1:]
        r = r + dt * v + dt * dt / 6 * (f1 + 2 * f0)
        v = v + dt / 2 * (f0 + f1)
        F2[0:2, 4:6], F2[2:4, 4:6] = dt * B, dt * dt / 2 * B
        Q2[0:2, 0:2], Q2[4:6, 4:6] = (B * setting["Q2"][:2]) @ B.T, np.diag(setting["Q2"][2:])
        b.predict(F2, Q2)
        last = felt[k]
        off = heading - headings[k] - a.x[0]
        a.update(np.array([np.arctan2(np.sin(off), np.cos(off)) + a.x[0]]), R1)
        if k % every == 0:
            b.update(r - positions[k], R2)
        told[k] = heading - a.x[0], *(v - b.x[:2]), *(r - b.x[2:4]), a.x[1], *b.x[4:]
    return np.concatenate([told.ravel(), a.P.ravel(), b.P.ravel()])


def planar(angle):
    """Return the rotation matrix from body to world axes."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def track(make, F, Q, H, R, P, measured):
    """Run a plain filter on measurements (n, m). Return states (n, 8) and the last covariance in one array."""
    one = make(np.zeros(len(F)), P, H)
    told = np.empty((len(measured), len(F)))
    for k, z in enumerate(measured):
        one.predict(F, Q)
        one.update(z, R)
        told[k] = one.x
    return np.concatenate([told.ravel(), one.P.ravel()])

"""Marine vehicles as their publications write them, in matrices and Euler angles; shares no code with trimtab.

CyberShip II: R. Skjetne, Ø. N. Smogeli, T. I. Fossen, Modeling, Identification and Control 25 (2004) 3-27.
REMUS: T. Prestero, MIT and WHOI, 2001. Mariner: M. S. Chislett, J. Strøm-Tejsen, Hydro- and Aerodynamics Laboratory,
report Hy-5, 1965, in the form of T. I. Fossen's book.
"""

from math import atan2, cos, pi, sin, sqrt, tan

import numpy as np


def cybership(nu, delta, rps, current=(0.0, 0.0), psi=0.0):
    """nu' (3,) about the ship's own origin, amidships: u, v, r over the ground; two screws, two rudders."""
    m, Iz, xg = 23.8, 1.760, 0.046
    M = np.array([[m + 2.0, 0, 0], [0, m + 10.0, m * xg], [0, m * xg, Iz + 1.0]])
    R = np.array([[cos(psi), sin(psi)], [-sin(psi), cos(psi)]])
    vc = R @ np.array(current)
    r = nu[2]
    u, v = np.array(nu[:2]) - vc
    CRB = np.array([[0, 0, -m * (xg * r + v)], [0, 0, m * u], [m * (xg * r + v), -m * u, 0]])
    CA = np.array([[0, 0, -10.0 * v], [0, 0, 2.0 * u], [10.0 * v, -2.0 * u, 0]])
    D = np.array(
        [
            [0.72253 + 1.32742 * abs(u) + 5.86643 * u * u, 0, 0],
            [0, 0.88965 + 36.47287 * abs(v) + 0.805 * abs(r), 7.250 + 0.845 * abs(v) + 3.450 * abs(r)],
            [0, -0.03130 - 3.95645 * abs(v) - 0.130 * abs(r), 1.900 - 0.080 * abs(v) + 0.750 * abs(r)],
        ]
    )
    ahead, astern = max(0, 1.52468e-4 / 3.65034e-3 * u), min(0, 4.55822e-2 / 5.10256e-3 * u)
    T = 0.0
    if rps >= ahead:
        T = 3.65034e-3 * abs(rps) * rps - 1.52468e-4 * abs(rps) * u
    elif rps <= astern:
        T = 5.10256e-3 * abs(rps) * rps - 4.55822e-2 * abs(rps) * u
    flow = u + 0.5 * (sqrt(max(0, 8 * T / (pi * 1014 * 0.06**2) + u * u)) - u) if u >= 0 else u
    a, b = (6.43306, 5.83594) if flow >= 0 else (3.19573, 2.34356)
    L = (a * delta - b * abs(delta) * delta) * abs(flow) * flow
    tau = np.array([2 * T, 2 * L, -0.549 * 2 * L])
    nu_r = np.array([u, v, r])
    return np.linalg.solve(M, tau - (CRB + CA + D) @ nu_r) + np.array([r * vc[1], -r * vc[0], 0])


def remus(nu, euler, dr, ds, thrust=3.86, torque=-0.543, buoyancy=306.0, mqq=-188.0, zww=-131.0):
    """nu' (6,) about the centre of buoyancy in still water: the sums of forces as the thesis's program adds them up."""
    u, v, w, p, q, r = nu
    phi, theta, _ = euler
    W, B, zg = 299.0, buoyancy, 0.0196
    m, Ix, Iy, Iz = W / 9.81, 0.177, 3.45, 3.45
    X = -(W - B) * sin(theta) - 1.62 * u * abs(u) + (-35.5 - m) * w * q - 1.93 * q * q + (35.5 + m) * v * r
    X += -1.93 * r * r - m * zg * p * r + thrust
    Y = (W - B) * cos(theta) * sin(phi) - 1310 * v * abs(v) + 0.632 * r * abs(r) - 28.6 * u * v + (35.5 + m) * w * p
    Y += (5.22 - m) * u * r - m * zg * q * r + 1.93 * p * q + 9.64 * u * u * dr
    Z = (W - B) * cos(theta) * cos(phi) + zww * w * abs(w) - 0.632 * q * abs(q) - 28.6 * u * w + (-5.22 + m) * u * q
    Z += (-35.5 - m) * v * p + m * zg * (p * p + q * q) + 1.93 * r * p - 9.64 * u * u * ds
    K = -zg * W * cos(theta) * sin(phi) - 0.130 * p * abs(p) - (Iz - Iy) * q * r - m * zg * w * p + m * zg * u * r
    K += torque
    M = -zg * W * sin(theta) + 3.18 * w * abs(w) + mqq * q * abs(q) + (4.86 - (Ix - Iz)) * r * p
    M += m * zg * v * r - m * zg * w * q - 2.0 * u * q + 24.0 * u * w - 1.93 * v * p - 6.15 * u * u * ds
    N = -3.18 * v * abs(v) - 94.0 * r * abs(r) - 24.0 * u * v + (-4.86 - (Iy - Ix)) * p * q - 1.93 * w * p
    N += -2.0 * u * r - 6.15 * u * u * dr
    A = np.zeros((6, 6))
    A[0, [0, 4]] = m + 0.93, m * zg
    A[1, [1, 3, 5]] = m + 35.5, -m * zg, -1.93
    A[2, [2, 4]] = m + 35.5, 1.93
    A[3, [1, 3]] = -m * zg, Ix + 0.0704
    A[4, [0, 2, 4]] = m * zg, 1.93, Iy + 4.88
    A[5, [1, 5]] = -1.93, Iz + 4.88
    return np.linalg.solve(A, [X, Y, Z, K, M, N])


def kinematics(nu, euler):
    """eta' (6,): north, east, depth, roll, pitch, yaw."""
    phi, theta, psi = euler
    cf, sf, ct, st, cp, sp = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
    R = np.array(
        [
            [cp * ct, -sp * cf + cp * st * sf, sp * sf + cp * cf * st],
            [sp * ct, cp * cf + sf * st * sp, -cp * sf + st * sp * cf],
            [-st, ct * sf, ct * cf],
        ]
    )
    p, q, r = nu[3:]
    turn = p + (sf * q + cf * r) * tan(theta), cf * q - sf * r, (sf * q + cf * r) / ct
    return np.concatenate([R @ nu[:3], turn])


def fly_remus(nu, eta, fins, seconds, dt=0.01, **about):
    """Rows of t, nu, eta, by Runge and Kutta's fourth order; fins: (rudder, stern planes) at a time (s), at once."""

    def rate(x, at):
        dr, ds = fins(at)
        return np.concatenate([remus(x[:6], x[9:], dr, ds, **about), kinematics(x[:6], x[9:])])

    x, rows = np.concatenate([nu, eta]).astype(float), []
    for k in range(round(seconds / dt) + 1):
        rows.append(np.concatenate([[k * dt], x]))
        at = k * dt
        a = rate(x, at)
        b = rate(x + dt / 2 * a, at)
        c = rate(x + dt / 2 * b, at)
        d = rate(x + dt * c, at)
        x = x + dt / 6 * (a + 2 * b + 2 * c + d)
    return np.array(rows)


def euler_of(q):
    """Roll, pitch, yaw of a quaternion, scalar first."""
    w, x, y, z = q
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(2 * (w * y - z * x))
    return roll, pitch, atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

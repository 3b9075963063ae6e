"""The Mariner by [1]'s polynomials, term by term, integrated by SciPy with events; shares no code with trimtab.

[1] M. S. Chislett, J. Strøm-Tejsen, Hydro- and Aerodynamics Laboratory, report Hy-5, 1965, in the form of Fossen's
book. `python -m oracles.mariner` prints what the study compares with.
"""

from math import cos, hypot, pi, radians, sin

import numpy as np
from scipy.integrate import solve_ivp

L, U0 = 160.93, 7.7175
M = np.array([[798 + 748, 798 * -0.023 + 9.354], [798 * -0.023 - 4.646, 39.2 + 43.8]])


def rates(q, told):
    """u, v, r, x, y, psi, delta: their derivatives; u is the surge velocity itself."""
    U = hypot(q[0], q[1])
    u, v, r, d = (q[0] - U0) / U, q[1] / U, q[2] * L / U, q[6]
    X = -184 * u - 110 * u**2 - 215 * u**3 - 899 * v**2 + 18 * r**2 - 95 * d**2 - 190 * u * d**2
    X += 798 * r * v + 93 * v * d + 93 * u * v * d
    Y = -1160 * v - 499 * r - 8078 * v**3 + 15356 * v * v * r - 1160 * v * u - 499 * r * u + 278 * d - 90 * d**3
    Y += 556 * u * d + 278 * u * u * d - 4 * v * d * d + 1190 * v * v * d - 4 - 8 * u - 4 * u * u
    N = -264 * v - 166 * r + 1636 * v**3 - 5483 * v * v * r - 264 * v * u - 166 * r * u - 139 * d + 45 * d**3
    N += -278 * u * d - 139 * u * u * d + 13 * v * d * d - 489 * v * v * d + 3 + 6 * u + 3 * u * u
    dv, dr = np.linalg.solve(M, [Y, N])
    gear = max(-radians(5), min(radians(5), max(-radians(40), min(radians(40), told)) - d))
    c, s = cos(q[5]), sin(q[5])
    go = [q[0] * c - q[1] * s, q[0] * s + q[1] * c, q[2], gear]
    return np.array([X / (798 + 42) * U * U / L, dv * U * U / L, dr * U * U / L**2, *go])


def _run(q, told, seconds, event):
    event.terminal = True
    tight = {"rtol": 1e-9, "atol": 1e-10, "max_step": 1.0}
    return solve_ivp(lambda t, q: rates(q, told), (0, seconds), q, events=event, dense_output=True, **tight)


def circle(degrees):
    """Advance, transfer, tactical diameter, steady radius (m) of a turn to starboard."""
    q, told = np.array([U0, 0, 0, 0, 0, 0, 0.0]), -radians(degrees)
    quarter = _run(q, told, 700, lambda t, q: q[5] - pi / 2).y[:, -1]
    half = _run(quarter, told, 700, lambda t, q: q[5] - pi).y[:, -1]
    last = _run(q, told, 700, lambda t, q: 1.0).y[:, -1]
    return quarter[3], quarter[4], half[4], hypot(last[0], last[1]) / last[2]


def overshoots(degrees):
    """First and second overshoot (deg) of a zigzag that begins to starboard."""
    q, angle = np.array([U0, 0, 0, 0, 0, 0, 0.0]), radians(degrees)
    q = _run(q, -angle, 300, lambda t, q: q[5] - angle).y[:, -1]
    first = _run(q, angle, 300, lambda t, q: q[2]).y[:, -1]
    q = _run(first, angle, 300, lambda t, q: q[5] + angle).y[:, -1]
    second = _run(q, -angle, 300, lambda t, q: q[2]).y[:, -1]
    return np.degrees(first[5]) - degrees, -np.degrees(second[5]) - degrees


if __name__ == "__main__":
    for rudder in (15, 35):
        print(rudder, *(f"{v:.2f}" for v in circle(rudder)))
    for angle in (10, 20):
        print(f"{angle}/{angle}", *(f"{v:.3f}" for v in overshoots(angle)))

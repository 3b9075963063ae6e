"""How low the F-16 of AeroBenchVV gets in its two flights, from the equations of the book and the gains of its authors.

    PYTHONPATH=tests python -m oracles.f16_ground_avoidance

NumPy and SciPy: feet, slugs and degrees, the book's constants, Runge and Kutta by `solve_ivp`, the law in continuous
time with its modes asked each 1/30 s. The tables are read as text from the package's file of them; nothing runs there.

Source: B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft control and simulation", 3rd ed., fig. 3.5-1, appendix A;
P. Heidlauf, A. Collins, M. Bolender, S. Bak, ARCH 2018.
"""

import ast
import math
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator

G, RM, S, B, C, HE = 32.17, 1.57e-3, 300.0, 30.0, 11.32, 160.0
INSTANT = 1 / 30
K_LONG = np.array([-156.8801506723475, -31.037008068526642, -38.72983346216317])
K_LAT = np.array(
    [[37.84483, -25.40956, -6.82876, -332.88343, -17.15997], [-23.91233, 5.69968, -21.63431, 64.49490, -88.36203]]
)
ALPHA_TRIM, THROTTLE_TRIM, ELEVATOR_TRIM = 0.0389, 0.1395, -0.7496
STARTS = {"dive": (-math.pi / 8, -0.3 * math.pi / 2, 6.0), "inverted": (-0.9 * math.pi, -0.01 * math.pi / 2, 10.0)}
"""Bank, pitch (rad), seconds."""


def read_tables(file=Path(__file__).parents[2] / "src/trimtab/vehicles/f16_tables.py"):
    """Name -> array, or mapping of arrays, of a file of assignments."""

    def value(node):
        if isinstance(node, ast.Dict):
            return {k.value: value(v) for k, v in zip(node.keys, node.values, strict=True)}
        make = {"array": np.array, "arange": np.arange}[node.func.attr]
        return make(*map(ast.literal_eval, node.args))

    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.targets[0].id: value(node.value) for node in tree.body if isinstance(node, ast.Assign)}


def table(*axes_and_values):
    """A function of points that is linear between a table's entries, held at its ends."""
    *axes, values = axes_and_values
    look = RegularGridInterpolator(tuple(axes), values)
    return lambda *at: float(look([np.clip(x, a[0], a[-1]) for x, a in zip(at, axes, strict=True)])[0])


TABLES = read_tables()
ALPHA = TABLES["ALPHA"]
CX, CM = (table(TABLES["ELEVATOR"], ALPHA, t) for t in (TABLES["CX"], TABLES["CM"]))
CL, CN = (table(TABLES["SIZE_OF_BETA"], ALPHA, t) for t in (TABLES["CL"], TABLES["CN"]))
DLDA, DLDR = (table(TABLES["BETA"], ALPHA, t) for t in (TABLES["CL_AILERON"], TABLES["CL_RUDDER"]))
DNDA, DNDR = (table(TABLES["BETA"], ALPHA, t) for t in (TABLES["CN_AILERON"], TABLES["CN_RUDDER"]))
CZ = table(ALPHA, TABLES["CZ"])
DAMPING = {name: table(ALPHA, t) for name, t in TABLES["DAMPING"].items()}
IDLE, MILITARY, MAXIMUM = (
    table(TABLES["MACH"], TABLES["ALTITUDE"], t) for t in (TABLES["IDLE"], TABLES["MILITARY"], TABLES["MAXIMUM"])
)


def derivative(x, u):
    """Of the thirteen states, with load factors at 15 ft: upwards above 1 g, and to starboard."""
    V, alpha, beta, phi, theta, _, p, q, r, _, _, h, power = x
    throttle, elevator, aileron, rudder = u
    a, b = math.degrees(alpha), math.degrees(beta)
    share = 1 - 0.703e-5 * h
    qbar = 0.5 * 2.377e-3 * share**4.14 * V * V
    mach = V / math.sqrt(1.4 * 1716.3 * 519 * share)
    wanted = 64.94 * throttle if throttle <= 0.77 else 217.38 * throttle - 117.38
    assert power < 50, "idle and military thrust only"
    assert wanted < 50
    gap = wanted - power
    power_rate = (1.0 if gap <= 25 else 0.1 if gap >= 50 else 1.9 - 0.036 * gap) * gap
    idle = IDLE(mach, h)
    thrust = idle + (MILITARY(mach, h) - idle) * power / 50
    d = {name: f(a) for name, f in DAMPING.items()}
    side, size = math.copysign(1, b), abs(b)
    along, across = C * q / (2 * V), B / (2 * V)
    cx = CX(elevator, a) + along * d["CXq"]
    cy = -0.02 * b + 0.021 * aileron / 20 + 0.086 * rudder / 30 + across * (d["CYr"] * r + d["CYp"] * p)
    cz = CZ(a) * (1 - beta**2) - 0.19 * elevator / 25 + along * d["CZq"]
    cl = side * CL(size, a) + DLDA(b, a) * aileron / 20 + DLDR(b, a) * rudder / 30
    cl += across * (d["Clr"] * r + d["Clp"] * p)
    cm = CM(elevator, a) + along * d["Cmq"]
    cn = side * CN(size, a) + DNDA(b, a) * aileron / 20 + DNDR(b, a) * rudder / 30
    cn += across * (d["Cnr"] * r + d["Cnp"] * p)
    U, v, W = V * math.cos(alpha) * math.cos(beta), V * math.sin(beta), V * math.sin(alpha) * math.cos(beta)
    ax, ay, az = RM * (qbar * S * cx + thrust), RM * qbar * S * cy, RM * qbar * S * cz
    sph, cph, sth, cth = math.sin(phi), math.cos(phi), math.sin(theta), math.cos(theta)
    du = r * v - q * W - G * sth + ax
    dv = p * W - r * U + G * cth * sph + ay
    dw = q * U - p * v + G * cth * cph + az
    dV = (U * du + v * dv + W * dw) / V
    roll, pitch, yaw = qbar * S * B * cl, qbar * S * C * cm, qbar * S * B * cn
    dp = (0.02755 * p - 0.770 * r + 1.642e-6 * HE) * q + 1.055e-4 * roll + 1.642e-6 * yaw
    dq = (0.9604 * p - 1.792e-5 * HE) * r + 1.759e-2 * (r * r - p * p) + 1.792e-5 * pitch
    dr = (-0.7336 * p - 0.02755 * r + 1.587e-5 * HE) * q + 1.642e-6 * roll + 1.587e-5 * yaw
    climb = U * sth - v * sph * cth - W * cph * cth
    turn = q * sph + r * cph
    angles = p + sth / cth * turn, q * cph - r * sph, turn / cth
    dbeta = (V * dv - v * dV) * math.cos(beta) / (U * U + W * W)
    rates = [dV, (U * dw - W * du) / (U * U + W * W), dbeta, *angles, dp, dq, dr, 0, 0, climb, power_rate]
    return np.array(rates), -(az - 15 * dq) / G - 1, (ay + 15 * dr) / G


def control(x, integrals):
    """Throttle, elevator, aileron, rudder (deg), between their stops."""
    along = np.array([x[1] - ALPHA_TRIM, x[7], integrals[0]])
    aside = np.array([x[2], x[6], x[8], *integrals[1:]])
    elevator = ELEVATOR_TRIM - K_LONG @ along
    aileron, rudder = -K_LAT @ aside
    return THROTTLE_TRIM, np.clip(elevator, -25, 25), np.clip(aileron, -21.5, 21.5), np.clip(rudder, -30, 30)


def fly(start):
    """Altitude (ft) each 1/30 s; it rolls from the beginning, as the program is told to."""
    bank, pitch, seconds = STARTS[start]
    y = np.array([540, math.radians(2.1215), 0, bank, pitch, 0, 0, 0, 0, 0, 0, 1000, 9, 0, 0, 0], float)
    mode, began, altitudes = "roll", 0.0, [1000.0]

    def rate(_, y):
        x, integrals = y[:13], y[13:]
        dx, load, side = derivative(x, control(x, integrals))
        bank = math.remainder(x[3], 2 * math.pi)
        roll = -4 * bank - 2 * x[6] if mode == "roll" else 0.0
        about_path = x[6] * math.cos(x[1]) + x[8] * math.sin(x[1])
        return [*dx, load - (5 if mode == "pull" else 0), about_path - roll, side + x[8]]

    for k in range(round(seconds / INSTANT)):
        y = solve_ivp(rate, (0, INSTANT), y, rtol=1e-6, atol=1e-8).y[:, -1]
        t, bank, path = (k + 1) * INSTANT, math.remainder(y[3], 2 * math.pi), y[4] - y[1]
        if mode == "roll" and abs(bank) < math.radians(5) and abs(y[6]) < math.radians(10):
            mode, began = "pull", t
        elif mode == "pull" and path > 0 and t >= began + 2:
            mode = "standby"
        elif mode == "standby" and path <= 0 and y[11] < 1000:
            mode = "roll"
        altitudes.append(y[11])
    return np.array(altitudes)


if __name__ == "__main__":
    for name in STARTS:
        print(f"{name}: lowest {fly(name).min():.2f} ft")

"""The flexible hypersonic vehicle, independent of the package: model, trim, linearisation, gains, filter, inner motion.

Slug, foot, second, radian. Arrays have the state first: x (9, ...) = h, V, alpha, theta, Q, eta1, eta1', eta2, eta2'.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3, 7, 9, 13-15, corrected as the page of its errata says.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import fsolve
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

H, V, START = 85000.0, 7702.0808, 5.0
GROUND = 32.174
QUOTED = np.deg2rad(1.5153), 0.2514, np.deg2rad(11.4635)
ETA0 = np.array([1.5122, 0.0, 1.122, 0.0])
NUMBERS: dict[str, Any] = {
    **{"S": 17.0, "c": 17.0, "zT": 8.36, "m": 300.0, "Iyy": 5e5, "rho0": 6.7429e-5, "h0": 85000.0, "hs": 21358.0},
    **{"CL_a": 4.6773, "CL_d": 0.76224, "CL_0": -0.018714},
    **{"CD_a2": 5.8224, "CD_a": -0.045315, "CD_d2": 0.81993, "CD_d": 2.7699e-4, "CD_0": 0.010131},
    **{"CM_a2": 6.2926, "CM_a": 2.1335, "CM_0": 0.18979, "ce": -1.2897},
    **{"b1": -3.7693e5, "b2": -3.7225e4, "b3": 2.6814e4, "b4": -1.7277e4},
    **{"b5": 3.5542e4, "b6": -2.4216e3, "b7": 6.3785e3, "b8": -1.0090e2},
    **{"N1_a2": 1.4013e3, "N1_a": 4.5737e3, "N1_0": 1.1752e2},
    **{"N2_a2": -5.0227e3, "N2_a": 2.8633e3, "N2_d": 1.2465e3, "N2_0": -4.4201e1},
    **{"w1": 16.5, "w2": 20.0, "zeta": 0.02, "psi1": 136.82, "psi2": 329.22, "kmode": "parker"},
    **{"g": 1.39e16 / (20903500.0 + 85000.0) ** 2},
}
A_PRINTED, B_PRINTED = np.zeros((9, 9)), np.zeros((9, 2))
A_PRINTED[0, 1] = A_PRINTED[5, 6] = A_PRINTED[7, 8] = 1.0
A_PRINTED[3, :5] = 7.073e-8, 1.388e-8, 7.186e-7, 0.0696, 1.0
A_PRINTED[4] = -2.29e-5, 2.23e-5, 1.27e-4, 11.63, 0.0, 0.0745, -1.80e-4, 0.263, -5.26e-4
A_PRINTED[6] = 0.0, 0.0, 0.0, 4647.82, 0.0, -272.25, 0.66, 7.207e-5, 1.44e-7
A_PRINTED[8] = 0.021, -1.555e-3, 0.1176, -5100.67, 0.0, 4.90e-5, 1.189e-7, -400.0, 0.8
B_PRINTED[[1, 2], [0, 1]] = 1.0
B_PRINTED[3], B_PRINTED[4] = (1.7e-6, -3.39e-6), (-0.0161, -0.0054)
B_PRINTED[6], B_PRINTED[8] = (-3.35e-5, 1.8304e-4), (18.0596, -1.24)
K_PRINTED = np.array(
    [
        [-2.919, -4.14, 2.65, -2771.93, -822.22, 0.0153, 0.0017, 0.5, 0.0526],
        [0.848, 0.9295, 4.629, 386.93, 114.79, -0.0033, -0.00027, -0.05, 0.00013],
    ]
)
QE = np.array([100.0, 20.0, 10.0, 0.05, 0.1, 1e3, 1e3, 1e3, 1e3]) ** -2.0
RE = np.array([10.0, 5.0]) ** -2.0
QI = np.array([1000.0, 100.0]) ** -2.0
"""Diagonals of the chosen weights of the errors, the accelerations and the integrals."""


def vehicle(**changes: Any) -> SimpleNamespace:
    """The numbers of the vehicle; an array where several vehicles are meant."""
    return SimpleNamespace(**{**NUMBERS, **changes})


def forces(c: Any, h: Any, V: Any, a: Any, Phi: Any, d: Any) -> tuple[Any, ...]:
    """T, L, D, M and the dynamic pressure."""
    q = c.rho0 * np.exp(-(h - c.h0) / c.hs) * V**2 / 2
    T = c.b2 * a**3 + c.b4 * a**2 + c.b6 * a + c.b8 + (c.b1 * a**3 + c.b3 * a**2 + c.b5 * a + c.b7) * Phi
    L = q * c.S * (c.CL_a * a + c.CL_d * d + c.CL_0)
    D = q * c.S * (c.CD_a2 * a**2 + c.CD_a * a + c.CD_d2 * d**2 + c.CD_d * d + c.CD_0)
    M = c.zT * T + q * c.S * c.c * (c.CM_a2 * a**2 + c.CM_a * a + c.CM_0 + c.ce * d)
    return T, L, D, M, q


def coupling(c: Any) -> Any:
    """G (3, 3) with (Q', eta1'', eta2'') = G (M, r1, r2): three readings of k_i in eq. 1, each solved exactly."""
    p1, p2, I = float(c.psi1), float(c.psi2), float(c.Iyy)
    if c.kmode == "parker":
        return np.linalg.inv(np.array([[I, -p1, -p2], [p1, 1, 0], [p2, 0, 1]]))
    t = (p1, p2) if c.kmode == "paper" else (p1 / I, p2 / I)
    k = p1 * p2 / I if c.kmode == "paper" else t[0] * t[1]
    weights = (p1 / I, p2 / I)
    left = np.array([[1, -weights[0], -weights[1]], [0, 1, k], [0, k, 1]])
    return np.linalg.solve(left, np.array([[1 / I, 0, 0], [-t[0] / I, 1, 0], [-t[1] / I, 0, 1]]))


def bending(c: Any, a: Any, d: Any, eta: Any) -> tuple[Any, Any]:
    """r1, r2 of eta (4, ...)."""
    N1 = c.N1_a2 * a**2 + c.N1_a * a + c.N1_0
    N2 = c.N2_a2 * a**2 + c.N2_a * a + c.N2_d * d + c.N2_0
    r1 = N1 - 2 * c.zeta * c.w1 * eta[1] - c.w1**2 * eta[0]
    return r1, N2 - 2 * c.zeta * c.w2 * eta[3] - c.w2**2 * eta[2]


def pitch_and_modes(c: Any, G: Any, M: Any, a: Any, d: Any, eta: Any) -> list[Any]:
    """Q', eta1'', eta2''; G (3, 3), or (3, 3, n) for n vehicles."""
    r1, r2 = bending(c, a, d, eta)
    return [G[i, 0] * M + G[i, 1] * r1 + G[i, 2] * r2 for i in range(3)]


def state_rates(c: Any, G: Any, x: Any, Phi: Any, d: Any, outside: Any = (0.0, 0.0, 0.0)) -> Any:
    """x' (9, ...); outside: moment, force along the path, force normal to it."""
    h, V, a, theta, Q = x[:5]
    T, L, D, M, _ = forces(c, h, V, a, Phi, d)
    gamma = theta - a
    V_rate = (T * np.cos(a) - D + outside[1]) / c.m - c.g * np.sin(gamma)
    turn = (T * np.sin(a) + L + outside[2]) / (c.m * V) - c.g / V * np.cos(gamma)
    Q_rate, one, two = pitch_and_modes(c, G, M + outside[0], a, d, x[5:])
    return np.stack([V * np.sin(gamma), V_rate, Q - turn, Q + 0 * h, Q_rate, x[6] + 0 * h, one, x[8] + 0 * h, two])


def invert(c: Any, h: Any, h_rate: Any, V: Any, a: Any, v1: Any, v2: Any) -> tuple[Any, Any]:
    """Phi and delta_e with h'' = v1 and V' = v2, by Newton's method."""
    sine = h_rate / V
    cosine = np.sqrt(1 - sine**2)
    normal = (v1 - v2 * sine) / cosine + c.g * cosine
    d = 0.2 + 0 * (v1 + v2 + h + a)
    for _ in range(7):
        _, L, D, _, q = forces(c, h, V, a, 0.0, d)
        off = (c.m * (v2 + c.g * sine) + D) * np.tan(a) + L - c.m * normal
        d = d - off / (q * c.S * ((2 * c.CD_d2 * d + c.CD_d) * np.tan(a) + c.CL_d))
    T0, _, D, _, _ = forces(c, h, V, a, 0.0, d)
    TP = forces(c, h, V, a, 1.0, d)[0] - T0
    return ((c.m * (v2 + c.g * sine) + D) / np.cos(a) - T0) / TP, d


def inner_rates(c: Any, G: Any, path: Any, zeta: Any) -> Any:
    """zeta' (6, ...) of zeta = (alpha, Q, eta...) while the path (h, h', V, h'', V') is kept exactly."""
    h, h_rate, V, v1, v2 = path
    Phi, d = invert(c, h, h_rate, V, zeta[0], v1, v2)
    M, sine = forces(c, h, V, zeta[0], Phi, d)[3], h_rate / V
    Q_rate, one, two = pitch_and_modes(c, G, M, zeta[0], d, zeta[2:])
    return np.stack([zeta[1] - (v1 - v2 * sine) / (V * np.sqrt(1 - sine**2)), Q_rate, zeta[3], one, zeta[5], two])


def trim(c: Any, h: float = H, V: float = V) -> tuple[Any, float, float]:
    """zeta (6,), Phi, delta_e of level flight."""

    def off(z: Any) -> Any:
        T, L, D, M, _ = forces(c, h, V, *z)
        along, normal = T * np.cos(z[0]) - D, T * np.sin(z[0]) + L - c.m * c.g
        return np.array([along / c.m, normal / c.m, M / c.Iyy])

    z: Any = fsolve(off, [0.03, 0.25, 0.2], xtol=1e-15)
    for _ in range(3):  # Newton's, to rounding
        slope = np.stack([off(z + 1e-30j * e).imag / 1e-30 for e in np.eye(3)], axis=1)
        z = z - np.linalg.solve(slope, off(z))
    return np.array([z[0], 0.0, *at_rest(c, z[0], z[2])]), float(z[1]), float(z[2])


def at_rest(c: Any, a: Any, d: Any) -> Any:
    """eta (4,) where the modes rest."""
    still = bending(c, a, d, np.zeros((4, *np.shape(a))))
    return np.array([still[0] / c.w1**2, 0 * still[0], still[1] / c.w2**2, 0 * still[1]])


def slope(f: Any, at: Any) -> Any:
    """df/dx by complex steps."""
    return np.stack([f(at + 1e-30j * e).imag / 1e-30 for e in np.eye(len(at))], axis=-1)


def error_model(c: Any) -> tuple[Any, Any]:
    """A (9, 9) and B (9, 2) of e = (h, h', V, alpha, Q, eta...), exactly linearised at level flight; eqs. 4-8."""
    G, (zeta, _, _) = coupling(c), trim(c)

    def rates(z: Any) -> Any:
        e, v = z[:9], z[9:]
        inner = inner_rates(c, G, (e[0], e[1], e[2], v[0], v[1]), e[3:])
        return np.concatenate([[e[1] + 0j, v[0] + 0j, v[1] + 0j], inner])

    J = slope(rates, np.concatenate([[H, 0.0, V], zeta, [0.0, 0.0]]))
    return J[:, :9], J[:, 9:]


def open_loop(c: Any) -> Any:
    """dx'/dx (9, 9) at level flight, the input held."""
    zeta, Phi, d = trim(c)
    x = np.array([H, V, zeta[0], zeta[0], 0.0, *zeta[2:]])
    return slope(lambda x: state_rates(c, coupling(c), x, Phi, d), x)


def input_slope(c: Any) -> Any:
    """d(h'', V')/d(Phi, delta_e) (2, 2) at level flight."""
    zeta, Phi, d = trim(c)

    def accelerations(u: Any) -> Any:
        T, L, D, _, _ = forces(c, H, V, zeta[0], u[0], u[1])
        return np.array([(T * np.sin(zeta[0]) + L) / c.m - c.g, (T * np.cos(zeta[0]) - D) / c.m])

    return slope(accelerations, np.array([Phi, d]))


def modal(c: Any) -> tuple[Any, Any]:
    """A_eta (4, 4) and C (4,) of eq. 9."""
    G, zero = coupling(c), 0.0
    rows = slope(lambda eta: np.stack(pitch_and_modes(c, G, zero, zero, zero, eta)), np.zeros(4))
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1], A[3] = rows[1], rows[2]
    return A, rows[0]


def forcing(c: Any, G: Any, h: Any, V: Any, a: Any, Phi: Any, d: Any) -> tuple[Any, Any, Any]:
    """b (4, ...), d and M/Iyy: what flight and input do to the modes, and to the measurement besides C eta."""
    M = forces(c, h, V, a, Phi, d)[3]
    Q_rate, one, two = pitch_and_modes(c, G, M, a, d, np.zeros((4, *np.shape(h))))
    return np.stack([0 * one, one, 0 * two, two]), Q_rate - M / c.Iyy, M / c.Iyy


def discrete(A: Any, q: Any, dt: float) -> tuple[Any, Any, Any]:
    """Ad, Bd, Qd of one period, by Simpson's rule over many parts."""
    parts = 400
    steps = [expm(A * dt * k / parts) for k in range(parts + 1)]
    weight = np.array([1, *[4, 2] * (parts // 2 - 1), 4, 1]) * dt / parts / 3
    Bd = sum(w * s for w, s in zip(weight, steps, strict=True))
    Qd = sum(w * s @ np.diag(q) @ s.T for w, s in zip(weight, steps, strict=True))
    return steps[-1], Bd, Qd


def steady_filter(c: Any, q: Any, r: float, dt: float = 0.005) -> tuple[Any, Any, Any]:
    """Ad, C and the steady gain (4,) of the discrete filter, its Riccati equation iterated until it stands."""
    A, C = modal(c)
    Ad, _, Qd = discrete(A, q, dt)
    P = np.eye(4)
    for _ in range(200_000):
        gain = P @ C / (C @ P @ C + r)
        new = Ad @ (P - np.outer(gain, C @ P)) @ Ad.T + Qd
        settled = np.abs(new - P).max() <= 1e-15 * np.abs(P).max()
        P = new
        if settled:
            break
    return Ad, C, P @ C / (C @ P @ C + r)


def observer(c: Any, density: float, q: float = 1e-5) -> tuple[Any, ...]:
    """A_eta, C, P_eta, L of the steady continuous filter, Q_eta = q I."""
    A, C = modal(c)
    P = solve_continuous_are(A.T, C[:, None], q * np.eye(4), [[density]])
    return A, C, P, P @ C / density


def regulator(A: Any, B: Any, strict: float = 1.0) -> tuple[Any, Any]:
    """K (2, n) of v = +K e, and P; with the integrals of the errors of h and V where A has 11 states."""
    q = strict * QE if len(A) == 9 else np.concatenate([QE, QI])
    size = np.sqrt(1 / q)
    P = solve_continuous_are(A / size[:, None] * size, B / size[:, None], np.eye(len(A)), np.diag(RE))
    P = P / np.outer(size, size)
    return -(B.T @ P) / RE[:, None], P


def with_integrals(A: Any, B: Any) -> tuple[Any, Any]:
    """A (11, 11), B (11, 2) with the integrals of the errors of h and V after the errors."""
    whole = np.zeros((11, 11))
    whole[:9, :9], whole[9, 0], whole[10, 2] = A, 1.0, 1.0
    return whole, np.vstack([B, np.zeros((2, 2))])


def least_weight(matrix: Any) -> float:
    """The least weight with which matrix(weight) is positive definite, by bisection."""

    def is_positive(weight: float) -> bool:
        z = matrix(weight)
        size = np.sqrt(np.abs(np.diag(z)))
        return bool(np.linalg.eigvalsh(z / np.outer(size, size))[0] > 0)

    low, high = 1e-6, 1e6
    for _ in range(80):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if is_positive(middle) else (middle, high)
    return float(high)


def weighted(A: Any, B: Any, strict: float, density: float, c: Any) -> Any:
    """weight -> z(weight) of eq. 15, corrected, in coordinates e_eta = P_eta w."""
    _, P = regulator(A, B, strict)
    _, C, Pn, _ = observer(c, density)
    W = P @ B @ np.diag(1 / RE) @ B.T @ P
    S = W[:, 5:] @ Pn / 2
    rest = 1e-5 * np.eye(4) + np.outer(Pn @ C, C @ Pn) / density
    return lambda weight: np.block([[np.diag(QE), S], [S.T, weight * rest]])


def decrease(A: Any, B: Any, robust: float, density: float, c: Any) -> Any:
    """weight -> -dV/dt as a matrix of (e, w), with the gain K + robust R_e^-1 B'P."""
    K, P = regulator(A, B)
    An, C, Pn, L = observer(c, density)
    K = K + robust * np.diag(1 / RE) @ B.T @ P
    fall = -(P @ (A + B @ K) + (A + B @ K).T @ P) / 2
    S = (P @ B @ K)[:, 5:] @ Pn / 2
    rest = -((An - np.outer(L, C)) @ Pn + Pn @ (An - np.outer(L, C)).T)
    return lambda weight: np.block([[fall, S], [S.T, weight * rest]])


def climb(t: Any, dh: float, dV: float, w: float = 0.06) -> Any:
    """h, h', V, h'', V' (5, n) at t: four equal lags for altitude, three for speed."""
    s = w * np.maximum(t - START, 0.0)
    e = np.exp(-s)
    h = H + dh * (1 - e * (1 + s + s**2 / 2 + s**3 / 6))
    speed = V + dV * (1 - e * (1 + s + s**2 / 2))
    return np.stack([h, dh * w * e * s**3 / 6, speed, dh * w**2 * e * (s**2 / 2 - s**3 / 6), dV * w * e * s**2 / 2])


def quasi_static(c: Any, path: Any) -> Any:
    """zeta (6, n) as though the path's accelerations stood still."""
    a = np.full(path.shape[1], 0.03)

    def moment(a: Any) -> Any:
        Phi, d = invert(c, *path[:3], a, *path[3:])
        return forces(c, path[0], path[2], a, Phi, d)[3]

    for _ in range(20):
        a = a - moment(a) / (moment(a + 1e-30j).imag / 1e-30)
    _, d = invert(c, *path[:3], a, *path[3:])
    sine = path[1] / path[2]
    turn = (path[3] - path[4] * sine) / (path[2] * np.sqrt(1 - sine**2))
    return np.stack([a, turn, *at_rest(c, a, d)])


def bounded(rates: Any, guess: Any, dt: float) -> Any:
    """The bounded solution zeta (6, n) of zeta' = rates(zeta), by the trapezoidal rule at all instants at once.

    Newton's method on the whole trajectory. Its ends: what decays starts as the guess does, what grows ends as it does.
    """
    z, n = guess.copy(), guess.shape[1]
    for _ in range(12):
        f = rates(z)
        J = np.stack([rates(z + 1e-30j * e[:, None]).imag / 1e-30 for e in np.eye(6)], axis=1)  # (6, 6, n)
        J = np.broadcast_to(J, (6, 6, n))
        rows, columns, values = [], [], []
        i, j = np.meshgrid(range(6), range(6), indexing="ij")
        for shift, sign in ((0, -1.0), (1, 1.0)):
            k = np.arange(n - 1)
            block = sign * np.eye(6)[:, :, None] - dt / 2 * J[:, :, shift : n - 1 + shift]
            rows.append((5 + 6 * k + i[..., None]).ravel())
            columns.append((6 * (k + shift) + j[..., None]).ravel())
            values.append(block.ravel())
        off = np.zeros(6 * n)
        off[5 : 5 + 6 * (n - 1)] = (z[:, 1:] - z[:, :-1] - dt / 2 * (f[:, 1:] + f[:, :-1])).T.ravel()
        for place, at, unstable in ((0, 0, False), (6 * n - 1, n - 1, True)):
            poles, left = np.linalg.eig(J[:, :, at].T)
            wanted = (poles.real > 0) == unstable
            basis = np.concatenate([left[:, wanted].real.T, left[:, wanted & (poles.imag > 0)].imag.T])
            conditions = np.linalg.svd(basis)[2][: 1 if unstable else 5]
            for r, condition in enumerate(conditions):
                rows.append(np.full(6, place + r))
                columns.append(6 * at + np.arange(6))
                values.append(condition)
                off[place + r] = condition @ (z[:, at] - guess[:, at])
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        change = splu(coo_matrix(entries, shape=(6 * n, 6 * n)).tocsc()).solve(off).reshape(n, 6).T
        z = z - change
        if np.abs(change).max() < 1e-11:
            return z
    raise ArithmeticError("no bounded solution was found")


def inner_motion(c: Any, t: Any, dh: float, dV: float) -> Any:
    """The bounded solution (6, n) along a climb; t must reach some seconds beyond what is used."""
    path, G = climb(t, dh, dV), coupling(c)
    return bounded(lambda z: inner_rates(c, G, path, z), quasi_static(c, path), t[1] - t[0])


def linear_inner_motion(c: Any, t: Any, dh: float, dV: float) -> Any:
    """The same of the inner dynamics linearised about the trim at the start."""
    path, (A, B), (zeta, _, _) = climb(t, dh, dV), error_model(c), trim(c)
    drive = A[3:, :3] @ (path[:3] - np.array([H, 0.0, V])[:, None]) + B[3:] @ path[3:]
    still = zeta[:, None] - np.linalg.solve(A[3:, 3:], drive)
    guess = np.repeat(zeta[:, None], len(t), axis=1)
    guess[:, -1] = still[:, -1]
    return bounded(lambda z: A[3:, 3:] @ (z - zeta[:, None]) + drive, guess, t[1] - t[0])

"""Every number that a row of basis "reference" in studies/hypersonic2022 compares with, by the row's id."""

import math
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, sqrtm

from oracles.hypersonic import (
    A_PRINTED,
    B_PRINTED,
    ETA0,
    GROUND,
    K_PRINTED,
    QUOTED,
    H,
    V,
    at_rest,
    climb,
    coupling,
    decrease,
    error_model,
    forces,
    forcing,
    inner_motion,
    input_slope,
    least_weight,
    modal,
    observer,
    open_loop,
    regulator,
    state_rates,
    steady_filter,
    trim,
    vehicle,
    weighted,
)
from oracles.hypersonic_flights import CLIMBS, Flight, fly

READINGS = ("parker", "paper", "author")
Values = dict[str, Any]


def quick_values() -> Values:
    """All that needs no flight: some seconds."""
    c = vehicle()
    return {
        **_trims(c),
        **_linear(c),
        **_inner(c),
        **_filter(c),
        **_gains(c),
        **_printed(),
    }


def _trims(c: Any) -> Values:
    (zeta, Phi, d), heavy = trim(c), trim(vehicle(g=GROUND))
    found: Values = {"trim/alpha": np.rad2deg(zeta[0]), "trim/Phi": Phi, "trim/delta_e": np.rad2deg(d)}
    found |= {"trim/eta1": zeta[2], "trim/eta2": zeta[4]}
    found |= {
        "gravity/alpha": np.rad2deg(heavy[0][0]),
        "gravity/Phi": heavy[1],
        "gravity/delta_e": np.rad2deg(heavy[2]),
    }
    found["gravity/value"] = c.g
    T, L, D, _, q = forces(c, H, V, zeta[0], Phi, d)
    found |= {"forces/qbar": q, "forces/T": T, "forces/L": L, "forces/D": D, "forces/weight": c.m * c.g}
    a, Phi, d = QUOTED
    eta = at_rest(c, a, d)
    x = np.array([H, V, a, a, 0.0, *eta])
    rates = state_rates(c, coupling(c), x, Phi, d)
    found |= {"quoted/V-rate": rates[1], "quoted/normal": -rates[2] * V}
    found |= {"quoted/moment": forces(c, H, V, a, Phi, d)[3] / c.Iyy, "quoted/eta1": eta[0], "quoted/eta2": eta[2]}
    found |= {f"loop/{k}": coupling(vehicle(kmode=k)).ravel() for k in READINGS}
    return found


def _linear(c: Any) -> Values:
    A, B = error_model(c)
    found: Values = {f"exact/{i}": np.concatenate([A[i - 1], B[i - 1]]) for i in (5, 7, 9)}
    G, (_, _, d) = input_slope(c), trim(c)
    found |= {f"slope/{i + 1},{j + 1}": G[i, j] for i, j in np.ndindex(2, 2)}
    found["slope/determinant"] = np.linalg.det(G)
    found["slope/secant"] = forces(c, H, V, 0.0, 0.0, 0.0)[4] * c.S / c.m * (c.CD_d2 * d + c.CD_d)
    for kmode in READINGS:
        found |= _poles(f"internal/{kmode}", np.linalg.eigvals(error_model(vehicle(kmode=kmode))[0][3:, 3:]))
    return found | _poles("open-loop", np.linalg.eigvals(open_loop(c)))


def _poles(name: str, poles: Any) -> Values:
    """Those with an imaginary part that is not negative, the rightmost first: real and imaginary parts by turns."""
    kept = sorted((p for p in poles if p.imag > -1e-9), key=lambda p: (-round(p.real, 9), p.imag))
    return {name: np.ravel([(p.real, abs(p.imag)) for p in kept])}


def _inner(c: Any) -> Values:
    t = 0.005 * np.arange(round(68.0 / 0.005) + 1)
    at = round(30.0 / 0.005)
    path, zeta = climb(t[at : at + 1], *CLIMBS["large"]), inner_motion(c, t, *CLIMBS["large"])
    found: Values = {"command/h": path[0, 0], "command/V": path[2, 0]}
    names = ("alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
    return found | {f"at-30-s/{name}": value for name, value in zip(names, zeta[:, at], strict=True)}


def _filter(c: Any) -> Values:
    (A, C), (zeta, Phi, d_e) = modal(c), trim(c)
    size = 20.0 ** np.arange(4)
    found: Values = {
        "model/rank": np.linalg.matrix_rank([C @ np.linalg.matrix_power(A, k) / size[k] for k in range(4)])
    }
    for kmode in READINGS:
        Ak, Ck = modal(vehicle(kmode=kmode))
        found[f"model/gramian-{kmode}"] = np.linalg.cond(solve_continuous_lyapunov(Ak.T, -np.outer(Ck, Ck)))
    found |= _poles("model/poles", np.linalg.eigvals(A))
    d = float(forcing(c, coupling(c), H, V, zeta[0], Phi, d_e)[1])
    found |= {"model/C-eta": C @ zeta[2:], "model/d": d}
    Ad, C, L = steady_filter(c, (1e-5,) * 4, 1e-4)
    bias = -np.linalg.solve(np.eye(4) - (np.eye(4) - np.outer(L, C)) @ Ad, L * d)
    found |= {"model/bias-1": bias[1], "model/bias-2": bias[3]}
    found |= {"model/first-1": ETA0[0] - zeta[2], "model/first-2": ETA0[2] - zeta[4]}
    found["constant/open"] = -1 / np.linalg.eigvals(A).real.max()
    Ad, C, L = steady_filter(c, (1e-5,) * 4, 10.0)
    found["constant/printed"] = -0.005 / np.log(np.abs(np.linalg.eigvals(Ad - Ad @ np.outer(L, C))).max())
    for density in (10.0, 1e-5, 1e-7, 1e-8):
        A, C, _, L = observer(c, density)
        found[f"constant/{density:g}"] = -1 / np.linalg.eigvals(A - np.outer(L, C)).real.max()
    return found


def _gains(c: Any) -> Values:
    A, B = error_model(c)
    K, P = regulator(A, B)
    found: Values = {"gain/K": K.ravel(), **_poles("gain/poles", np.linalg.eigvals(A + B @ K))}
    blind = K * (np.arange(9) < 5)
    found["gain/blind"] = np.linalg.eigvals(A + B @ blind).real.max()
    for strict in (1.0, 1.01):
        for density in (10.0, 5e-7):
            found[f"weight/{strict:g}-{density:g}"] = least_weight(weighted(A, B, strict, density, c))
    for density in (10.0, 5e-7):
        _, C, Pn, _ = observer(c, density)
        inverse = np.linalg.inv(Pn)
        Pi = inverse @ (1e-5 * np.eye(4)) @ inverse + np.outer(C, C) / density
        root = np.real(sqrtm(1e-6 * Pi))
        reach = (P @ B)[5:]
        printed = np.block([[-(root + root.T), reach], [reach.T, -np.diag((1 / 100.0, 1 / 25.0))]])
        found[f"printed-15/{density:g}"] = np.linalg.eigvalsh(printed).max()
    for name, factor in (("published", 0.5), ("minus", 1.5)):
        found[f"u_h/{name}"] = np.linalg.eigvals(A + factor * B @ K).real.max()
    for name, robust in (("published", 0.5), ("off", 0.0), ("minus", -0.5)):
        found[f"decrease/{name}"] = least_weight(decrease(A, B, robust, 10.0, c))
    return found


def _printed() -> Values:
    """Spectra of what is printed, with either sign and mended."""
    damped = A_PRINTED.copy()
    damped[6, 6], damped[8, 8] = -damped[6, 6], -damped[8, 8]
    uncoupled = damped.copy()
    uncoupled[4, 5:] = 0.0
    BK = B_PRINTED @ K_PRINTED
    matrices = {"plus": A_PRINTED + BK, "minus": A_PRINTED - BK, "rigid": (A_PRINTED - BK)[:5, :5]}
    matrices |= {"damped": damped - BK, "uncoupled": uncoupled - BK}
    found: Values = {}
    for name, matrix in matrices.items():
        found |= _poles(f"spectrum/{name}", np.linalg.eigvals(matrix))
    poles = np.linalg.eigvals(A_PRINTED)
    found["damping/1"] = max(p.real for p in poles if 16 < p.imag < 17)
    found["damping/2"] = max(p.real for p in poles if 19 < p.imag < 21)
    return found


def flown_values() -> Values:
    """All that is flown: some minutes."""
    return {**_long_flights(), **_disturbed(), **_short_flights(), **_noisy()}


def _rms(values: Any) -> Any:
    return np.sqrt(np.mean(np.asarray(values) ** 2, axis=-1))


MISMATCH = {"CL_a": 0.05, "CM_a": -0.05, "CD_0": 0.10, "m": 0.02, "b7": -0.05}
OPTIONS: dict[str, dict[str, Any]] = {
    "off": {},
    "published": {"robust": "published"},
    "minus": {"robust": "minus"},
    "smooth": {"robust": "smooth"},
    "sign": {"robust": "sign"},
    "integral": {"integral": True},
    "leak/wide": {"robust": "smooth", "constants": (10.0, 0.02, 1.0, 20.0)},
    "leak/shipped": {"robust": "smooth", "constants": (10.0, 0.02, 0.01, 20.0)},
    "chatter": {"robust": "sign", "constants": (100.0, 0.0, 0.01, 1e9)},
}


def _plant(times: float) -> tuple[tuple[str, float], ...]:
    c = vehicle()
    return tuple((name, getattr(c, name) * (1 + times * part)) for name, part in MISMATCH.items())


def _long_flights() -> Values:
    """200 s without noise; errors count after 20 s."""
    c = vehicle()
    weaker = (("psi1", 0.8 * c.psi1), ("psi2", 0.8 * c.psi2))
    flights = {f"nominal/{CLIMBS[n][0]:g}": Flight(n, "printed") for n in ("small", "medium", "large", "largest")}
    flights |= {f"reading/{k}": Flight("medium", "printed", kmode=k) for k in ("paper", "author")}
    flights |= {f"mismatch/{n}": Flight("medium", "printed", _plant(1.0), **more) for n, more in OPTIONS.items()}
    flights |= {f"mismatch/times{k:g}": Flight("medium", "printed", _plant(k)) for k in (-3.0, 4.0)}
    flights |= {"coupling/weaker": Flight("medium", "tuned", weaker), "true": Flight("medium", "printed", sees="truth")}
    flights |= {f"tracking/{k}": Flight("large", "tuned", inner=k) for k in ("quasi-static", "linear")}
    r = fly(list(flights.values()), 200.0)
    late, until = r["t"] > 20.0, r["t"] <= 60.0
    found: Values = {}
    for i, name in enumerate(flights):
        h, speed = r["h"][i], r["V"][i]
        if name == "true":
            found["period/true-state"] = _rms(h[late & until])
            continue
        found[f"{name}/h"] = _rms(h[late])
        if name.startswith(("nominal", "mismatch")) and "leak" not in name and "times" not in name:
            found |= {f"{name}/V": _rms(speed[late]), f"{name}/saturated": r["saturated"][i]}
        if name == "tracking/quasi-static":
            found[f"{name}/peak"] = np.abs(h[late]).max()
        if name == "tracking/linear":
            found[f"{name}/end"] = h[r["t"] > 190.0].mean()
        if name == "mismatch/integral":
            found[f"{name}/last"] = h[-1]
        if name == "nominal/3000":
            found["period/5-ms"] = _rms(h[late & until])
        if name == "nominal/10000":
            found["nominal/fuel"] = r["Phi"][i].max()
        if name == "mismatch/chatter":
            early = np.abs(h[(r["t"] > 50) & (r["t"] < 60)]).mean()
            found[f"{name}/grows"] = np.abs(h[r["t"] > 190]).mean() / early
    return found


def _disturbed() -> Values:
    """100 s of cruise, disturbed after 20 s; and first errors, 80 s."""
    c, on = vehicle(), 20.0
    cases = {
        "impulse/moment": (0.4 * c.Iyy, 0.0, 0.0, on, 0.05),
        "impulse/normal-force": (0.0, 0.0, 20.0 / 0.05 * c.m, on, 0.05),
        "step/moment": (500.0, 0.0, 0.0, on, 1e9),
        "step/large-moment": (5000.0, 0.0, 0.0, on, 1e9),
        "step/drag": (0.0, -88.0, 0.0, on, 1e9),
        "step/lift": (0.0, 0.0, -0.02 * c.m * c.g, on, 1e9),
    }
    starts = {"h": (1000.0, 0.0, 0.0), "V": (0.0, 50.0, 0.0), "alpha": (0.0, 0.0, math.radians(2.0))}
    starts |= {"low-500": (-500.0, 0.0, 0.0), "low": (-1000.0, 0.0, 0.0)}
    flights = {n: Flight("cruise", outside=o) for n, o in cases.items()}
    flights |= {f"{n}/integral": Flight("cruise", outside=o, integral=True) for n, o in cases.items()}
    flights |= {"filter/printed": Flight("cruise", "printed", outside=cases["impulse/moment"])}
    flights |= {f"first/{n}": Flight("cruise", start=o) for n, o in starts.items()}
    r = fly(list(flights.values()), 100.0)
    late, found = r["t"] > on, {}
    for i, name in enumerate(flights):
        h, speed = r["h"][i], r["V"][i]
        mode = np.abs(r["estimate"][i] - r["eta"][i])[:, 0]
        if name.startswith("first/"):
            at = round(80.0 / 0.02)
            back = abs(h[at]) < 0.01 and abs(speed[at]) < 0.01
            found[name] = back
            continue
        found |= {f"{name}/peak-h": np.abs(h[late]).max(), f"{name}/peak-V": np.abs(speed[late]).max()}
        last = r["t"] > 90.0
        found |= {f"{name}/end-h": h[last].mean(), f"{name}/end-V": speed[last].mean()}
        found |= {f"{name}/saturated": r["saturated"][i], f"{name}/mode": mode[late].max()}
        outside = np.flatnonzero((np.abs(h) > 1.0) & late)
        found[f"{name}/inside"] = r["t"][outside[-1]] - on if len(outside) else 0.0
        swing = np.degrees(r["delta"][i][late])
        found |= {f"{name}/elevator": (swing.min(), swing.max())}
    return found


def _short_flights() -> Values:
    """Other periods; the printed gain; the filter's errors without noise."""
    found: Values = {}
    for period in (10, 20):
        r = fly([Flight("medium", "printed")], 60.0, dt=period / 1000, every=20 // period)
        found[f"period/{period}-ms"] = _rms(r["h"][0, r["t"] > 20.0])
    r = fly([Flight("small", "printed", K=sign * K_PRINTED) for sign in (-1.0, 1.0)], 20.0)
    for i, name in enumerate(("minus", "plus")):
        gone = ~(np.abs(np.degrees(r["alpha"][i])) <= 10.0)
        found[f"flight/{name}"] = r["t"][gone.argmax()] if gone.any() else math.inf
    r = fly([Flight("cruise", name) for name in ("none", "printed")], 10.0, every=1)
    for i, name in enumerate(("none", "printed")):
        found |= _windows(name, (r["estimate"] - r["eta"])[i : i + 1], spread=False)
    return found


def _windows(name: str, off: Any, spread: bool) -> Values:
    """rms errors (4) over 0-1, 4-5 and 9-10 s; with the mean and the deviation of seeds where there are several."""
    found: Values = {}
    for begin, end in ((0, 1), (4, 5), (9, 10)):
        rms = np.sqrt((off[:, 200 * begin : 200 * end] ** 2).mean(axis=1))
        key = f"table/{name}/{begin}-{end}"
        found[key] = np.concatenate([rms.mean(axis=0), rms.std(axis=0, ddof=1)]) if spread else rms[0]
    return found


SEEDS = 40


def _noisy() -> Values:
    """Noise of 0.01 rad/s^2 a sample: mean and deviation over SEEDS seeds of its own."""
    found: Values = {}
    for k, name in enumerate(("accurate", "tuned")):
        r = fly([Flight("cruise", name, noise=0.01)] * SEEDS, 10.0, seed=k, every=1)
        found |= _windows(name, r["estimate"] - r["eta"], spread=True)
    c = vehicle()
    kinds = {f"noise/{n}": Flight("large", n, noise=0.01) for n in ("tuned", "brisk")}
    for f in (0.9, 1.1):
        plant = (("w1", f * c.w1), ("w2", f * c.w2))
        kinds[f"modes/{f:.2f}"] = Flight("medium", "tuned", plant, noise=0.01)
    quiet = [Flight("large", n) for n in ("tuned", "brisk")]
    r = fly([f for f in kinds.values() for _ in range(SEEDS)] + quiet, 60.0, seed=2)
    late = r["t"] > 20.0
    for k, name in enumerate(kinds):
        mine = slice(SEEDS * k, SEEDS * (k + 1))
        for signal in ("h", "V"):
            found[f"{name}/{signal}"] = _mean_and_deviation(_rms(r[signal][mine][:, late]))
        if name.startswith("noise/"):
            delta = np.degrees(r["delta"][mine][:, late])
            without = np.degrees(r["delta"][4 * SEEDS + k, late])
            found[f"{name}/elevator"] = _mean_and_deviation(delta.std(axis=1))
            found[f"{name}/elevator-noise"] = _mean_and_deviation((delta - without).std(axis=1))
    return found


def _mean_and_deviation(values: Any) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1))

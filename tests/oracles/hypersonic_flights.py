"""Closed loops of the hypersonic vehicle, many at once: plant, filter of the modes, law, noise.

Sampled every 5 ms where not said; the plant moves by Runge and Kutta's rule. At an instant: the acceleration is
measured under the input held so far, the filter corrects, the law gives the next input, the filter predicts with it.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 7, 9, 13, 16-18, corrected as the page of its errata says. Settings that it
does not print are those of the study: they are given, not computed.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from oracles.hypersonic import (
    ETA0,
    NUMBERS,
    RE,
    H,
    V,
    at_rest,
    climb,
    coupling,
    discrete,
    error_model,
    forcing,
    inner_motion,
    invert,
    linear_inner_motion,
    modal,
    quasi_static,
    regulator,
    state_rates,
    trim,
    vehicle,
    with_integrals,
)

LIMITS = (0.02, 1.5), (math.radians(-20.0), math.radians(25.8))
SIZES = np.array([100.0, 20.0, 20.0, 0.01, 0.02, 0.2, 2.0, 0.2, 2.0])
CLIMBS = {"small": (1000.0, 200.0), "medium": (3000.0, 500.0), "large": (5000.0, 1000.0), "largest": (10000.0, 1500.0)}
CLIMBS["cruise"] = (0.0, 0.0)
FILTERS = {
    "printed": ((1e-5,) * 4, 10.0, (1.0,) * 4),
    "accurate": ((1e-5,) * 4, 1e-4, (1.0,) * 4),
    "tuned": ((1e-5, 100.0, 1e-5, 100.0), 1e-4, (1.0, 100.0, 1.0, 100.0)),
    "brisk": ((1e-5, 1.0, 1e-5, 1.0), 1e-4, (1.0, 100.0, 1.0, 100.0)),
    "none": ((0.0,) * 4, math.inf, (1.0,) * 4),
}
"""Q, diagonal; variance of a sample; P(0), diagonal."""


@dataclasses.dataclass(frozen=True)
class Flight:
    """One flight. plant: numbers that differ from the model.  start: added to the first (h, V, alpha).

    outside: moment, force along, force normal, start and length of a disturbance.  robust: form; constants: its q0,
    leak, width and cap.  sees: "filter", or "truth" in the place of the estimate.  K: instead of the regulator's.
    """

    climb: str = "medium"
    filter: str = "tuned"
    plant: tuple[tuple[str, float], ...] = ()
    kmode: str = "parker"
    inner: str = "bounded"
    integral: bool = False
    robust: str = "off"
    constants: tuple[float, float, float, float] = (10.0, 0.0, 0.01, 20.0)
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    outside: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    sees: str = "filter"
    noise: float = 0.0
    K: Any = None


def fly(flights: list[Flight], length: float, seed: int = 0, dt: float = 0.005, every: int = 4) -> dict[str, Any]:
    """Signals (flights, samples) by name, every so many instants; and `saturated` (flights,), `t` (samples,)."""
    n, steps = len(flights), round(length / dt)
    crafts = [vehicle(**dict(f.plant), kmode=f.kmode) for f in flights]
    c = vehicle(**{k: np.array([getattr(v, k) for v in crafts]) for k in NUMBERS if k != "kmode"})
    G = np.stack([coupling(v) for v in crafts], axis=-1)
    model, Gm = vehicle(), np.stack([coupling(vehicle(kmode=f.kmode)) for f in flights], axis=-1)
    t = dt * np.arange(steps + 1)
    path = np.stack([climb(t, *CLIMBS[f.climb]) for f in flights], axis=-1)  # (5, instants, n)
    inner = np.stack([_inner(f, t, dt) for f in flights], axis=-1)
    K, Ki = _gains(flights)
    s = _start(flights, crafts, c, n)
    modes = _modes(flights, dt)
    outside = np.array([f.outside for f in flights]).T
    draw = np.random.default_rng(seed)
    noise = np.array([f.noise for f in flights])
    logs: dict[str, list[Any]] = {name: [] for name in ("h", "V", "Phi", "delta", "alpha", "eta", "estimate")}
    saturated = np.zeros(n, bool)
    sub = max(1, round(dt / 0.005))
    for k in range(steps + 1):
        chi = s.x[0], s.x[1] * np.sin(s.x[3] - s.x[2]), s.x[1], s.x[2], s.x[4]
        active = (t[k] - outside[3] + 1e-9 >= 0) & (t[k] - outside[3] + 1e-9 < outside[4])
        felt = state_rates(c, G, s.x, s.Phi, s.d, outside[:3] * active)[4] + noise * draw.standard_normal(n)
        _correct(s, modes, model, Gm, chi, felt, k > 0)
        eta = np.where(np.array([f.sees == "truth" for f in flights]), s.x[5:], s.eta)
        e = np.concatenate([np.stack(chi), eta]) - np.concatenate([path[:3, k], inner[:, k]])
        limited = _steer(s, flights, model, K, Ki, path[:, k], chi, e, dt if k else 0.0)
        saturated |= limited
        s.chi = chi
        if k % every == 0:
            for name, value in zip(logs, (e[0], e[2], s.Phi, s.d, s.x[2], s.x[5:], s.eta), strict=True):
                logs[name].append(np.array(value))
        for j in range(sub):
            with np.errstate(all="ignore"):
                s.x = _move(c, G, s, t[k] + j * dt / sub, dt / sub, outside)
    found: dict[str, Any] = {name: np.moveaxis(np.stack(rows), -1, 0) for name, rows in logs.items()}
    return found | {"saturated": saturated, "t": t[::every]}


class _Memory:
    """What a flight remembers: x, held input, estimate and its covariance, bounds, integrals."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)


def _inner(f: Flight, t: Any, dt: float) -> Any:
    """Wanted inner states (6, instants), cached by what they depend on."""
    key = f.climb, f.kmode, f.inner, len(t), dt
    if key not in _KEPT:
        c, (dh, dV) = vehicle(kmode=f.kmode), CLIMBS[f.climb]
        fine = max(1, round(dt / 0.005))
        step = dt / fine
        long = step * np.arange((len(t) - 1) * fine + 1 + round(8.0 / step))
        if f.climb == "cruise":
            found = np.repeat(trim(c)[0][:, None], len(t), axis=1)
        elif f.inner == "quasi-static":
            found = quasi_static(c, climb(t, dh, dV))
        else:
            solve = inner_motion if f.inner == "bounded" else linear_inner_motion
            found = solve(c, long, dh, dV)[:, : fine * (len(t) - 1) + 1 : fine]
        _KEPT[key] = found
    return _KEPT[key]


_KEPT: dict[Any, Any] = {}


def _gains(flights: list[Flight]) -> tuple[Any, Any]:
    A, B = error_model(vehicle())
    plain, _ = regulator(A, B)
    whole, _ = regulator(*with_integrals(A, B))
    K = [f.K if f.K is not None else whole[:, :9] if f.integral else plain for f in flights]
    return np.stack(K, axis=-1), np.stack([whole[:, 9:] * f.integral for f in flights], axis=-1)


def _start(flights: list[Flight], crafts: list[Any], c: Any, n: int) -> Any:
    zeta, Phi, d = trim(vehicle())
    x = np.stack([[H, V, zeta[0], zeta[0], 0.0, *at_rest(one, zeta[0], d)] for one in crafts], axis=-1)
    off = np.array([f.start for f in flights]).T
    x[0], x[1], x[2], x[3] = x[0] + off[0], x[1] + off[1], x[2] + off[2], x[3] + off[2]
    P = np.stack([np.diag(FILTERS[f.filter][2]) for f in flights])
    held = np.full(n, Phi), np.full(n, d)
    zero = np.zeros(n)
    return _Memory(
        x=x,
        Phi=held[0],
        d=held[1],
        eta=np.repeat(ETA0[:, None], n, axis=1),
        P=P,
        rho=[zero, zero],
        sum=np.zeros((2, n)),
    )


def _modes(flights: list[Flight], dt: float) -> Any:
    kinds = {(f.filter, f.kmode) for f in flights}
    found = {}
    for name, kmode in kinds:
        A, C = modal(vehicle(kmode=kmode))
        found[name, kmode] = (*discrete(A, FILTERS[name][0], dt), C, FILTERS[name][1])
    each = [found[f.filter, f.kmode] for f in flights]
    return [np.stack([one[i] for one in each]) for i in range(5)]  # Ad, Bd, Qd, C, R


def _correct(s: Any, modes: Any, model: Any, G: Any, chi: Any, felt: Any, predicts: bool) -> None:
    """The filter, from the last instant to this one: predict with the input since, then correct."""
    Ad, Bd, Qd, C, R = modes
    if predicts:
        b, _, _ = forcing(model, G, s.chi[0], s.chi[2], s.chi[3], s.Phi, s.d)
        s.eta = np.einsum("nij,jn->in", Ad, s.eta) + np.einsum("nij,jn->in", Bd, b)
        s.P = Ad @ s.P @ Ad.transpose(0, 2, 1) + Qd
    _, d, rigid = forcing(model, G, chi[0], chi[2], chi[3], s.Phi, s.d)
    PC = np.einsum("nij,nj->ni", s.P, C)
    L = PC / (np.einsum("ni,ni->n", C, PC) + R)[:, None]
    s.eta = s.eta + L.T * (felt - rigid - np.einsum("ni,in->n", C, s.eta) - d)
    s.P = s.P - L[:, :, None] * PC[:, None, :]


def _steer(s: Any, flights: Any, model: Any, K: Any, Ki: Any, path: Any, chi: Any, e: Any, dt: float) -> Any:
    """Eqs. 13, 16-18 and the exact inversion; whether a limit holds the input."""
    K9 = np.einsum("ijn,jn->in", K, e)
    v = path[3:] + K9 + np.einsum("ijn,jn->in", Ki, s.sum)
    terms = [f.robust for f in flights]
    rate = [np.zeros(len(terms)), np.zeros(len(terms))]
    if set(terms) != {"off"}:
        sv = -(np.stack([K[:, :, i] @ e[:, i] for i in range(len(terms))], axis=1)) * RE[:, None]
        v = v + np.array([{"published": 0.5, "minus": -0.5}.get(name, 0.0) for name in terms]) * sv / RE[:, None]
        q0, leak, width, cap = np.array([f.constants for f in flights]).T
        size, length = np.linalg.norm(e / SIZES[:, None], axis=0), np.linalg.norm(sv, axis=0)
        on = np.array([name in ("smooth", "sign") for name in terms])
        shape = np.where([name == "sign" for name in terms], np.sign(sv), sv / (length + width))
        v = v - on * (s.rho[0] + s.rho[1] * size) * shape
        rate = [on * q0 * (length - leak * s.rho[0]), on * 0.01 * (size * length - leak * s.rho[1])]
    with np.errstate(all="ignore"):
        Phi, d = invert(model, *chi[:4], *v)
        s.Phi, s.d = np.clip(Phi, *LIMITS[0]), np.clip(d, *LIMITS[1])
    usable = np.isfinite(Phi) & np.isfinite(d)
    limited = (s.Phi != Phi) | (s.d != d) | ~usable
    s.Phi, s.d = np.where(usable, s.Phi, LIMITS[0][0]), np.where(usable, s.d, 0.0)
    if set(terms) != {"off"}:
        s.rho = [np.where(limited, r, np.clip(r + dt * g, 0.0, cap)) for r, g in zip(s.rho, rate, strict=True)]
    s.sum = np.where(limited, s.sum, s.sum + dt * e[[0, 2]])
    return limited


def _move(c: Any, G: Any, s: Any, t: float, dt: float, outside: Any) -> Any:
    def rates(at: float, x: Any) -> Any:
        active = (at - outside[3] + 1e-9 >= 0) & (at - outside[3] + 1e-9 < outside[4])
        return state_rates(c, G, x, s.Phi, s.d, outside[:3] * active)

    a = rates(t, s.x)
    b = rates(t + dt / 2, s.x + dt / 2 * a)
    e = rates(t + dt / 2, s.x + dt / 2 * b)
    return s.x + dt / 6 * (a + 2 * b + 2 * e + rates(t + dt, s.x + dt * e))

"""The hovercraft, independent of the package: laws, limit points, ideal flights, fan and spin-up, by NumPy and SciPy.

`python tests/oracles/hovercraft.py` writes studies/hovercraft2006/reference.json anew: row of the study -> value. A
test holds the table against this program, and rows of basis "reference" hold the package against the table.

Momenta are not used: states are u, v (m/s), r (rad/s), heading (rad), arrays with the component first.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006: eqs. 2.10 to 2.69,
4.3, 4.4, tables 4.2 and 6.1 to 6.4, sections 2.2, 2.3, 4.3 and 6.1, corrected as the page of its errata says.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

TABLE = Path(__file__).parents[2] / "studies/hovercraft2006/reference.json"
M, J, ARM = 2.6, 0.096, 0.32
STEP = 1e-3
TOLERANCE = math.pi / 180
Force = Callable[[Any], Any]


def rest(x: Any, k1: float = 1.0, k2: float = 2.5) -> Any:
    """Eq. 2.16, table 6.1: FX, FY."""
    return np.array([-k1 * x[0], -k2 * (x[1] - ARM * x[2])])


def forward(x: Any, k1: float = 1.0, k2: float = 4.0, momentum: float = 2.8) -> Any:
    """Eq. 2.24, table 6.2."""
    return np.array([-k1 * (x[0] - momentum / M), -k2 * (x[1] - ARM * x[2])])


def reverse(x: Any, k1: float = 1.5, k2: float = 1.0, theta: float = 1.44, momentum: float = -1.98) -> Any:
    """Eq. 2.30, table 6.3."""
    return np.array([-k1 * (x[0] - momentum / M), k2 * (x[1] + theta * ARM * x[2])])


def spin(x: Any, reference: Any = 3.0, k1: float = 0.5, k2: float = 3.5) -> Any:
    """Eq. 2.39, table 6.4."""
    return np.array([-k1 * x[0], -k2 * (x[1] - ARM * (x[2] - reference))])


def rates(x: Any, force: Any) -> Any:
    """Eqs. 2.10 and 2.11: derivative of u, v, r, heading under FX, FY at the rudder pivot."""
    u, v, r = x[:3]
    FX, FY = force
    return np.stack([v * r + FX / M, -u * r + FY / M, -ARM * FY / J, r])


def fly(law: Force, start: tuple[float, ...], duration: float) -> tuple[Any, Any]:
    """Times and states (4, samples) of a flight; the force is held for a millisecond, four Runge-Kutta stages."""
    x = np.array([*start, 0.0])
    states = [x]
    for _ in range(round(duration / STEP)):
        x = _advance(x, law(x))
        states.append(x)
    return STEP * np.arange(len(states)), np.array(states).T


def _advance(x: Any, force: Any) -> Any:
    a = rates(x, force)
    b = rates(x + STEP / 2 * a, force)
    c = rates(x + STEP / 2 * b, force)
    d = rates(x + STEP * c, force)
    return x + STEP / 6 * (a + 2 * b + 2 * c + d)


def closed_loop_eigenvalues(law: Force, at: tuple[float, float, float]) -> Any:
    """Of u, v, r where the law rests, from central differences, which are exact for products of two."""

    def f(x: Any) -> Any:
        return rates(np.array([*x, 0.0]), law(x))[:3]

    h, x = 1e-3, np.array(at)
    assert np.abs(f(x)).max() < 1e-12
    return np.linalg.eigvals(np.array([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(3)]).T)


def spin_value(u: Any, v: Any, r: Any, reference: float) -> Any:
    """W about a reference (J), eq. 2.37."""
    return M * (u * u + v * v) / 2 + J * (r - reference) ** 2 / 2


def bad_value(reference: float) -> float:
    """W at the bad limit point, where the vehicle slides at -d times the reference and doesn't turn."""
    slide = -ARM * reference
    assert np.abs(rates([0, slide, 0, 0], spin(np.array([0, slide, 0.0]), reference))).max() < 1e-12
    return float(spin_value(0.0, slide, 0.0, reference))


def switching_energies(reference: float) -> tuple[float, float]:
    """Kinetic energy below which the spin law is safe: with the root of eq. 2.47 that is printed, and the largest.

    The largest: no state of that energy has W above its bad value. By search over all shares of the energy in yaw.
    """
    D = ARM**2 * M

    def published(eps: float) -> float:
        return 2 * math.sqrt(2 * eps * (J**3 + D * J**2)) / D - J * reference

    def worst(eps: float) -> float:
        shares = np.linspace(0, 1, 2001)
        v, r = np.sqrt(2 * eps * (1 - shares) / M), -np.sqrt(2 * eps * shares / J)
        return float(spin_value(0.0, v, r, reference).max()) - bad_value(reference)

    return _root(published, 1e-6, 50.0), _root(worst, 1e-6, 50.0)


def _root(f: Callable[[float], float], low: float, high: float) -> float:
    """Between two ends where f differs in sign, by halving."""
    sign = math.copysign(1.0, f(low))
    assert sign * f(high) < 0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if sign * f(middle) > 0 else (low, middle)
    return low


def provision(W: float, reference: float) -> float:
    """Smaller reference that is just safe from the worst state of W, without linear momentum: root of eq. 2.66."""
    rate = math.sqrt(2 * W / J) + abs(reference)
    return _root(lambda new: spin_value(0, 0, rate, new) - bad_value(new), 1e-9, rate)


def slow_slope() -> float:
    """Slope (s) of 1/(2 r^2) of the rest law between 1000 and 2000 s, from the start of fig. 6.7."""

    def f(t: float, x: Any) -> Any:
        return rates(np.array([*x, 0.0]), rest(x))[:3]

    t = np.linspace(1000, 2000, 1001)
    x = solve_ivp(f, (0, 2000), [0.2, -0.7, 6.4], method="LSODA", t_eval=t, rtol=1e-10, atol=1e-14).y
    return float(np.polyfit(t, 1 / (2 * x[2] ** 2), 1)[0])


def thrust(speed_rpm: Any, rudder: Any) -> Any:
    """Signed thrust (N): quadratic, eq. 4.4 in reverse from 6000 rpm on, less with the rudder (rad)."""
    n = np.abs(speed_rpm) / 1000
    ratio = np.polyval([9.734e-4, -3.277e-2, 3.833e-1, -1.099], np.clip(n, 6, 12))
    return 1.6 / 144 * n**2 * np.where(speed_rpm < 0, -ratio, 1.0) * np.cos(rudder - np.radians(0.566))


def spin_up_slope() -> float:
    """Yaw acceleration (rad/s²) at rest under 1 N with the rudder at -30 deg, eq. 4.3."""
    psi = math.radians((0.566 + 30) / 1.40)
    return ARM * math.sin(psi) / J


def turn(kind: str, start: Any, target: float, duration: float, keep: Callable[[float], bool]) -> dict[str, Any]:
    """Heading algorithms of section 2.3 with 1.5 rad/s or 1/s, tables 6.1 and 6.4, both without a floor.

    Args:
        kind: "bang-bang" or "proportional".
        start: u, v, r, heading, each (runs,).
        target: heading (rad).
        duration: of the flight (s).
        keep: which times (s) to give back.

    Returns t (samples,) and per sample and run: error, u, v, r, heading, reference (rad/s), turning; switches (runs,).
    """
    x = np.array(start, float)
    reference, turning = np.zeros(x.shape[1]), np.zeros(x.shape[1], bool)
    switches = np.zeros(x.shape[1], int)
    D, out, times = ARM**2 * M, [], []
    for n in range(round(duration / STEP) + 1):
        e, r = x[3] - target, x[2]
        far, V = np.abs(e) > TOLERANCE, spin_value(x[0], x[1], r, 0.0)
        size = np.full_like(e, 1.5) if kind == "bang-bang" else np.abs(e)
        aim = -np.sign(e) * size
        begin = ~turning & far & (D**2 * aim**2 / (8 * (J + D)) > V)
        end = turning & (~far | (e * reference > 0))
        if kind == "proportional":
            A = np.sqrt(2 * spin_value(x[0], x[1], r, reference) / J) + np.abs(reference)
            next_aim = -np.sign(e) * np.maximum(A * math.sqrt(J) * (math.sqrt(J + D) - math.sqrt(J)) / D, size)
        else:
            next_aim = reference
        reference = np.where(~turning & far, aim, np.where(turning & ~end, next_aim, reference))
        turning = begin | (turning & ~end)
        switches += begin | end
        if keep(n * STEP):
            times.append(n * STEP)
            out.append([e, *x, reference, turning])
        x = _advance(x, np.where(turning, spin(x, reference), rest(x)))
    names = ("error", "u", "v", "r", "heading", "reference", "turning")
    values = np.moveaxis(np.array(out, float), 1, 0)
    return dict(zip(names, values, strict=True)) | {"t": np.array(times), "switches": switches}


def random_starts(runs: int = 200) -> Any:
    """The starts of the study's runs about 1 rad: u, v, r, heading, each (runs,)."""
    draws = np.random.default_rng(0)
    u, v, r = draws.uniform(-1, 1, (3, runs)) * [[1.0], [1.0], [5.0]]
    return np.stack([u, v, r, 1 + draws.uniform(-np.pi, np.pi, runs)])


def _law_values() -> dict[str, float]:
    laws: dict[str, tuple[Force, tuple[float, float, float]]] = {
        "rest": (rest, (0, 0, 0)),
        "forward": (forward, (2.8 / M, 0, 0)),
        "reverse": (reverse, (-1.98 / M, 0, 0)),
        "spin": (spin, (0, 0, 3.0)),
    }
    values = {}
    for name, (law, at) in laws.items():
        roots = sorted(closed_loop_eigenvalues(law, at), key=lambda s: (s.real, -s.imag))
        for n, s in enumerate((s for s in roots if s.imag > -1e-9), 1):
            values[f"eigenvalues/{name}-{n}"] = s.real
            if s.imag > 1e-6:
                values[f"eigenvalues/{name}-{n}-imaginary"] = s.imag

    def least_damping(theta: float) -> float:
        return closed_loop_eigenvalues(lambda x: reverse(x, theta=theta), (-1.98 / M, 0, 0)).real.max()

    eps, sharp = switching_energies(3.0)
    return values | {
        "theta/least": _root(least_damping, 0.1, 1.0),
        "spin/W-bad": bad_value(3.0),
        "spin/eps": eps,
        "spin/eps-slower": switching_energies(1.5)[0],
        "spin/eps-sharp": sharp / eps,
        "spin/provision": provision(0.0, 1.0),
        "spin/provision-swinging": provision(0.2, 2.0),
        "rest/slow-slope": slow_slope(),
    }


def _flight_values() -> dict[str, float]:
    values = {}
    t, x = fly(rest, (0.2, -0.7, 6.4), 15)
    values["fig-6.7/ideal-least-surge_velocity"] = x[0].min()
    values["fig-6.7/ideal-greatest-surge_velocity"] = x[0].max()
    values["fig-6.7/ideal-greatest-sway_velocity"] = x[1].max()
    values["fig-6.7/ideal-stop"] = t[np.abs(x[2]) < 0.32][0]
    t, x = fly(spin, (0, 0, 0.1), 22)
    for n, name in enumerate(("surge_velocity", "sway_velocity", "yaw_rate")):
        if name != "yaw_rate":
            values[f"fig-6.10/ideal-least-{name}"] = x[n].min()
        values[f"fig-6.10/ideal-greatest-{name}"] = x[n].max()
    return values


def _heading_values() -> dict[str, float]:
    values = {}
    for short, kind in (("bang", "bang-bang"), ("prop", "proportional")):
        run = turn(kind, np.zeros((4, 1)), 1.0, 35, lambda t: True)
        error = np.abs(run["error"][:, 0])
        values[f"fig-6.12/{short}-time"] = run["t"][error <= TOLERANCE][0]
        values[f"fig-6.12/{short}-error"] = error[run["t"] > 30].mean() if short == "bang" else error[-1]
        values[f"fig-6.12/{short}-sway"] = abs(run["v"][-1, 0])
        if short == "bang":
            values["fig-6.12/bang-least-rate"] = run["r"].min()
            values["fig-6.12/bang-greatest-rate"] = run["r"].max()
        sliding = turn(kind, [[0.4], [1.2], [4.1], [0.0]], 5.0, 35, lambda t: t > 34.9995)
        values[f"fig-6.11/{kind}"] = sliding["heading"][-1, 0]
    late = turn("proportional", random_starts(), 1.0, 60, lambda t: t >= 49.9995 and round(t / STEP) % 10 == 0)
    error = np.degrees(np.abs(late["error"][-1]))
    still = np.abs(late["r"]).max(axis=0) < 0.05
    values["heading/freezes"] = (still & (late["turning"][-1] > 0) & (error > 1)).mean()
    values["heading/freezes-at"], values["heading/freezes-within"] = np.quantile(error, (0.5, 0.95))
    return values


def compute(headings: bool = True) -> dict[str, float]:
    """Row -> value, with or without those of the heading algorithms, which take half a minute."""
    fan = {f"thrust/reverse-{n}": -float(thrust(-1e3 * n, 0.1) / thrust(1e3 * n, 0.1)) for n in (6, 8, 10, 12)}
    values = _law_values() | fan | {"fig-4.6/slope": spin_up_slope()} | _flight_values()
    values |= _heading_values() if headings else {}
    return {name: float(value) for name, value in values.items()}


if __name__ == "__main__":
    TABLE.write_text(json.dumps(compute(), indent=1) + "\n", encoding="utf-8")

"""Filter of the modes: its model, the printed setting, and other settings compared with no measurement at all.

Errors are those of a cruise with the loop closed at 200 Hz, from the printed initial estimate. **Every setting is
compared with the observer without measurement**, whose errors vanish within ten seconds too, by structural damping.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 9 and below.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_are

from studies.hypersonic2022._flights import CRUISE, FLIGHT_DIGITS, MODES, build_climb, fly_seeds
from studies.hypersonic2022._oracle import oracle_number, pole_error, reference, reference_seeds
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms
from trimtab.design.lqr import kalman_bucy
from trimtab.design.observability import constant_rank
from trimtab.estimators.flexible.discrete import PRINTED_ETA0, FlexibleModeFilter
from trimtab.estimators.flexible.model import RigidFlight, forcing, modal_dynamics
from trimtab.scenarios.hypersonic._internal import level_trim
from trimtab.study import Row, at_most, direction, same, within
from trimtab.vehicles.hypersonic import Hypersonic
from trimtab.vehicles.hypersonic_aerodynamics import KMODES
from trimtab.vehicles.hypersonic_printed import QUOTED_H, QUOTED_V

SECTION = "eq. 9"
PLACE = "[1] eq. 9 and below"
DENSITIES = 10.0, 1e-5, 1e-7, 1e-8
"""Noise densities (rad^2/s^3) that are compared, with Q = 1e-5 I."""
WINDOWS = ((0, 1), (4, 5), (9, 10))
"""Time windows, start and end (s), in which errors are compared."""
UNITS = "(slug ft)^1/2", "(slug ft)^1/2/s"
WORDS = {
    "none": "no measurement at all",
    "printed": "printed Q, R = 10, no noise",
    "accurate": "Q = 1e-5 I, R = 1e-4, noise",
    "tuned": "tuned, noise",
}
SEEDS = 20
INPUT: Any = {"basis": "input"}


def rows() -> Iterator[Row]:
    """Yield rows on settings, numbers of the model, time constants, errors by setting, and the printed claim."""
    yield from _settings()
    yield from _model()
    yield from _constants()
    yield from _table()
    yield from _claims()


def _settings() -> Iterator[Row]:
    """Yield the printed settings of the filter, compared with those of the filter that is flown as "printed"."""
    flown, place = FlexibleModeFilter.from_publication(), "[1] settings of the filter"
    names, about = ("η1", "η1'", "η2", "η2'"), INPUT
    for name, want, got in zip(names, (1.5122, 0.0, 1.122, 0.0), np.asarray(flown.eta0), strict=True):
        yield within(f"settings/first-{name}", f"initial estimate of {name}", want, got, place, **about)
    yield within("settings/Q", "diagonal of Q_η(0)", 1e-5, np.unique(np.asarray(flown.Q)).item(), place, **about)
    note = "Printed as a 2 x 2 matrix, although there is only one measurement."
    yield within("settings/R", "diagonal of R_η(0)", 10.0, flown.R, place, note=note, **about)


def _model() -> Iterator[Row]:
    A, C = _modes()
    found = constant_rank(A, C[None])
    rank = round(oracle_number("model/rank"))
    yield same("model/rank", "rank of the observability matrix", rank, found.rank, PLACE, basis="reference")
    note = "Computed without scaling. With states scaled by their sizes it is below 2, so it says little."
    for kmode in KMODES:
        A_k, C_k = _modes(kmode)
        gram = np.linalg.cond(solve_continuous_lyapunov(A_k.T, -np.outer(C_k, C_k)))
        what = f"condition number of the observability Gramian, reading {kmode!r}"
        yield reference(f"model/gramian-{kmode}", what, gram, PLACE, relative=1e-5, note=note)
    off = pole_error(np.linalg.eigvals(A), "model/poles")
    yield at_most(
        "model/poles", "largest error of the poles of A_eta", 0.0, off, PLACE, high=1e-7, unit="1/s", basis="reference"
    )
    at = level_trim(Hypersonic(), QUOTED_H, QUOTED_V)
    d = float(forcing(Hypersonic(), RigidFlight(at.h, 0.0, at.V, at.zeta[0], 0.0), at.u)[1])
    yield reference("model/C-eta", "C eta at the trim", C @ at.zeta[2:], PLACE, unit="rad/s^2")
    note = "The printed innovation has no such term."
    yield reference("model/d", "d at the trim", d, PLACE, note=note, unit="rad/s^2")
    for i, got in ((1, _steady_bias(d)[1]), (2, _steady_bias(d)[3])):
        what = f"η{i}' minus its estimate if the innovation omits d, R = 1e-4"
        yield reference(f"model/bias-{i}", what, got, PLACE, relative=1e-5, unit="(slug ft)^1/2/s")
    for i in (1, 2):
        got = PRINTED_ETA0[2 * i - 2] - at.zeta[2 * i]
        yield reference(
            f"model/first-{i}", f"printed initial estimate of η{i} minus its trim", got, PLACE, unit=UNITS[0]
        )


@cache
def _modes(kmode: str = "parker") -> tuple[Any, Any]:
    craft = Hypersonic()
    A, C = modal_dynamics(replace(craft, modes=replace(craft.modes, kmode=kmode)))
    return np.asarray(A), np.asarray(C)


def _steady_bias(d: float) -> Any:
    """Return the steady error (4,), truth minus estimate, of the accurate filter if its innovation omits d."""
    Ad, C, L = _steady_filter(FlexibleModeFilter.for_exact_model())
    return -np.linalg.solve(np.eye(4) - (np.eye(4) - L @ C) @ Ad, L[:, 0] * d)


def _steady_filter(one: FlexibleModeFilter) -> tuple[Any, Any, Any]:
    """Return Ad, C (1, 4) and the steady gain (4, 1) of the discrete filter."""
    model = to_arrays(one).model()
    Ad, Qd, C = np.asarray(model.Ad), np.asarray(model.Qd), np.asarray(model.C)[None]
    P = solve_discrete_are(Ad.T, C.T, Qd, np.array([[float(one.R)]]))
    return Ad, C, P @ C.T / (C @ P @ C.T + float(one.R))


def _constants() -> Iterator[Row]:
    """Yield the slowest time constants."""
    A, C = _modes()
    alone = _slowest_time_constant(A)
    yield reference("constant/open", "modes alone, slowest time constant", alone, PLACE, unit="s")
    Ad, C1, L = _steady_filter(FlexibleModeFilter.from_publication())
    held = float(np.abs(np.linalg.eigvals(Ad - Ad @ L @ C1)).max())
    what = "printed filter, sampled as in flight, slowest time constant"
    note = f"The modes alone have {alone:.4f} s, so the filter adds no damping."
    about: Any = {"relative": 1e-6, "unit": "s"}
    yield reference("constant/printed", what, -0.005 / np.log(held), PLACE, note=note, **about)
    for density in DENSITIES:
        steady = kalman_bucy(A, C[None], 1e-5 * np.eye(4), density)
        what = f"continuous filter with Q = 1e-5 I, R = {density:g} rad²/s³, slowest time constant"
        got = _slowest_time_constant(A - steady.L @ C[None])
        yield reference(f"constant/{density:g}", what, got, PLACE, **about)


def _slowest_time_constant(A: Any) -> float:
    return float(-1 / np.linalg.eigvals(A).real.max())


@cache
def estimate_errors(name: str) -> Any:
    """Return errors of the estimate (seeds, samples, 4) over the first 10 s of a cruise, every 5 ms."""
    noisy = name in ("accurate", "tuned")
    scenario = build_climb(CRUISE, filter="equal" if name == "tuned" else name, noise="on" if noisy else "off")
    flown = fly_seeds(scenario, SEEDS if noisy else 1, 10.0, ms(5))
    return np.stack([flown[f"estimate.state.{n}"] - flown[f"truth.{n}"] for n in MODES], axis=-1)


def _rms(name: str, begin: int, end: int) -> Any:
    """Return the rms error of the estimate of each seed over begin <= t < end (s), (seeds, 4)."""
    return np.sqrt((estimate_errors(name)[:, 200 * begin : 200 * end] ** 2).mean(axis=1))


def _table() -> Iterator[Row]:
    for name, words in WORDS.items():
        for begin, end in WINDOWS:
            found, beside = _rms(name, begin, end), _rms("none", begin, end)[0]
            for i, mode in enumerate(MODES):
                key = f"table/{name}/{begin}-{end}"
                what = f"{words}: error of {mode.replace('_rate', chr(39))}, {begin}-{end} s"
                note = "" if name == "none" else f"Without measurement: {beside[i]:.3g}."
                about: Any = {"name": key, "part": i, "unit": UNITS[i % 2], "note": note}
                if name in ("none", "printed"):
                    yield reference(f"{key}/{mode}", what, found[0, i], PLACE, relative=FLIGHT_DIGITS, **about)
                else:
                    about["note"] += f" Mean of {SEEDS} seeds, compared with the oracle's 40."
                    yield reference_seeds(f"{key}/{mode}", what, found[:, i], PLACE, **about)


def _claims() -> Iterator[Row]:
    """Yield the printed claim, which holds without any measurement as well, and the errors of a working filter."""
    place = "[1] simulation: errors of the estimate converge in about 10 s"
    note = "The claim holds without any measurement, by structural damping with a time constant of 3.3 s."
    for name, basis in (("printed", "text"), ("none", "own")):
        ratio = float((_rms(name, 9, 10) / _rms(name, 0, 1)).max())
        what = f"{WORDS[name]}: error at 9-10 s divided by that at 0-1 s, largest"
        yield direction(f"claim/{name}", what, "converges", ratio, place, below=0.08, note=note, basis=basis)
    gain = _rms("none", 4, 5)[0] / _rms("accurate", 4, 5)
    for words, part, least in (("mode 1", gain[:, :2], 10.0), ("mode 2", gain[:, 2:], 8.0)):
        what = f"Q = 1e-5 I, R = 1e-4: error without / with measurement, 4-5 s, {words}, worst of {SEEDS} seeds"
        id = f"claim/works-{words.replace(' ', '-')}"
        yield direction(id, what, "the filter works", float(part.min()), PLACE, above=least, basis="own")

"""Elevator activity from noise of the accelerometer, against tracking and against errors of the modal frequencies.

[1] has no noise. These rows compare flights of this package with its own requirements and with linear theory. The
flights are the large climb with 0.01 rad/s^2 of noise per sample, for 20 seeds, evaluated after 20 s.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from studies.hypersonic2022._linear_loop import DETUNED, Quality, loop_quality, widest_error
from studies.hypersonic2022._trade import (
    ACCURATE,
    BETTER,
    EQUAL,
    EQUAL_SETTINGS,
    PRINTED,
    SEEDS,
    Activity,
    DetunedErrors,
    Setting,
    fly_detuned,
    fly_noise,
    fly_offsets,
    trade_curve,
    weighted_gain,
)
from trimtab.study import Row, at_most, direction, inside, same, within

SECTION = "further work"
PLACE = "[1] further work: noise"
HIGHEST = 0.3
"""Largest accepted elevator activity (deg rms)."""
TRACKING, SPEED = (0.008, 0.027), 0.0024
"""Required rms error of h (ft), and largest error of V (ft/s)."""
FLOWN: Any = {"basis": "own"}
FEWER = Setting("300 on mode 1, 5 on mode 2", (1e-5, 300.0, 1e-5, 5.0))
GAINS = (
    ("h'' dearer, half", {"h": 0.5}),
    ("h'' cheaper, twice", {"h": 2.0}),
    ("V' cheaper, twice", {"V": 2.0}),
    ("modes weighed, 10", {"modes": 10.0}),
    ("modes weighed, 3", {"modes": 3.0}),
)
"""Other weights of the regulator: description, and arguments of `weighted_gain`."""


def rows() -> Iterator[Row]:
    """Yield rows on equal noise on both modes, the trade-off curve, better settings, and other gains."""
    yield from _shipped_rows()
    yield from _errors_of_the_modes()
    yield from _curve()
    yield from _better_rows()
    yield from _gain()


def figures(folder: Path) -> Iterator[Path]:
    """Plot elevator activity against tracking and against robustness."""
    from studies.hypersonic2022._trade_picture import draw_trade

    yield draw_trade(folder)


@cache
def _activity_by_name() -> dict[str, Activity]:
    return {setting.name: found for setting, found in trade_curve()}


@cache
def _detuned_by_name() -> dict[str, DetunedErrors]:
    settings = (EQUAL, BETTER, EQUAL_SETTINGS[0], ACCURATE, PRINTED)
    return dict(zip((s.name for s in settings), fly_detuned(settings), strict=True))


def _shipped_rows() -> Iterator[Row]:
    found = _activity_by_name()[EQUAL.name]
    most = np.rad2deg(found.elevator.max())
    about: Any = {"unit": "deg", "note": "Worst of 20 seeds. The climb's own demand is excluded.", **FLOWN}
    yield at_most(
        "shipped/elevator", "equal noise, elevator rms from noise", HIGHEST, most, PLACE, high=HIGHEST, **about
    )
    ends = found.h.min(), found.h.max()
    yield inside("shipped/h", "equal noise, h error rms", TRACKING, ends, PLACE, unit="ft", **FLOWN)
    V = found.V.max()
    yield at_most("shipped/V", "equal noise, V error rms", SPEED, V, PLACE, high=SPEED, unit="ft/s", **FLOWN)


def _errors_of_the_modes() -> Iterator[Row]:
    """Yield flights with the plant's modal frequencies 10 % off: in the same or opposite directions, or one alone."""
    each, runs = _detuned_by_name(), len(DETUNED) * SEEDS
    mine = each[EQUAL.name]
    words = f"modes 10 % off, equal noise: runs outside the envelope, of {runs}"
    yield same("modes/shipped", words, 0, int(mine.lost.sum()), PLACE, **FLOWN)
    high = TRACKING[1]
    words = "modes 10 % off, equal noise: h error rms, worst run"
    yield at_most("modes/shipped-h", words, high, mine.h.max(), PLACE, high=high, unit="ft", **FLOWN)
    note = "Largest over the last 10 s of any run."
    words = "modes 10 % off, equal noise: error of eta1"
    unit = "(slug ft)^1/2"
    yield at_most("modes/shipped-eta1", words, 0.32, mine.eta1.max(), PLACE, high=0.5, unit=unit, note=note, **FLOWN)
    note = "Equal noise on both modes prevents these losses."
    for name, setting in (("printed", PRINTED), ("accurate", ACCURATE)):
        words = f"modes 10 % off, filter {setting.name}: runs outside the envelope, of {runs}"
        lost = float(each[setting.name].lost.sum())
        yield direction(f"modes/{name}", words, "most are lost", lost, PLACE, above=runs / 2, note=note, **FLOWN)
    words = "modes 10 % off, 1 on both modes: h error rms, worst run"
    worst = each[EQUAL_SETTINGS[0].name].h.max()
    note = "Least elevator activity of all, but unstable at 0.90: the oscillation still grows when the climb ends."
    yield direction("modes/slow", words, "much", worst, PLACE, above=1.0, unit="ft", note=note, **FLOWN)


def _curve() -> Iterator[Row]:
    """Yield each setting's simulated elevator activity, compared with its linear prediction."""
    for setting, found in trade_curve():
        theory = loop_quality(setting.Q, setting.R)
        tracked = f"h error rms {_rms(found.h):.4f} ft, from noise alone {_rms(found.h_noise):.4f}; "
        about: Any = {"unit": "deg", "note": tracked + _describe_robustness(setting, theory), **FLOWN}
        values = np.rad2deg(theory.elevator), np.rad2deg(_rms(found.elevator))
        id, what = f"curve/{setting.name.split(':')[-1].strip()}", f"Qacc {setting.name}, elevator rms from noise"
        yield within(id, what, *values, PLACE, relative=0.05, **about)
    fast = EQUAL_SETTINGS[-1]
    note = "A lasting second-order effect: a quarter at half the noise. So a faster filter does not track better."
    means = [float(np.mean(a.offset)) for a in fly_noise((fast,), 4)]
    half = [float(np.mean(a.offset)) for a in fly_noise((fast,), 4, 0.005)]
    words = "Qacc 1000 on both modes: offset of h due to noise, divided by that at half the noise"
    yield within("curve/rectified", words, 4.0, means[0] / half[0], PLACE, relative=0.05, note=note, **FLOWN)


def _better_rows() -> Iterator[Row]:
    """Yield the setting with Qacc raised for mode 1 and lowered for mode 2."""
    flown, old = _activity_by_name()[BETTER.name], _activity_by_name()[EQUAL.name]
    new, shipped = loop_quality(BETTER.Q), loop_quality(EQUAL.Q)
    name, about = BETTER.name, FLOWN
    deg = [float(np.rad2deg(_rms(a.elevator))) for a in (flown, old)]
    words = f"Qacc {name}, elevator rms from noise"
    yield direction(
        "better/elevator", words, "less than with equal noise", deg[0], PLACE, below=deg[1], unit="deg", **about
    )
    h = [_rms(a.h) for a in (flown, old)]
    yield direction(
        "better/h",
        f"Qacc {name}, h error rms",
        "less than with equal noise",
        h[0],
        PLACE,
        below=h[1],
        unit="ft",
        **about,
    )
    words = f"Qacc {name}, slowest motion with modes 10 % off"
    ends = new.worst, shipped.worst
    yield direction(
        "better/growth",
        words,
        "decays faster than with equal noise",
        ends[0],
        PLACE,
        below=ends[1],
        unit="1/s",
        **about,
    )
    words = f"Qacc {name}, largest error of the modal frequencies with a stable loop"
    reach = 100 * widest_error(BETTER.Q, BETTER.R), 100 * widest_error(EQUAL.Q, EQUAL.R)
    yield direction(
        "better/reach", words, "wider than with equal noise", reach[0], PLACE, above=reach[1], unit="%", **about
    )
    words = f"modes 10 % off, Qacc {name}: runs outside the envelope, of {len(DETUNED) * SEEDS}"
    yield same("better/lost", words, 0, int(_detuned_by_name()[BETTER.name].lost.sum()), PLACE, **about)
    words = f"modes 10 % off, Qacc {name}: error of eta1"
    eta = [float(_detuned_by_name()[s.name].eta1.max()) for s in (BETTER, EQUAL)]
    note = "This is the cost of the setting."
    unit = "(slug ft)^1/2"
    more = "more than with equal noise"
    yield direction("better/eta1", words, more, eta[0], PLACE, above=eta[1], unit=unit, note=note, **about)
    least = _activity_by_name()[FEWER.name]
    note = "Least elevator activity on the curve with which every seed tracks as required."
    words = f"Qacc {FEWER.name}, h error rms, worst seed, elevator {np.rad2deg(_rms(least.elevator)):.3f} deg"
    high = TRACKING[1]
    yield at_most("better/fewest", words, high, least.h.max(), PLACE, high=high, unit="ft", note=note, **about)


def _gain() -> Iterator[Row]:
    """Yield flights with other weights of the regulator, with equal noise on both modes."""
    settings = [Setting(what, EQUAL.Q, K=weighted_gain(**weights)) for what, weights in GAINS]
    for setting, found, (h, _) in zip(settings, fly_noise(settings), fly_offsets(settings), strict=True):
        theory = loop_quality(setting.Q, setting.R, setting.K)
        tracked = f"h error rms {_rms(found.h):.4f} ft, V {_rms(found.V):.4f} ft/s; "
        held = f"{h:.1f} ft of offset under 5000 lbf; {_describe_robustness(setting, theory)}"
        about: Any = {"unit": "deg", "note": tracked + held, **FLOWN}
        values = np.rad2deg(theory.elevator), np.rad2deg(_rms(found.elevator))
        what = f"weights: {setting.name}; elevator rms from noise"
        yield within(f"gain/{setting.name}", what, *values, PLACE, relative=0.05, **about)


def _describe_robustness(setting: Setting, theory: Quality) -> str:
    reach = 100 * widest_error(setting.Q, setting.R, setting.K)
    return f"modes 10 % off: {theory.worst:+.3f} 1/s, stable to {reach:.1f} %"


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))

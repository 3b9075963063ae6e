"""Impulses, steps and errors of all coefficients: probability of success, and ranking of the coefficients.

[1] names these as further work and has no figures of them. Rows compare with the statements of this package's docs
page, in `printed`. Intervals are those of Clopper and Pearson, 95 %.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.hypersonic2022._campaign import COEFFICIENTS, KINDS, NAMES, FlightOutcomes, draw_factors, fly_plants
from studies.hypersonic2022._campaign_picture import draw_ranking, draw_success
from studies.hypersonic2022._campaign_ranking import (
    failure_thresholds,
    rank_correlation,
    rank_names,
    sobol_indices,
)
from studies.hypersonic2022._campaign_sizes import EACH, RANKED, SEED, SIZES, fly_size, success_proportion
from studies.hypersonic2022._linear_loop import growth_rate
from studies.hypersonic2022._trade import BETTER
from trimtab.estimators.flexible.discrete import EQUAL_Q
from trimtab.study import Row, at_most, band, direction, overlaps, same, within

SECTION = "further work"
PLACE = "[1] further work: impulse, step, parameters"
STATED = {
    False: ((64, 72), (34, 43), (19, 27), (11, 18), (6, 12), (4, 9)),
    True: ((99, 100), (99, 100), (96, 99), (87, 92), (72, 80), (60, 68)),
}
"""Integral action -> confidence interval of the success rate (%) at each of SIZES."""
LEADING = {True: "w2", False: "ce"}
"""Integral action -> most important coefficient."""
STATED_TOTALS = {
    True: {"w2": 0.676, "ce": 0.287, "rho0": 0.203, "m": 0.203, "CM_0": 0.203, "CL_d": 0.186},
    False: {"ce": 0.935, "m": 0.656, "CM_0": 0.574, "rho0": 0.525, "CL_a": 0.443, "CL_d": 0.361},
}
"""Integral action -> total index of the most important coefficients."""
WORST = "normal-force impulse"
"""Only disturbance that by itself makes more than a few flights fail."""
ABOUT: Any = {"basis": "own"}


def rows() -> Iterator[Row]:
    """Yield rows on success by size of the errors, by disturbance and with another filter, and on both rankings."""
    yield from _nominal()
    for integral in (False, True):
        yield from _success(integral)
    yield from _disturbances()
    yield from _filters()
    for integral in (True, False):
        yield from _ranking(integral)
    yield _linear()


def figures(folder: Path) -> Iterator[Path]:
    """Plot success by size, and the ranking."""
    yield draw_success(folder)
    yield draw_ranking(folder)


def _nominal() -> Iterator[Row]:
    for integral in (False, True):
        found = fly_plants(np.ones((len(KINDS), len(COEFFICIENTS))), np.arange(len(KINDS)), integral=integral)
        words = f"nominal plant, {_law_name(integral)}: disturbances with a successful flight"
        yield same(f"nominal/{_law_name(integral)}", words, len(KINDS), int(found.is_success.sum()), PLACE, **ABOUT)


def _success(integral: bool) -> Iterator[Row]:
    for size, stated in zip(SIZES, STATED[integral], strict=True):
        found = fly_size(size, integral)
        share = success_proportion(found)
        interval = 100 * share.low, 100 * share.high
        words = f"each coefficient ±{100 * size:.0f} %, {_law_name(integral)}: success"
        about: Any = {"unit": "%", "note": f"{share} of {share.trials}: {_format_failures(found)}", **ABOUT}
        yield overlaps(f"success/{_law_name(integral)}-{size}", words, stated, interval, PLACE, **about)


def _disturbances() -> Iterator[Row]:
    """Yield the failures that each disturbance adds, with the same plants and noise."""
    size, kinds = 0.20, np.arange(len(KINDS))
    factors = np.tile(draw_factors(size, EACH, SEED), (len(KINDS), 1))
    seeds = np.tile(np.arange(EACH), len(KINDS))
    found = fly_plants(factors, np.repeat(kinds, EACH), integral=True, seeds=seeds).is_success.reshape(len(KINDS), EACH)
    fails = {kind: int((found[0] & ~mine).sum()) for kind, mine in zip(KINDS[1:], found[1:], strict=True)}
    others = max(n for kind, n in fails.items() if kind != WORST)
    for kind, n in fails.items():
        words = f"each coefficient ±{100 * size:.0f} %, with integral action: flights lost only by a {kind}, of {EACH}"
        id, note = f"disturbance/{kind}", f"{found[0].sum()} succeed without disturbance."
        if kind == WORST:
            yield direction(id, words, "most of all", n, PLACE, above=others, note=note, **ABOUT)
        else:
            yield at_most(id, words, "hardly any", n, PLACE, high=0.02 * EACH, note=note, **ABOUT)


def _filters() -> Iterator[Row]:
    """Yield the failures with the filter of the elevator trade-off, for the same plants and noise."""
    for size in (0.15, 0.20, 0.30):
        shipped = fly_size(size, True)
        other = fly_size(size, True, EACH, BETTER.Q)
        words = f"each coefficient ±{100 * size:.0f} %, Qacc {BETTER.name}: failures"
        fails = [int((~o.is_success & ~o.lacks_trim).sum()) for o in (other, shipped)]
        apart = int((other.is_success & ~shipped.is_success).sum()), int((shipped.is_success & ~other.is_success).sum())
        note = f"Default filter: {fails[1]} failures. The other saves {apart[0]} flights and loses {apart[1]}."
        yield direction(
            f"filter/{size}",
            words,
            "fewer than with the default filter",
            fails[0],
            PLACE,
            below=fails[1],
            note=note,
            **ABOUT,
        )


def _ranking(integral: bool) -> Iterator[Row]:
    size = RANKED[integral]
    found, alone = sobol_indices(size, integral), failure_thresholds(integral)
    law, lead = _law_name(integral), LEADING[integral]
    by_index = rank_names(found.total[:-1], NAMES, most=True)
    by_threshold = rank_names(alone.least, NAMES, most=False)
    words = f"±{100 * size:.0f} %, {law}: most of the variance of success is due to"
    share = f"First-order index {found.first[NAMES.index(by_index[0])]:.2f}; {100 * found.share:.0f} % succeeded."
    yield same(f"ranking/{law}-index", words, lead, by_index[0], PLACE, note=share, **ABOUT)
    words = f"{law}: coefficient whose error alone fails first"
    each = [i for i in np.argsort(alone.least, kind="stable") if np.isfinite(alone.least[i])]
    limits = "Limits: " + "; ".join(
        f"{NAMES[i]} {_format_limit('-', alone.down[i])}, {_format_limit('+', alone.up[i])}" for i in each
    )
    note = f"{limits}. The other {len(NAMES) - len(each)} have no limit within ±90 %."
    yield same(f"ranking/{law}-alone", words, lead, by_threshold[0], PLACE, note=note, **ABOUT)
    for name in STATED_TOTALS[integral]:
        yield _share(name, integral)
    words = f"±{100 * size:.0f} %, {law}: total index of the kind of disturbance"
    most, kind = found.total[:-1].max(), found.total[-1]
    yield direction(f"ranking/{law}-kind", words, f"less than {lead}'s", kind, PLACE, below=most / 3, **ABOUT)
    common = sorted(set(by_index[:8]) & set(by_threshold[:8]))
    note = f"Among the first eight of both: {', '.join(common)}."
    words = f"{law}: rank correlation of both rankings"
    together = rank_correlation(found.total[:-1], alone.least)
    yield direction(f"ranking/{law}-agree", words, "they agree", together, PLACE, above=0.5, note=note, **ABOUT)


def _share(name: str, integral: bool) -> Row:
    """Return one coefficient's total index, with its interval, and its tolerance alone."""
    size, law, i = RANKED[integral], _law_name(integral), NAMES.index(name)
    found, alone = sobol_indices(size, integral), failure_thresholds(integral)
    note = f"{found.low[i]:.2f} to {found.high[i]:.2f}; first-order {found.first[i]:.2f}; alone: "
    note += f"{_format_limit('-', alone.down[i])}, {_format_limit('+', alone.up[i])}"
    words = f"±{100 * size:.0f} %, {law}: total index of {name}"
    about: Any = {"tolerance": 0.006, "note": note, **ABOUT}
    return within(f"index/{law}-{name}", words, STATED_TOTALS[integral][name], found.total[i], PLACE, **about)


def _linear() -> Row:
    """Return a row that compares the onset of instability of the linear loop with the failure of the flight."""
    low, high = 0.0, 0.4
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (middle, high) if growth_rate(EQUAL_Q, 1e-4, detuned=(1.0, 1 - middle)) < 0 else (low, middle)
    fails = 100 * float(failure_thresholds(False).down[NAMES.index("w2")])
    note = "Onset by bisection of the loop's eigenvalues. A flight of 100 s needs some growth before it fails."
    words = "w2 alone too low: decrease at which flight fails"
    about: Any = {"unit": "%", "note": note, **ABOUT}
    return band("linear/w2", words, 100 * low, fails, PLACE, low=100 * low, high=100 * low + 2.0, **about)


def _format_failures(found: FlightOutcomes) -> str:
    fair = ~found.lacks_trim
    lost, rest = fair & found.lost, fair & ~found.lost
    saturated = rest & found.is_saturated
    off = rest & ~found.is_saturated & found.is_off
    said = (
        f"{lost.sum()} left the envelope, {saturated.sum()} ended saturated, {off.sum()} ended with too large an error"
    )
    return (
        f"{said}; {found.lacks_trim.sum()} of {fair.size} plants cannot fly level" if found.lacks_trim.any() else said
    )


def _format_limit(sign: str, value: Any) -> str:
    return f"{sign}{100 * value:.1f} %" if np.isfinite(value) else f"no failure at {sign}90 %"


def _law_name(integral: bool) -> str:
    return "with integral action" if integral else "without integral action"

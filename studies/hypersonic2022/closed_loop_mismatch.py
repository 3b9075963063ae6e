"""Closed loop on a plant that differs from the model: feedback alone, robust terms, integral action.

The plant has 5 % more lift slope, 5 % less pitch stiffness, 10 % more drag, 2 % more mass and 5 % less thrust than the
law's model. The filter has the printed Q and R. Errors are rms values between 20 s and 200 s.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, its simulation; it prints neither the size of the uncertainty nor q0, q1, kappa_G.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import (
    FLIGHT_DIGITS,
    MEDIUM,
    RunSignals,
    build_climb,
    change_robust,
    fly_seeds,
)
from studies.hypersonic2022._oracle import oracle_number, reference, reference_flag
from trimtab.scenarios.hypersonic.mismatch import off_nominal_plant
from trimtab.study import INFINITY, Row, band, direction

SECTION = "simulation"
PLACE = "[1] simulation, parameter uncertainty"
ROBUST = {
    "off": "K only",
    "published": "u_h with the published sign",
    "minus": "u_h with the other sign",
    "smooth": "u_s smoothed, q0 = 10, no leak",
    "sign": "u_s with sgn, q0 = 10",
}
"""Robust terms -> description."""
SCALED = -3.0, 4.0
"""Factors of the mismatch."""
CHATTERS = 0.02
"""Relative tolerance of flights with sgn, whose switching instants depend on rounding."""
TUNED = "With the tuned filter {:.3g}: that filter takes part of the unmodelled moment for modal motion."


def rows() -> Iterator[Row]:
    """Yield each form of the law, the cost of a leak, sgn with a large q0, and scaled mismatches."""
    for name, words in ROBUST.items():
        yield from _errors(name, words, _fly_variant(name), float(_fly_variant(name, "equal").rms("law.h_error")[0]))
    yield from _order()
    integral = _fly_variant("off", integral="on")
    tuned = float(_fly_variant("off", "equal", "on").rms("law.h_error")[0])
    yield from _errors("integral", "integral action", integral, tuned)
    what, last = "integral action: error of h at the end", float(integral["law.h_error"][0, -1])
    yield reference("mismatch/integral/last", what, last, PLACE, relative=FLIGHT_DIGITS, tolerance=1e-5, unit="ft")
    yield from _leak()
    yield from _chatter()
    for times in SCALED:
        got = float(_fly_variant("off", times=times).rms("law.h_error")[0])
        what = f"K only, mismatch times {times:g}: error of h"
        yield reference(f"mismatch/times{times:g}/h", what, got, PLACE, relative=FLIGHT_DIGITS, unit="ft")


def _build_scenario(robust: str, filter: str = "printed", integral: str = "off", times: float = 1.0) -> Any:
    options: dict[str, Any] = {"robust": robust, "filter": filter, "integral": integral}
    return build_climb(MEDIUM, plant=off_nominal_plant(times), **options)


@cache
def _fly_variant(robust: str, filter: str = "printed", integral: str = "off", times: float = 1.0) -> RunSignals:
    return fly_seeds(_build_scenario(robust, filter, integral, times))


def _errors(name: str, words: str, flown: RunSignals, tuned: float) -> Iterator[Row]:
    digits = CHATTERS if name == "sign" else FLIGHT_DIGITS
    for signal, unit in (("h", "ft"), ("V", "ft/s")):
        got = float(flown.rms(f"law.{signal}_error")[0])
        note = TUNED.format(tuned) if signal == "h" else ""
        id, what = f"mismatch/{name}/{signal}", f"{words}: error of {signal}"
        yield reference(id, what, got, PLACE, relative=digits, unit=unit, note=note)
    what = f"{words}: an input reaches its limit"
    yield reference_flag(f"mismatch/{name}/saturated", what, flown.is_saturated[0], PLACE)


def _order() -> Iterator[Row]:
    """Yield the effect of the robust terms' sign on the error of h."""
    h = {name: float(_fly_variant(name).rms("law.h_error")[0]) for name in ROBUST}
    yield direction(
        "mismatch/published/claim",
        "u_h as published: error of h minus that of K only",
        "the robust terms reduce the error",
        h["published"] - h["off"],
        "[1] eq. 16, robust terms",
        below=0.0,
        unit="ft",
        must_hold=False,
        note="The published sign of u_h is wrong.",
    )
    for name in ("minus", "smooth", "sign"):
        words = ROBUST[name]
        yield direction(
            f"mismatch/{name}/claim",
            f"{words}: error of h minus that of K only",
            "the robust terms reduce the error",
            h[name] - h["off"],
            "[1] eqs. 16-18, robust terms",
            below=0.0,
            unit="ft",
        )


def _leak() -> Iterator[Row]:
    """Yield the error with leaking bounds, for the default width of the smoothing and for a wide one."""
    found = {}
    for width in (0.01, 1.0):
        leaking = change_robust(_build_scenario("smooth"), sigma=0.02, eps=width)
        found[width] = float(fly_seeds(leaking).rms("law.h_error")[0])
    what = "u_s smoothed, leak 0.02, eps = {:g}: error of h"
    for name, width in (("wide", 1.0), ("shipped", 0.01)):
        id = f"mismatch/leak/{name}/h"
        yield reference(id, what.format(width), found[width], PLACE, relative=FLIGHT_DIGITS, unit="ft")
    cost = found[0.01] - float(_fly_variant("smooth").rms("law.h_error")[0])
    about: Any = {"above": 0.0, "unit": "ft", "basis": "own"}
    yield direction(
        "mismatch/leak/cost", "error of h added by the leak, eps = 0.01", "the benefit", cost, PLACE, **about
    )


def _chatter() -> Iterator[Row]:
    """Yield sgn with a large q0 and no cap: slow divergence, as bounds do not adapt while an input is at its limit."""
    flown = fly_seeds(change_robust(_build_scenario("sign"), q0=100.0, cap=1e9))
    what = "u_s with sgn, q0 = 100, no cap: an input reaches its limit"
    yield reference_flag("mismatch/chatter/saturated", what, flown.is_saturated[0], PLACE)
    h = np.abs(flown["law.h_error"][0])
    early, late = (float(h[(flown.t > a) & (flown.t < b)].mean()) for a, b in ((50, 60), (190, np.inf)))
    note = "The growth depends on when sgn switches. The divergence itself does not."
    expected = oracle_number("mismatch/chatter/grows")
    about: Any = {"low": 5.0, "high": INFINITY, "basis": "reference", "note": note}
    what = "u_s with sgn, q0 = 100, no cap: error of h, mean of last 10 s divided by that of 50-60 s"
    yield band("mismatch/chatter/grows", what, expected, late / early, PLACE, **about)

"""Trim and model: where level flight is, the loop of pitch and modes, and gravity.

Trims are of the model as published; the trim that is usually quoted with it belongs to the vehicle to which its curves
were fitted.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3.
"""

import math
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from trimtab.core.record import replace
from trimtab.scenarios.hypersonic._internal import LevelTrim, level_trim
from trimtab.study import Row, at_most, same, within
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput
from trimtab.vehicles.hypersonic_aerodynamics import KMODES
from trimtab.vehicles.hypersonic_printed import (
    A_PRINTED,
    QUOTED_ALPHA,
    QUOTED_ELEVATOR,
    QUOTED_H,
    QUOTED_V,
    emulate_linearisation,
)

SECTION = "eqs. 1-3"
PLACE = "[1] eqs. 1-3"
LEVEL = f"{PLACE}, level at 85 000 ft, 7702.0808 ft/s"
QUOTED_PHI = 0.2514
GROUND = 32.174
REFERENCE: dict[str, Any] = {"basis": "reference"}
QUOTED = (
    "Trims the vehicle to which the curves of eqs. 1-3 were fitted; the curves themselves do not balance there, "
    "see the rows below."
)


def rows() -> Iterator[Row]:
    """Trims, what is left at the quoted one, forces, determinant and gravity."""
    craft = Hypersonic()
    at = level_trim(craft, QUOTED_H, QUOTED_V)
    yield from _trim(at)
    yield from _quoted_trim_rows(craft, at)
    yield from _forces(craft, at)
    yield from _loop(craft)
    yield from _gravity()


def _trim(at: LevelTrim) -> Iterator[Row]:
    wanted = {
        "alpha": ("angle of attack", 1.596784, math.degrees(at.zeta[0]), "deg"),
        "Phi": ("fuel ratio", 0.264449, at.u.Phi, "1"),
        "delta_e": ("elevator", 12.427146, math.degrees(at.u.delta_e), "deg"),
        "eta1": ("displacement of mode 1", 0.903851, at.zeta[2], "(slug ft)^1/2"),
        "eta2": ("displacement of mode 2", 0.755137, at.zeta[4], "(slug ft)^1/2"),
    }
    for name, (words, value, got, unit) in wanted.items():
        yield within(f"trim/{name}", f"trim, {words}", value, got, LEVEL, relative=1e-5, unit=unit, **REFERENCE)
    zetas = {k: _solve_trim(k) for k in KMODES}
    apart = max(float(np.abs(z - zetas["parker"]).max()) for z in zetas.values())
    yield at_most(
        "trim/readings", "trim, largest difference between readings of k_i", 0.0, apart, LEVEL, high=1e-9, **REFERENCE
    )


@cache
def _solve_trim(kmode: str) -> Any:
    craft = Hypersonic()
    at = level_trim(replace(craft, modes=replace(craft.modes, kmode=kmode)), QUOTED_H, QUOTED_V)
    return np.array([*at.zeta, at.u.Phi, at.u.delta_e])


def _quoted_trim_rows(craft: Hypersonic, at: LevelTrim) -> Iterator[Row]:
    pairs = {
        "alpha": ("angle of attack", 1.5153, math.degrees(at.zeta[0]), "deg"),
        "Phi": ("fuel ratio", QUOTED_PHI, at.u.Phi, "1"),
        "delta_e": ("elevator", 11.4635, math.degrees(at.u.delta_e), "deg"),
    }
    about: dict[str, Any] = {"relative": 0.01, "basis": "text", "must_hold": False, "note": QUOTED}
    place = f"{PLACE}, trim as usually quoted"
    for name, (words, value, got, unit) in pairs.items():
        yield within(f"quoted/{name}", f"trim as quoted, {words}", value, got, place, unit=unit, **about)
    x = craft.level_state(QUOTED_H, QUOTED_V, QUOTED_ALPHA, QUOTED_ELEVATOR)
    u = HypersonicInput(QUOTED_PHI, QUOTED_ELEVATOR)
    along, normal = craft.path_accelerations(0.0, x, u)
    turning = craft.forces_at(x, u).M / craft.Iyy
    left = {
        "V-rate": ("V'", 0.3484, along, 1e-4, "ft/s^2"),
        "normal": ("V γ'", -2.2244, normal, 1e-4, "ft/s^2"),
        "moment": ("M/Iyy", 0.01926, turning, 1e-5, "rad/s^2"),
        "eta1": ("N1/w1²", 0.8796, x.eta1, 1e-4, "(slug ft)^1/2"),
        "eta2": ("N2/w2²", 0.6935, x.eta2, 1e-4, "(slug ft)^1/2"),
    }
    for name, (words, value, got, digit, unit) in left.items():
        what = f"at the quoted trim, {words}"
        yield within(f"quoted/{name}-left", what, value, got, place, tolerance=digit, unit=unit, **REFERENCE)


def _forces(craft: Hypersonic, at: LevelTrim) -> Iterator[Row]:
    found = craft.forces_at(craft.level_state(at.h, at.V, at.zeta[0], at.u.delta_e), at.u)
    pressure = craft.forces.dynamic_pressure(at.h, at.V)
    pairs = {
        "qbar": ("dynamic pressure", 2000.0132, pressure, "lbf/ft^2"),
        "T": ("thrust", 1769.4663, found.T, "lbf/ft"),
        "L": ("lift", 9416.840, found.L, "lbf/ft"),
        "D": ("drag", 1768.779, found.D, "lbf/ft"),
        "weight": ("weight", 9466.147, craft.m * craft.g, "lbf/ft"),
    }
    for name, (words, value, got, unit) in pairs.items():
        yield within(f"forces/{name}", f"trim, {words}", value, got, LEVEL, relative=1e-6, unit=unit, **REFERENCE)


def _loop(craft: Hypersonic) -> Iterator[Row]:
    """Pitch and modes solved together, against the matrix of the three equations."""
    p1, p2, Iyy = craft.modes.psi1, craft.modes.psi2, craft.Iyy
    matrix = np.array([[Iyy, -p1, -p2], [p1, 1, 0], [p2, 0, 1]])
    determinant = float(np.linalg.det(matrix))
    yield within(
        "loop/determinant",
        "determinant of the loop of pitch and modes, k_i = 1 + ψi²/Iyy",
        627105.5208,
        determinant,
        PLACE,
        tolerance=0.01,
        unit="slug ft^2/ft",
        note="k_i is not printed; this reading is that of the model from which the equations come.",
        **REFERENCE,
    )
    worst = 0.0
    for M, r1, r2 in np.random.default_rng(0).normal(size=(20, 3)) * [1e4, 300.0, 300.0]:
        got = np.array([float(a) for a in craft.modes.solve_accelerations(Iyy, M, r1, r2)])
        want = np.linalg.solve(matrix, [M, r1, r2])
        worst = max(worst, float(np.abs((got - want) / np.abs(want).max()).max()))
    what = "Q', η1'', η2'' of the vehicle against the 3 x 3 system, largest relative difference"
    yield at_most("loop/solved", what, 0.0, worst, PLACE, high=1e-12, **REFERENCE)


def _gravity() -> Iterator[Row]:
    note = "Reconstructed: the attraction at 85 000 ft, by which the printed A is met."
    yield within(
        "gravity/value",
        "gravity",
        31.5538239,
        Hypersonic().g,
        PLACE,
        tolerance=1e-6,
        unit="ft/s^2",
        note=note,
        **REFERENCE,
    )
    heavy = replace(Hypersonic(), g=GROUND)
    rows_4_to_9 = (A_PRINTED != 0) & np.isin(np.arange(9), (3, 4, 6, 8))[:, None]
    off = np.abs(np.abs(emulate_linearisation(heavy).A[rows_4_to_9] / A_PRINTED[rows_4_to_9]) - 1)
    count = int(((off > 0.014) & (off < 0.0225)).sum())
    what = "entries of the printed A that 32.174 ft/s² would leave 1.4 to 2.25 % off"
    yield same("gravity/ground", what, 5, count, "[1] printed A", **REFERENCE)
    at = level_trim(heavy, QUOTED_H, QUOTED_V)
    pairs = {"alpha": (1.644566, math.degrees(at.zeta[0]), "deg"), "Phi": (0.268090, at.u.Phi, "1")}
    pairs["delta_e"] = (12.539973, math.degrees(at.u.delta_e), "deg")
    for name, (value, got, unit) in pairs.items():
        what = f"trim with 32.174 ft/s², {name}"
        yield within(f"gravity/{name}", what, value, got, LEVEL, relative=1e-5, unit=unit, **REFERENCE)

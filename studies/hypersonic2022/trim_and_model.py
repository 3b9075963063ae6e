"""Trim and model: level flight, the coupling of pitch and modes, and gravity.

Trims are those of the model as published. The trim usually quoted with the model belongs to the vehicle to which its
curves were fitted.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3.
"""

import math
from collections.abc import Iterator

import numpy as np

from studies.hypersonic2022._oracle import oracle_values, reference
from trimtab.core.record import replace
from trimtab.scenarios.hypersonic._internal import LevelTrim, level_trim
from trimtab.study import Row, at_most, same
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
QUOTED = "the trim usually quoted with this model, not in [1]"
"""Citation of the quoted trim: angle of attack 1.5153 deg, fuel ratio 0.2514, elevator 11.4635 deg."""


def rows() -> Iterator[Row]:
    """Yield trims, the residuals at the quoted trim, forces, the coupling of pitch and modes, and gravity."""
    craft = Hypersonic()
    at = level_trim(craft, QUOTED_H, QUOTED_V)
    yield from _trim(at)
    yield from _quoted_trim_rows(craft)
    yield from _forces(craft, at)
    yield from _loop(craft)
    yield from _gravity()


def _trim(at: LevelTrim) -> Iterator[Row]:
    values = {
        "alpha": ("angle of attack", math.degrees(at.zeta[0]), "deg"),
        "Phi": ("fuel ratio", at.u.Phi, "1"),
        "delta_e": ("elevator", math.degrees(at.u.delta_e), "deg"),
        "eta1": ("displacement of mode 1", at.zeta[2], "(slug ft)^1/2"),
        "eta2": ("displacement of mode 2", at.zeta[4], "(slug ft)^1/2"),
    }
    for name, (words, got, unit) in values.items():
        yield reference(f"trim/{name}", f"trim, {words}", got, LEVEL, unit=unit)


def _quoted_trim_rows(craft: Hypersonic) -> Iterator[Row]:
    """Yield the residuals of the trim equations at the quoted trim."""
    x = craft.level_state(QUOTED_H, QUOTED_V, QUOTED_ALPHA, QUOTED_ELEVATOR)
    u = HypersonicInput(QUOTED_PHI, QUOTED_ELEVATOR)
    along, normal = craft.path_accelerations(0.0, x, u)
    left = {
        "V-rate": ("V'", along, "ft/s^2"),
        "normal": ("V γ'", normal, "ft/s^2"),
        "moment": ("M/Iyy", craft.forces_at(x, u).M / craft.Iyy, "rad/s^2"),
        "eta1": ("N1/w1²", x.eta1, "(slug ft)^1/2"),
        "eta2": ("N2/w2²", x.eta2, "(slug ft)^1/2"),
    }
    note = (
        "The quoted trim belongs to the vehicle that eqs. 1-3 were fitted to. The fitted curves do not balance there."
    )
    for name, (words, got, unit) in left.items():
        yield reference(f"quoted/{name}", f"at the quoted trim, {words}", got, QUOTED, unit=unit, note=note)


def _forces(craft: Hypersonic, at: LevelTrim) -> Iterator[Row]:
    found = craft.forces_at(craft.level_state(at.h, at.V, at.zeta[0], at.u.delta_e), at.u)
    pairs = {
        "qbar": ("dynamic pressure", craft.forces.dynamic_pressure(at.h, at.V), "lbf/ft^2"),
        "T": ("thrust", found.T, "lbf/ft"),
        "L": ("lift", found.L, "lbf/ft"),
        "D": ("drag", found.D, "lbf/ft"),
        "weight": ("weight", craft.m * craft.g, "lbf/ft"),
    }
    for name, (words, got, unit) in pairs.items():
        yield reference(f"forces/{name}", f"trim, {words}", got, LEVEL, unit=unit)


def _loop(craft: Hypersonic) -> Iterator[Row]:
    """Yield the coupled pitch and modal accelerations for each load alone, compared with the oracle's matrix."""
    for kmode in KMODES:
        modes = replace(craft.modes, kmode=kmode)
        loads = [modes.solve_accelerations(craft.Iyy, *unit) for unit in np.eye(3)]
        got = np.array([[float(a) for a in column] for column in loads]).T
        want = oracle_values()[f"loop/{kmode}"].reshape(3, 3)
        off = float((np.abs(got - want) / np.abs(want).max(axis=1, keepdims=True)).max())
        what = f"Q', η1'', η2'' by M, r1, r2, reading {kmode!r} of k_i: largest error, relative to each row's largest"
        yield at_most(f"loop/{kmode}", what, 0.0, off, PLACE, high=1e-11, basis="reference")


def _gravity() -> Iterator[Row]:
    note = "Reconstructed: gravity at 85 000 ft, which reproduces the printed A."
    yield reference("gravity/value", "gravity", Hypersonic().g, PLACE, unit="ft/s^2", note=note)
    heavy = replace(Hypersonic(), g=GROUND)
    rows_4_to_9 = (A_PRINTED != 0) & np.isin(np.arange(9), (3, 4, 6, 8))[:, None]
    off = np.abs(np.abs(emulate_linearisation(heavy).A[rows_4_to_9] / A_PRINTED[rows_4_to_9]) - 1)
    count = int(((off > 0.014) & (off < 0.0225)).sum())
    what = "entries of the printed A that are 1.4 to 2.25 % off with 32.174 ft/s²"
    yield same("gravity/ground", what, 5, count, "[1] printed A", basis="own")
    at = level_trim(heavy, QUOTED_H, QUOTED_V)
    pairs = {"alpha": (math.degrees(at.zeta[0]), "deg"), "Phi": (at.u.Phi, "1")}
    pairs["delta_e"] = (math.degrees(at.u.delta_e), "deg")
    for name, (got, unit) in pairs.items():
        yield reference(f"gravity/{name}", f"trim with 32.174 ft/s², {name}", got, LEVEL, unit=unit)

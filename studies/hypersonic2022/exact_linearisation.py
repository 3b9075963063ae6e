"""Exact linearisation: the error model about the own trim, its identities and poles.

[1] prints an error model that no linearisation of its equations gives; that of the corrected equations is held here
against an independent program by finite differences.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 4-8, 10.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import jax
import numpy as np

from studies.hypersonic2022.printed_matrices import COLUMNS, INPUTS
from trimtab.core.record import replace
from trimtab.design.linearise import linearise
from trimtab.scenarios.hypersonic._design import H, V, accelerations, error_model
from trimtab.scenarios.hypersonic._internal import design_model
from trimtab.study import Row, at_most, same, within
from trimtab.vehicles.hypersonic import Hypersonic
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED

SECTION = "eqs. 4-8"
PLACE = "[1] eqs. 4-8"
REFERENCE: dict[str, Any] = {"basis": "reference"}
A_EXACT = {
    5: (-6.295672e-6, 1.687744e-5, 3.491600e-5, 7.075971, 0.0, -0.05939869, -1.439968e-4, -0.2099934, -4.199867e-4),
    7: (8.613738e-4, -2.309172e-3, -4.777208e-3, 3683.672, 0.0, -264.1231, -0.6402984, 28.73129, 0.05746259),
    9: (0.02311599, -7.183074e-3, -0.1282020, -7393.370, 0.0, 19.55524, 0.04740663, -330.8660, -0.6617320),
}
B_EXACT = {5: (-4.261384e-3, 4.119672e-3), 7: (0.5830425, -0.5636536), 9: (15.64664, -1.753341)}
"""Rows, from 1, by the independent program."""
SLOPE = ((0.685649, 86.387771), (24.596085, -40.341697))
INTERNAL = {
    "parker": (3.28943, (-3.28922, -0.34454 + 18.5028j, -0.30658 + 16.0052j), 1e-4),
    "paper": (3.2893, (-3.2893, -0.414 + 20.372j, -0.322 + 16.346j), 1e-3),
    "author": (3.301, (-3.301, -0.400 + 20.076j, -0.330 + 16.461j), 1e-3),
}
"""Reading of k_i -> unstable pole, the others, digits."""
OPEN = (1.6957, -1.7658, -8.0e-4 + 0.0419j, 0.0, -0.3053 + 15.960j, -0.3455 + 18.393j)
FOURTH = "alpha' is Q less the turn of the path, which v fixes: no force is in it. The print took b31 for b32."


def rows() -> Iterator[Row]:
    """Identities, rows of A and B, dv/du, and poles."""
    yield from _identities()
    yield from _entries()
    yield from _slope()
    yield from _poles()


def _identities() -> Iterator[Row]:
    exact = error_model()[0]
    off = float(max(np.abs(exact.A[3] - np.eye(9)[4]).max(), np.abs(exact.B[3] - [-1 / V, 0]).max()))
    what = "row 4 of A and B against e_Q and [-1/V, 0], largest difference"
    yield at_most("identities/exact", what, 0.0, off, PLACE, high=1e-9, **REFERENCE)
    printed = float(max(np.abs(A_PRINTED[3] - np.eye(9)[4]).max(), np.abs(B_PRINTED[3] - [-1 / V, 0]).max()))
    yield at_most(
        "identities/printed",
        "the same of the printed A and B",
        0.0,
        printed,
        "[1] printed A, B",
        high=1e-9,
        must_hold=False,
        note=FOURTH,
    )


def _entries() -> Iterator[Row]:
    exact = error_model()[0]
    for letter, wanted, got, names in (("A", A_EXACT, exact.A, COLUMNS), ("B", B_EXACT, exact.B, INPUTS)):
        for i, values in wanted.items():
            for j, value in enumerate(values):
                what = f"exact {letter}[{i}, {names[j]}]"
                about: dict[str, Any] = {"relative": 1e-6} if value else {"tolerance": 1e-12}
                yield within(f"{letter}/{i},{j + 1}", what, value, got[i - 1, j], PLACE, **about, **REFERENCE)


def _slope() -> Iterator[Row]:
    """dv/du at the trim."""
    craft, (_, at) = Hypersonic(), error_model()
    plant = design_model(craft, H, V)
    x = plant.state(at.x)
    found = np.asarray(jax.jacfwd(lambda u: accelerations(craft, x, u))(np.asarray(at.u)))
    names = ("h''", "V'"), ("Φ", "δe")
    for i, j in np.ndindex(2, 2):
        what = f"d{names[0][i]}/d{names[1][j]} at the trim"
        yield within(f"slope/{i + 1},{j + 1}", what, SLOPE[i][j], found[i, j], PLACE, relative=2e-6, **REFERENCE)
    determinant = float(np.linalg.det(found))
    yield within("slope/determinant", "its determinant", -2152.4612, determinant, PLACE, relative=1e-6, **REFERENCE)
    air = craft.forces.aerodynamics
    pressed = craft.forces.dynamic_pressure(x.h, x.V) * air.S / craft.m
    yield within(
        "slope/secant",
        "slope of drag over mass that the printed g(x) has there, its elevator frozen",
        20.19,
        pressed * (air.CD_d2 * at.u[1] + air.CD_d),
        f"{PLACE}, g(x)",
        relative=1e-3,
        unit="ft/s^2/rad",
        note="Half of what it is: drag is quadratic in the elevator.",
        **REFERENCE,
    )


def _poles() -> Iterator[Row]:
    for kmode, (unstable, others, digits) in INTERNAL.items():
        poles = np.linalg.eigvals(_linearise_error_model(kmode).A[3:, 3:])
        right = poles[poles.real > 0]
        reading = f"internal dynamics, reading {kmode!r} of k_i"
        yield same(f"internal/{kmode}/count", f"{reading}, poles on the right", 1, len(right), PLACE, **REFERENCE)
        tolerance = 1e-3
        got = float(right.real.max())
        yield within(
            f"internal/{kmode}/unstable",
            f"{reading}, the one",
            unstable,
            got,
            PLACE,
            tolerance=tolerance,
            unit="1/s",
            **REFERENCE,
        )
        yield at_most(
            f"internal/{kmode}/others",
            f"{reading}, the others off by",
            0.0,
            _pole_error(poles, others),
            PLACE,
            high=digits,
            unit="1/s",
            **REFERENCE,
        )
    plant = design_model(Hypersonic(), H, V)
    _, at = error_model()
    poles = linearise(plant, at.x, at.u).poles()
    yield at_most(
        "open-loop",
        "poles with the input held, off by",
        0.0,
        _pole_error(poles, OPEN),
        PLACE,
        high=1e-3,
        unit="1/s",
        **REFERENCE,
    )
    rightmost = float(poles.real.max())
    yield within(
        "open-loop/unstable", "the rightmost", 1.6957, rightmost, PLACE, tolerance=1e-4, unit="1/s", **REFERENCE
    )


@cache
def _linearise_error_model(kmode: str) -> Any:
    craft = Hypersonic()
    return error_model(replace(craft, modes=replace(craft.modes, kmode=kmode)))[0]


def _pole_error(poles: Any, wanted: Any) -> float:
    return max(float(np.abs(poles - p).min()) for p in wanted)

"""Exact linearisation: error model about the model's own trim, its identities and poles.

[1] prints an error model that no linearisation of its equations gives. The error model of the corrected equations is
compared here with the oracle's, which uses complex steps.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 4-8, 10.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import jax
import numpy as np

from studies.hypersonic2022._oracle import oracle_poles, oracle_values, pole_error, reference
from studies.hypersonic2022.printed_matrices import COLUMNS, INPUTS
from trimtab.core.record import replace
from trimtab.design.linearise import linearise
from trimtab.scenarios.hypersonic._design import H, V, accelerations, error_model
from trimtab.scenarios.hypersonic._internal import design_model
from trimtab.study import Row, at_most, same
from trimtab.vehicles.hypersonic import Hypersonic
from trimtab.vehicles.hypersonic_aerodynamics import KMODES
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED

SECTION = "eqs. 4-8"
PLACE = "[1] eqs. 4-8"
FOURTH = "alpha' is Q minus the path's turn rate, which v sets, so no force enters it. [1] prints b31 in place of b32."


def rows() -> Iterator[Row]:
    """Yield the printed row 4, which is an identity of any model, then rows of A and B, dv/du, and poles."""
    yield from _identities()
    yield from _entries()
    yield from _slope()
    yield from _poles()


def _identities() -> Iterator[Row]:
    printed = float(max(np.abs(A_PRINTED[3] - np.eye(9)[4]).max(), np.abs(B_PRINTED[3] - [-1 / V, 0]).max()))
    what, place = "printed row 4 of A and B against e_Q and [-1/V, 0], largest difference", "[1] eq. 12, printed A, B"
    note = {"must_hold": False, "note": FOURTH}
    yield at_most("identities/printed", what, 0.0, printed, place, high=1e-9, basis="reference", **note)


def _entries() -> Iterator[Row]:
    exact = error_model()[0]
    for i in (5, 7, 9):
        got, want = np.concatenate([exact.A[i - 1], exact.B[i - 1]]), oracle_values()[f"exact/{i}"]
        for j in np.flatnonzero(want):
            letter, name = ("A", COLUMNS[j]) if j < 9 else ("B", INPUTS[j - 9])
            id, what = f"{letter}/{i},{j % 9 + 1}", f"exact {letter}[{i}, {name}]"
            yield reference(id, what, got[j], PLACE, name=f"exact/{i}", part=int(j))
        empty = float(np.abs(got[want == 0]).max(initial=0.0))
        what = f"exact row {i}: largest of the entries that are zero by eqs. 4-8"
        yield at_most(f"zeros/{i}", what, 0.0, empty, PLACE, high=1e-12, basis="reference")


def _slope() -> Iterator[Row]:
    """Yield dv/du at the trim."""
    craft, (_, at) = Hypersonic(), error_model()
    plant = design_model(craft, H, V)
    x = plant.state(at.x)
    found = np.asarray(jax.jacfwd(lambda u: accelerations(craft, x, u))(np.asarray(at.u)))
    names = ("h''", "V'"), ("Φ", "δe")
    for i, j in np.ndindex(2, 2):
        yield reference(f"slope/{i + 1},{j + 1}", f"d{names[0][i]}/d{names[1][j]} at the trim", found[i, j], PLACE)
    yield reference("slope/determinant", "determinant of the slopes", np.linalg.det(found), PLACE)
    air = craft.forces.aerodynamics
    secant = craft.forces.dynamic_pressure(x.h, x.V) * air.S / craft.m * (air.CD_d2 * at.u[1] + air.CD_d)
    what = "slope of drag per mass at the trim in the printed g(x), with its frozen elevator"
    about: Any = {"unit": "ft/s^2/rad", "note": "Half of the true slope, as drag is quadratic in the elevator."}
    yield reference("slope/secant", what, secant, "[1] eq. 4, g(x)", **about)


def _poles() -> Iterator[Row]:
    about: Any = {"unit": "1/s", "basis": "reference"}
    for kmode in KMODES:
        poles, name = np.linalg.eigvals(_linearise_error_model(kmode).A[3:, 3:]), f"internal/{kmode}"
        right = poles[poles.real > 0]
        count = int((oracle_poles(name).real > 0).sum())
        reading = f"internal dynamics, reading {kmode!r} of k_i"
        yield same(
            f"{name}/count", f"{reading}, poles in the right half-plane", count, len(right), PLACE, basis="reference"
        )
        unstable = right.real.max(initial=-np.inf)
        yield reference(f"{name}/unstable", f"{reading}, unstable pole", unstable, PLACE, name=name, unit="1/s")
        off = pole_error(poles, name)
        yield at_most(f"{name}/all", f"{reading}, largest error of all poles", 0.0, off, PLACE, high=1e-5, **about)
    _, at = error_model()
    poles = linearise(design_model(Hypersonic(), H, V), at.x, at.u).poles()
    off = pole_error(poles, "open-loop")
    yield at_most("open-loop", "largest error of the poles with the input held", 0.0, off, PLACE, high=1e-5, **about)
    rightmost = float(poles.real.max())
    yield reference(
        "open-loop/unstable", "rightmost pole with the input held", rightmost, PLACE, name="open-loop", unit="1/s"
    )


@cache
def _linearise_error_model(kmode: str) -> Any:
    craft = Hypersonic()
    return error_model(replace(craft, modes=replace(craft.modes, kmode=kmode)))[0]

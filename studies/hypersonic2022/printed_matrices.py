"""Printed matrices: each number of A and B compared with an emulation of the program that probably made it.

The emulation repeats that program's errors and is not a model of the vehicle. The note of each row has the corrected
model's value. Several printed numbers are truncated, not rounded, so magnitudes are compared within 1.1 %.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, numbers of its simulation.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.hypersonic2022._oracle import reference
from trimtab.scenarios.hypersonic._design import error_model
from trimtab.study import Row, direction, same, within
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, emulate_linearisation

SECTION = "eq. 12, printed A and B"
COLUMNS = ("h", "h'", "V", "α", "Q", "η1", "η1'", "η2", "η2'")
INPUTS = ("h''", "V'")
PRINTED_ROWS = (3, 4, 6, 8)
FITTED = {
    (3, 2): "g",
    (4, 5): "ψ1",
    (6, 5): "w1",
    (6, 6): "ζ1",
    (6, 7): "ψ2",
    (8, 3): "N2_d",
    (8, 7): "w2",
    (8, 8): "ζ2",
}
"""Indices in A, from 0 -> constant of the model that [1] does not print and that is fitted to this entry."""
TRIVIAL = "A", 3, 4
"""Matrix and indices, from 0, of the entry that is 1 in any model."""
CLOSE_ENTRIES = {(6, 3), (8, 3)}
"""Indices of the entries of A that agree within 1e-5."""
MAGNITUDE, CLOSELY = 0.011, 1e-5
SIGN = "The model has the opposite sign. The printed sign contradicts eqs. 1-3."
DAMPING = "The printed sign makes the modes grow. This contradicts eq. 1 and an observer whose errors converge."
UNEXPLAINED = "No variant that was tried gives this value: raw or transposed G, a factor of 2, ψ in place of ψ/Iyy."


def rows() -> Iterator[Row]:
    """Yield rows on 33 magnitudes, the signs that differ, and the consequences of these signs."""
    made, exact = emulate_linearisation(), error_model()[0]
    for letter, printed, got, right, names in (
        ("A", A_PRINTED, made.A, exact.A, COLUMNS),
        ("B", B_PRINTED, made.B, exact.B, INPUTS),
    ):
        for i, j in np.argwhere(printed):
            if i in PRINTED_ROWS and (letter, int(i), int(j)) != TRIVIAL:
                numbers = float(printed[i, j]), float(got[i, j]), float(right[i, j])
                yield from _entry(letter, (int(i), int(j)), names[j], *numbers)
    yield from _damping()


def _entry(letter: str, at: tuple[int, int], name: str, printed: float, got: float, right: float) -> Iterator[Row]:
    """Yield the magnitude, and the sign if it differs from the printed one."""
    i, j = at
    id, citation = f"{letter}/{i + 1},{j + 1}", _matrix_citation(letter)
    what = f"{letter}[{i + 1}, {name}], magnitude"
    fitted = letter == "A" and at in FITTED
    basis = f" [basis] {FITTED[at]} was fitted to this entry." if fitted else ""
    note = f"Exact model: {right:.4g}.{basis}"
    relative = CLOSELY if letter == "A" and at in CLOSE_ENTRIES else MAGNITUDE
    about: dict[str, Any] = {"relative": relative, "note": note, "basis": "input" if fitted else "printed"}
    if letter == "B" and i == 8:
        about |= {"must_hold": False, "note": f"{UNEXPLAINED} {note}"}
    yield within(id, what, abs(printed), abs(got), citation, **about)
    if printed * got < 0:
        why = DAMPING if at in ((6, 6), (8, 8)) else SIGN
        signs = tuple("+" if value > 0 else "-" for value in (printed, got))
        yield same(
            f"{id}/sign", f"{letter}[{i + 1}, {name}], sign", signs[0], signs[1], citation, must_hold=False, note=why
        )


def _damping() -> Iterator[Row]:
    """Yield the consequences of the printed signs."""
    poles = np.linalg.eigvals(A_PRINTED)
    for k, w in ((1, 16.5), (2, 19.9)):
        near = poles[np.abs(poles - 1j * w).argmin()]
        what = f"printed A alone, growth rate of the oscillation near {w} rad/s"
        yield reference(f"damping/{k}", what, near.real, _matrix_citation("A"), unit="1/s")
    rightmost = float(np.linalg.eigvals(error_model()[0].A[5:, 5:]).real.max())
    yield direction(
        "damping/model",
        "modes of the exact model, largest growth",
        "errors of the observer converge",
        rightmost,
        "[1] simulation, errors of the estimate",
        below=0.0,
        unit="1/s",
    )


def _matrix_citation(letter: str = "A, B") -> str:
    return f"[1] eq. 12, printed {letter}"

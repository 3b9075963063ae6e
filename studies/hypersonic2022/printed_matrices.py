"""Printed matrices: each number of A and B beside the emulation of the program that seems to have made it.

The emulation repeats that program's errors and is no model; what the corrected model has in the same place stands in
the last column. Several printed numbers are cut off, not rounded, so magnitudes are held to 1.1 %.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, numbers of its simulation.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from trimtab.scenarios.hypersonic._design import error_model
from trimtab.study import Row, direction, same, within
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, emulate_linearisation

SECTION = "eq. 10, printed A and B"
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
"""Places of A, from 0, that fixed a constant of the model which [1] does not print."""
CLOSE = {(6, 3), (8, 3)}
"""Met to 1e-5."""
MAGNITUDE, CLOSELY = 0.011, 1e-5
SIGN = "The model's sign is the other one: the printed one contradicts eqs. 1-3."
DAMPING = "The printed sign makes the modes grow, against eq. 1 and against an observer whose errors converge."
UNEXPLAINED = "No variant that was tried gives it: raw or transposed G, a factor of 2, ψ in place of ψ/Iyy."


def rows() -> Iterator[Row]:
    """34 magnitudes, the signs that are lost, and the count."""
    made, exact = emulate_linearisation(), error_model()[0]
    found: list[Row] = []
    for letter, printed, got, right, names in (
        ("A", A_PRINTED, made.A, exact.A, COLUMNS),
        ("B", B_PRINTED, made.B, exact.B, INPUTS),
    ):
        for i, j in np.argwhere(printed):
            if i in PRINTED_ROWS:
                numbers = float(printed[i, j]), float(got[i, j]), float(right[i, j])
                for row in _entry(letter, (int(i), int(j)), names[j], *numbers):
                    found.append(row)
                    yield row
    yield from _damping()
    magnitudes = [r for r in found if not r.id.endswith("/sign")]
    yield same(
        "count/printed",
        "numbers printed in rows 4, 5, 7 and 9",
        34,
        len(magnitudes),
        _matrix_citation(),
        basis="reference",
    )
    met = sum(r.holds for r in magnitudes)
    yield same("count/met", "of these met in magnitude", 32, met, _matrix_citation(), basis="reference")
    used = len(FITTED) + 1
    note = "Without the eight that fixed constants and the one that is 1 in any model."
    yield same(
        "count/confirmed",
        "of these met with nothing left to tune",
        23,
        met - used,
        _matrix_citation(),
        basis="reference",
        note=note,
    )


def _entry(letter: str, at: tuple[int, int], name: str, printed: float, got: float, right: float) -> Iterator[Row]:
    """Magnitude, and sign where that is not the printed one."""
    i, j = at
    id, citation = f"{letter}/{i + 1},{j + 1}", _matrix_citation(letter)
    what = f"{letter}[{i + 1}, {name}], magnitude"
    basis = f" [basis] It fixed {FITTED[at]}." if letter == "A" and at in FITTED else ""
    trivial = " 1 in any model." if letter == "A" and at == (3, 4) else ""
    note = f"Exact model: {right:.4g}.{basis}{trivial}"
    relative = CLOSELY if letter == "A" and at in CLOSE else MAGNITUDE
    about: dict[str, Any] = {"relative": relative, "note": note}
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
    """What the printed signs would mean."""
    poles = np.linalg.eigvals(A_PRINTED)
    for k, want in enumerate((0.330 + 16.535j, 0.400 + 19.913j), 1):
        near = poles[np.abs(poles - want).argmin()]
        what = f"printed A alone, growth of its oscillation near {want.imag:.1f} rad/s"
        yield within(
            f"damping/{k}",
            what,
            want.real,
            near.real,
            _matrix_citation("A"),
            tolerance=2e-3,
            unit="1/s",
            basis="reference",
        )
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
    return f"[1] printed {letter}"

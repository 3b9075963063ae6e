"""Gains and certificates: the reference gain, inequalities (14) and (15), and the sign of the robust term.

The weights are not printed. Those used here are chosen, and the gain with them is compared with the oracle's.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 13-18.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from studies.hypersonic2022._oracle import oracle_poles, oracle_values, reference
from trimtab.design import composite
from trimtab.design.lqr import kalman_bucy
from trimtab.scenarios.hypersonic._design import SCALE, error_model, feedback_gain, weights
from trimtab.study import Row, at_most, direction, same, within

SECTION = "eqs. 13-18"
PLACE = "[1] eq. 13"
WEIGHTS = tuple((strict, density) for strict in (1.0, 1.01) for density in (10.0, 5e-7))
"""Pairs of the regulator's Q as a multiple of Q_e, and the noise density (rad²/s³)."""
SMALL = 1e-5
"""Q_eta as printed, diagonal."""


def rows() -> Iterator[Row]:
    """Yield rows on the gain and poles, inequalities (14) and (15), and u_h with its weights."""
    yield from _gain()
    yield from _inequality()
    yield from _weight()
    yield from _printed_inequality_rows()
    yield from _robust()


@cache
def _feedback(strict: float = 1.0) -> composite.Feedback:
    exact = error_model()[0]
    found = feedback_gain(exact, strict=strict)
    Qe, Re, _ = weights()
    return composite.Feedback(exact.A, exact.B, found.K, found.P, Qe, np.linalg.inv(Re))


@cache
def _observer(density: float) -> composite.Observer:
    exact = error_model()[0]
    A, C, Q = exact.A[5:, 5:], exact.A[4:5, 5:], SMALL * np.eye(4)
    found = kalman_bucy(A, C, Q, density)
    return composite.Observer(A, C, Q, found.P, found.L, np.array([[1 / density]]), np.arange(5, 9))


def _gain() -> Iterator[Row]:
    f = _feedback()
    off = float(np.abs(f.K / oracle_values()["gain/K"].reshape(2, 9) - 1).max())
    what = "regulator's gain, 18 entries, largest relative difference"
    yield at_most("gain/entries", what, 0.0, off, PLACE, high=1e-6, basis="reference")
    poles = np.linalg.eigvals(f.A + f.B @ f.K)
    for k, want in enumerate(oracle_poles("gain/poles")):
        near = poles[np.abs(poles - want).argmin()]
        for part, words in enumerate(("real part", "imaginary part")[: 1 + (want.imag != 0)]):
            got, id = (near.real, abs(near.imag))[part], f"gain/pole-{k + 1}-{('real', 'imag')[part]}"
            about: Any = {"name": "gain/poles", "part": 2 * k + part, "unit": "1/s", "relative": 1e-6}
            yield reference(id, f"A + B K, pole {k + 1}, {words}", got, PLACE, **about)
    blind = f.K.copy()
    blind[:, 5:] = 0
    rightmost = float(np.linalg.eigvals(f.A + f.B @ blind).real.max())
    what, note = (
        "A + B K without feedback of the modes, rightmost real part",
        "So the modes' estimate has to be fed back.",
    )
    yield reference("gain/blind", what, rightmost, PLACE, unit="1/s", note=note, relative=1e-6)


def _inequality() -> Iterator[Row]:
    """Yield the identity by which the regulator's Riccati equation makes the left side of (14) equal Q_e - Q."""
    place, scale = "[1] eq. 14", np.outer(SCALE, SCALE)
    for strict in (1.0, 1.01):
        f = _feedback(strict)
        left = -composite.inequality_matrix(f)
        off = float(np.abs((left - (1 - strict) * f.Qe) * scale).max())
        what = f"left side of (14) minus (Q_e - Q) for Q = {strict:g} Q_e, scaled, largest"
        yield at_most(f"inequality/residual-{strict:g}", what, 0.0, off, place, high=1e-9, basis="own")
    f = _feedback(1.01)
    allowed = np.sqrt(np.diag(f.Qe))
    margin = float(np.linalg.eigvalsh(composite.inequality_matrix(f) / np.outer(allowed, allowed))[0])
    what = "margin of (14) with Q = 1.01 Q_e, relative to Q_e"
    yield within("inequality/margin", what, 0.01, margin, place, relative=1e-5, basis="own")


def _weight() -> Iterator[Row]:
    """Yield the least weight of the observer's part in the corrected (15), and its failure with weight 1."""
    place = "[1] eq. 15"
    for strict, density in WEIGHTS:
        f, o = _feedback(strict), _observer(density)
        id, about = f"weight/{strict:g}-{density:g}", f"Q = {strict:g} Q_e, R = {density:g} rad²/s³"
        least = composite.least_weight(f, o)
        yield reference(id, f"least weight of the observer in (15), {about}", least, place, relative=1e-6)
        yield same(
            f"{id}/one",
            f"corrected (15) holds with weight 1, as in [1]'s Lyapunov function, {about}",
            True,
            _is_positive(f, o, 1.0),
            place,
            basis="text",
            must_hold=False,
            note="Weight 1 is too small. A sufficient weight always exists for Pi > 0.",
        )


def _is_positive(f: composite.Feedback, o: composite.Observer, weight: float) -> bool:
    z = composite.weighted_matrix(f, o, weight)
    size = np.sqrt(np.diag(z))
    return bool(np.linalg.eigvalsh(z / np.outer(size, size))[0] > 0)


def _printed_inequality_rows() -> Iterator[Row]:
    """Yield (15) as printed, for the modes. It accepts cases that the corrected inequality rejects."""
    f = _feedback()
    for density in (10.0, 5e-7):
        got = float(np.linalg.eigvalsh(composite.printed_inequality(f, _observer(density)))[-1])
        what = f"(15) as printed, on the modes and with -R_e, R = {density:g} rad²/s³, largest eigenvalue"
        note = "Below zero, so it holds where the corrected (15) with weight 1 does not. It proves nothing."
        yield reference(f"printed-15/{density:g}", what, got, "[1] eq. 15", note=note, relative=1e-6)


def _robust() -> Iterator[Row]:
    """Yield u_h with either sign, as a change of the gain, and the least weight with which V decreases."""
    f, o = _feedback(), _observer(10.0)
    for name, factor in (("published", 0.5), ("minus", 1.5)):
        rightmost = float(np.linalg.eigvals(f.A + factor * f.B @ f.K).real.max())
        what = f"u_h with the {name} sign, a gain of {factor:g} K: rightmost real part"
        yield reference(f"u_h/{name}", what, rightmost, "[1] eq. 16", unit="1/s", relative=1e-6)
    alone = float(np.linalg.eigvals(f.A + f.B @ f.K).real.max())
    half = float(np.linalg.eigvals(f.A + 0.5 * f.B @ f.K).real.max())
    yield direction(
        "u_h/claim",
        "u_h as published, change of the rightmost real part",
        "robust term adds stability",
        half - alone,
        "[1] eq. 16",
        below=0.0,
        unit="1/s",
        must_hold=False,
        note="The published sign is wrong: u_h halves the gain.",
    )
    for name, robust in (("published", 0.5), ("off", 0.0), ("minus", -0.5)):
        got = composite.least_decrease_weight(f, o, robust)
        what = f"weight above which V falls, u_h {name}"
        yield reference(f"decrease/{name}", what, got, "[1] eqs. 14-16", relative=1e-5)

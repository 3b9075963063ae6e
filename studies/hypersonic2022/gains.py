"""Gains and certificates: the reference gain, inequalities (14) and (15), and the sign of the robust term.

Weights are not printed; those here are chosen, and the gain with them is held against an independent program.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 13-18.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from trimtab.design import composite
from trimtab.design.lqr import kalman_bucy
from trimtab.scenarios.hypersonic._design import SCALE, error_model, feedback_gain, weights
from trimtab.study import Row, at_most, direction, same, within

SECTION = "eqs. 13-18"
PLACE = "[1] eq. 13"
REFERENCE: dict[str, Any] = {"basis": "reference"}
K_REFERENCE = np.array(
    [
        [0.0893010, 0.688045, -0.355907, 1742.964, 536.101, -0.581358, -0.140480, -1.351494, -0.363934],
        [-0.0184104, -0.132192, -0.465382, -168.6866, -51.9745, 0.0504659, 0.0135084, 0.129350, 0.0334523],
    ]
)
"""By the independent program, v = +K e."""
POLES = {-3.9716: 8e-5, -2.8106: 8e-5, -0.4996: 8e-5, -0.4262: 8e-5, -0.2266: 8e-5}
POLES |= {-0.5200 + 18.509j: 6e-4, -0.3361 + 16.031j: 6e-4}
"""Its poles, each with half of its last digit and a little."""
LEAST = {(1.0, 10.0): 4.22, (1.0, 5e-7): 2.78, (1.01, 10.0): 4.25, (1.01, 5e-7): 2.80}
"""Q of the regulator in parts of Q_e, density of the noise -> lambda*."""
SMALL = 1e-5
"""Q_eta as printed, diagonal."""


def rows() -> Iterator[Row]:
    """Gain and poles, (14), (15), u_h and its weights."""
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
    note = "Half a unit of its shortest entry."
    off = float(np.abs(f.K / K_REFERENCE - 1).max())
    what = "reference gain, 18 entries, largest relative difference"
    yield at_most("gain/entries", what, 0.0, off, PLACE, high=4e-6, note=note, **REFERENCE)
    poles = np.linalg.eigvals(f.A + f.B @ f.K)
    for k, (want, digit) in enumerate(POLES.items(), 1):
        near = poles[np.abs(poles - want).argmin()]
        for part, words in (("real", "real part"), ("imag", "imaginary part"))[: 1 + (np.imag(want) != 0)]:
            value, got = float(getattr(want, part)), float(getattr(near, part))
            what = f"A + B K, pole {k}, {words}"
            yield within(f"gain/pole-{k}-{part}", what, value, got, PLACE, tolerance=digit, unit="1/s", **REFERENCE)
    blind = f.K.copy()
    blind[:, 5:] = 0
    rightmost = float(np.linalg.eigvals(f.A + f.B @ blind).real.max())
    what = "the same without feedback of the modes, rightmost real part"
    note = "So their estimate has to be fed back."
    yield within("gain/blind", what, 2.05, rightmost, PLACE, tolerance=5e-3, unit="1/s", note=note, **REFERENCE)


def _inequality() -> Iterator[Row]:
    place, scale = "[1] eq. 14", np.outer(SCALE, SCALE)
    for strict in (1.0, 1.01):
        f = _feedback(strict)
        left = -composite.inequality_matrix(f)
        off = float(np.abs((left - (1 - strict) * f.Qe) * scale).max())
        what = f"left side of (14) of the regulator with Q = {strict:g} Q_e, less Q_e - Q, scaled, largest"
        yield at_most(f"inequality/residual-{strict:g}", what, 0.0, off, place, high=1e-9, **REFERENCE)
    f = _feedback(1.01)
    allowed = np.sqrt(np.diag(f.Qe))
    margin = float(np.linalg.eigvalsh(composite.inequality_matrix(f) / np.outer(allowed, allowed))[0])
    what = "margin of (14) with Q = 1.01 Q_e, in parts of Q_e"
    yield within("inequality/margin", what, 0.01, margin, place, relative=1e-5, **REFERENCE)


def _weight() -> Iterator[Row]:
    """(15) mended: the least weight of the observer's part, and that 1 is too little."""
    place = "[1] eq. 15"
    for (strict, density), want in LEAST.items():
        f, o = _feedback(strict), _observer(density)
        id, about = f"weight/{strict:g}-{density:g}", f"Q = {strict:g} Q_e, R = {density:g} rad²/s³"
        least = composite.least_weight(f, o)
        yield within(
            id, f"least weight of the observer in (15), {about}", want, least, place, tolerance=5e-3, **REFERENCE
        )
        yield same(
            f"{id}/above",
            f"(15) holds 1 % above it, {about}",
            True,
            _is_positive(f, o, 1.01 * least),
            place,
            **REFERENCE,
        )
        yield same(
            f"{id}/one",
            f"(15) mended holds with weight 1, as in [1]'s Lyapunov function, {about}",
            True,
            _is_positive(f, o, 1.0),
            place,
            basis="text",
            must_hold=False,
            note="Weight 1 is too little; a greater one always exists, for Pi > 0.",
        )


def _is_positive(f: composite.Feedback, o: composite.Observer, weight: float) -> bool:
    z = composite.weighted_matrix(f, o, weight)
    size = np.sqrt(np.diag(z))
    return bool(np.linalg.eigvalsh(z / np.outer(size, size))[0] > 0)


def _printed_inequality_rows() -> Iterator[Row]:
    """(15) as printed, on the modes: satisfied by what the mended one refuses."""
    f = _feedback()
    found = {r: float(np.linalg.eigvalsh(composite.printed_inequality(f, _observer(r)))[-1]) for r in (10.0, 5e-7)}
    about: dict[str, Any] = {"relative": 0.05, **REFERENCE}
    for density, got in found.items():
        what = f"(15) as printed, on the modes and with -R_e, R = {density:g} rad²/s³, largest eigenvalue"
        note = f"Another figure was given, with no filter to it; here {found[10.0]:.3e} and {found[5e-7]:.3e}."
        yield within(f"printed-15/{density:g}", what, -1.4e-3, got, "[1] eq. 15", must_hold=False, note=note, **about)
        what = f"the same is negative definite, R = {density:g} rad²/s³"
        note = "Satisfied where the mended one is not with weight 1: it proves nothing."
        yield direction(f"printed-15/{density:g}/holds", what, "< 0", got, "[1] eq. 15", below=0.0, note=note)


def _robust() -> Iterator[Row]:
    """u_h of either sign is a change of the gain; the weights with which V then falls."""
    f, o = _feedback(), _observer(10.0)
    for name, factor, want in (("published", 0.5, -0.125), ("minus", 1.5, -0.236)):
        rightmost = float(np.linalg.eigvals(f.A + factor * f.B @ f.K).real.max())
        what = f"u_h with the {name} sign makes {factor:g} K of K: rightmost real part"
        yield within(f"u_h/{name}", what, want, rightmost, "[1] eq. 16", tolerance=5e-4, unit="1/s", **REFERENCE)
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
        note="Its sign is the wrong one: it halves the gain.",
    )
    least = composite.least_weight(f, o)
    for name, robust, times in (("published", 0.5, 0.5), ("off", 0.0, 2.0), ("minus", -0.5, 4.5)):
        got = composite.least_decrease_weight(f, o, robust) / least
        what = f"weight above which V falls, u_h {name}, over that of (15)"
        high = times * (1 + 1e-6)
        yield at_most(f"decrease/{name}", what, times, got, "[1] eqs. 14-16", high=high, **REFERENCE)

"""Printed gain: what K does to the printed matrices and to the vehicle, with either sign.

Weights of the gain are not printed; the signs of its entries are those of v = -K e, while eq. 13 says v = +K e.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 13 and numbers of its simulation.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import fly_seeds
from trimtab.scenarios.hypersonic import printed_gains
from trimtab.scenarios.hypersonic._design import error_model, feedback_gain
from trimtab.study import Row, at_most, same, within
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, K_PRINTED

SECTION = "eq. 13, printed K"
PLACE = "[1] printed A, B, K"
REFERENCE: dict[str, Any] = {"basis": "reference"}
SPECTRA = {
    "plus": ("printed A + B K", (4.780 + 1.042j, 5.656 + 18.405j), False),
    "minus": ("printed A - B K", (2.461 + 2.588j,), False),
    "rigid": ("printed A - B K, rigid 5 x 5", (-3.892 + 1.699j, -2.357, -1.445 + 1.495j), True),
    "damped": ("printed A - B K, damping with the model's sign", (2.388 + 2.587j,), False),
    "uncoupled": (
        "the same, and no modes in Q'",
        (-3.816 + 1.650j, -2.334, -1.484 + 1.534j, -0.923 + 19.981j, -0.330 + 16.497j),
        True,
    ),
}
"""Variant -> what it is, poles by the independent program, whether all decay."""
LOST = 10.0
"""Angle of attack (deg) at which the vehicle counts as lost; its curves hold from 0 to 4."""
WITHIN = 10.0
WEIGHTS = "R_e and Q_e are not printed; the gain here is for chosen weights and for the exact matrices."
CLAIM = "Neither sign holds: not with the printed matrices, not with the exact ones, not in flight."


def rows() -> Iterator[Row]:
    """Spectra of every variant, the gain itself, and what it does in flight."""
    for name, (words, wanted, decays) in SPECTRA.items():
        yield from _spectrum(name, words, wanted, decays)
    exact = error_model()[0]
    for sign, name in ((1, "plus"), (-1, "minus")):
        rightmost = float(np.linalg.eigvals(exact.A + sign * exact.B @ K_PRINTED).real.max())
        word = "+" if sign > 0 else "-"
        yield same(
            f"stable/exact-{name}",
            f"exact A {word} B K decays",
            True,
            rightmost < 0,
            "[1] simulation: the errors converge",
            basis="text",
            must_hold=False,
            note=f"{CLAIM} Rightmost real part here: {rightmost:.2f} 1/s.",
        )
    yield from _gain()
    yield from _flights()


def loop_matrix(name: str) -> Any:
    """The matrix (9, 9), or (5, 5), of one of SPECTRA."""
    A, B, K = A_PRINTED.copy(), B_PRINTED, K_PRINTED
    if name == "plus":
        return A + B @ K
    if name == "rigid":
        return A[:5, :5] - B[:5] @ K[:, :5]
    if name in ("damped", "uncoupled"):
        A[6, 6], A[8, 8] = -A[6, 6], -A[8, 8]
    if name == "uncoupled":
        A[4, 5:] = 0
    return A - B @ K


def _spectrum(name: str, words: str, wanted: tuple[complex, ...], decays: bool) -> Iterator[Row]:
    poles = np.linalg.eigvals(loop_matrix(name))
    rightmost = max(np.real(p) for p in wanted)
    yield within(
        f"spectrum/{name}",
        f"{words}, rightmost real part",
        rightmost,
        poles.real.max(),
        PLACE,
        tolerance=1e-2,
        unit="1/s",
        **REFERENCE,
    )
    off = max(float(np.abs(poles - p).min()) for p in wanted)
    yield at_most(
        f"spectrum/{name}-poles", f"{words}, poles off by", 0.0, off, PLACE, high=1e-2, unit="1/s", **REFERENCE
    )
    about: dict[str, Any] = dict(REFERENCE)
    if name in ("plus", "minus"):
        about = {"basis": "text", "must_hold": False, "note": CLAIM}
    elif name == "uncoupled":
        about |= {"note": "So K was probably designed without what the modes do to the pitch acceleration."}
    expected = True if name in ("plus", "minus") else decays
    place = "[1] simulation: the errors converge" if name in ("plus", "minus") else PLACE
    yield same(f"stable/{name}", f"{words} decays", expected, bool(poles.real.max() < 0), place, **about)


def _gain() -> Iterator[Row]:
    """Each entry beside that of the reference gain, with the sign of v = -K e."""
    found = -feedback_gain(error_model()[0], strict=1.0).K
    for i, j in np.ndindex(2, 9):
        yield within(
            f"K/{i + 1},{j + 1}",
            f"K[{i + 1}, {j + 1}]",
            float(K_PRINTED[i, j]),
            found[i, j],
            "[1] printed K",
            relative=0.01,
            must_hold=False,
            note=WEIGHTS,
        )


def _flights() -> Iterator[Row]:
    """The scenario, with either sign."""
    signs: tuple[tuple[printed_gains.Sign, str], ...] = ("minus", "v = -K e"), ("plus", "v = +K e, eq. 13")
    for sign, words in signs:
        flown = fly_seeds(printed_gains.scenario(sign=sign))
        gone = np.abs(np.degrees(flown["truth.alpha"][0])) > LOST
        when = float(flown.t[gone.argmax()]) if gone.any() else np.inf
        what = f"flight with {words}, time until the angle of attack passes {LOST:g} deg"
        yield at_most(
            f"flight/{sign}", what, "lost within 10 s", when, "[1] printed K", high=WITHIN, unit="s", **REFERENCE
        )
        yield same(
            f"flight/{sign}-tracks",
            f"flight with {words}, altitude and speed follow",
            True,
            not gone.any(),
            "[1] simulation, tracking",
            basis="text",
            must_hold=False,
            note=CLAIM,
        )

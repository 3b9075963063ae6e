"""Printed gain: effect of K on the printed matrices and on the vehicle, with either sign.

The gain's weights are not printed. The signs of its entries are those of v = -K e, while eq. 13 says v = +K e.
[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eq. 13 and numbers of its simulation.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.hypersonic2022._flights import fly_seeds
from studies.hypersonic2022._oracle import pole_error, reference
from trimtab.scenarios.hypersonic import printed_gains
from trimtab.scenarios.hypersonic._design import error_model, feedback_gain
from trimtab.study import Row, at_most, same, within
from trimtab.vehicles.hypersonic_printed import A_PRINTED, B_PRINTED, K_PRINTED

SECTION = "eq. 13, printed K"
PLACE = "[1] printed A, B, K"
SPECTRA = {
    "plus": "printed A + B K",
    "minus": "printed A - B K",
    "rigid": "printed A - B K, rigid 5 x 5",
    "damped": "printed A - B K, damping with the model's sign",
    "uncoupled": "printed A - B K, damping with the model's sign, no modes in Q'",
}
"""Variant -> description."""
LOST = 10.0
"""Angle of attack (deg) beyond which the vehicle counts as lost. Its curves are valid from 0 to 4 deg."""
WEIGHTS = "R_e and Q_e are not printed. The computed gain is for chosen weights and for the exact matrices."
CLAIM = "Neither sign is stable with the printed matrices, with the exact matrices, or in flight."


def rows() -> Iterator[Row]:
    """Yield rows on the poles of every variant, the gain itself, and its effect in flight."""
    for name, words in SPECTRA.items():
        yield from _spectrum(name, words)
    exact = error_model()[0]
    for sign, name in ((1, "plus"), (-1, "minus")):
        rightmost = float(np.linalg.eigvals(exact.A + sign * exact.B @ K_PRINTED).real.max())
        word = "+" if sign > 0 else "-"
        yield same(
            f"stable/exact-{name}",
            f"exact A {word} B K is stable",
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
    """Return the closed-loop matrix, (9, 9) or (5, 5), of one of SPECTRA."""
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


def _spectrum(name: str, words: str) -> Iterator[Row]:
    """Yield the rightmost pole and the largest error of all poles against the oracle's, and the printed claim."""
    poles, id = np.linalg.eigvals(loop_matrix(name)), f"spectrum/{name}"
    note = "So K was probably designed without the effect of the modes on Q'." if name == "uncoupled" else ""
    about: Any = {"unit": "1/s", "note": note}
    yield reference(id, f"{words}, rightmost real part", poles.real.max(), PLACE, **about)
    off, about = pole_error(poles, id), about | {"basis": "reference"}
    yield at_most(f"{id}-poles", f"{words}, largest error of the poles", 0.0, off, PLACE, high=1e-6, **about)
    if name in ("plus", "minus"):
        claim: Any = {"basis": "text", "must_hold": False, "note": CLAIM}
        decays = bool(poles.real.max() < 0)
        yield same(f"stable/{name}", f"{words} is stable", True, decays, "[1] simulation: the errors converge", **claim)


def _gain() -> Iterator[Row]:
    """Yield each printed entry compared with the reference gain, with the sign of v = -K e."""
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
    """Yield flights of the scenario, with either sign."""
    signs: tuple[tuple[printed_gains.Sign, str], ...] = ("minus", "v = -K e"), ("plus", "v = +K e, eq. 13")
    for sign, words in signs:
        flown = fly_seeds(printed_gains.scenario(sign=sign))
        gone = np.abs(np.degrees(flown["truth.alpha"][0])) > LOST
        when = float(flown.t[gone.argmax()]) if gone.any() else np.inf
        what = f"flight with {words}, time until the angle of attack passes {LOST:g} deg"
        yield reference(f"flight/{sign}", what, when, "[1] eq. 13, printed K", tolerance=0.041, unit="s")
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

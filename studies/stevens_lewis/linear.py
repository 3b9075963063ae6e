"""Linear models of the F-16 at its nominal trim, and their poles.

Flight is straight and level at 502 ft/s and sea level. The centre of mass is at 0.35 chords. Surfaces are in degrees.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import eig

from studies.stevens_lewis.trims import find_trim
from trimtab.core.rotation import DEG
from trimtab.design.linearise import LinearModel, linearise
from trimtab.scenarios.f16._gains import model_at
from trimtab.study import Row, within
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import F16FlatEarth, F16State
from trimtab.vehicles.imperial import FOOT

SECTION = "examples 4.4-1, 5.3-1 and 5.4-1"
ALONG = ("speed", "alpha", "pitch", "pitch_rate")
ASIDE = ("beta", "roll", "roll_rate", "yaw_rate")
NORMAL = ("alpha", "pitch_rate")
A_ALONG = np.array(
    [
        [-1.9311e-2, 8.8157, -32.170, -0.57499],
        [-2.5389e-4, -1.0189, 0.0, 0.90506],
        [0.0, 0.0, 0.0, 1.0],
        [2.9465e-12, 0.82225, 0.0, -1.0774],
    ]
)
B_ALONG = np.array([0.17370, -2.1499e-3, 0.0, -0.17555])
A_ASIDE = np.array(
    [
        [-0.3220, 0.0640, 0.0364, -0.9917],
        [0.0, 0.0, 1.0, 0.0037],
        [-30.6492, 0.0, -3.6784, 0.6646],
        [8.5396, 0.0, -0.0254, -0.4764],
    ]
)
B_ASIDE = np.array([[0.0003, 0.0008], [0.0, 0.0], [-0.7333, 0.1315], [-0.0319, -0.0620]])
LOADS = np.array([-16.26, -0.9788, 0.04852])
"""Derivative of commanded minus actual load factor, 15 ft ahead of the centre of mass, with respect to angle of attack
(rad), pitch rate (rad/s) and elevator (deg)."""
NAMES = {
    "4.4-1": ("fast-pitch", "slow-pitch", "slow-pitch", "growing-pitch"),
    "5.3-1": ("roll-subsidence", "dutch-roll", "dutch-roll", "spiral"),
}
"""Names of the poles, the largest first.

With the centre of mass at 0.35 chords there is no short period, and pitch is unstable.
"""
FIGURES = 1e-3
"""Relative tolerance. The printed numbers are finite differences, with a trim and inertias of four figures."""
MISPRINT = "5.3-1/A/roll/yaw_rate"
"""Row of a misprint. The kinematics give tan(pitch) = 0.0369 for this entry."""


@cache
def linear_model() -> LinearModel:
    """Return the linear model in feet and radians, with surfaces in degrees."""
    level = find_trim("nominal")
    x, u = F16State(*[0.0] * 13), F16Controls(*[0.0] * 4)
    states = np.ones(13)
    states[0] = FOOT
    return linearise(model_at(F16FlatEarth(), x, u), level.x, level.u).rescale(states, [DEG, DEG, DEG, 1.0])


def _entries(
    letter: str, printed: Any, computed: Any, names: tuple[str, ...], columns: tuple[str, ...], place: str
) -> Iterator[Row]:
    """Yield each printed entry that is neither zero nor one."""
    for i, j in np.ndindex(printed.shape):
        value = float(printed[i, j])
        if value in (0.0, 1.0) or abs(value) < 1e-9:
            continue
        id = f"{place}/{letter}/{names[i]}/{columns[j]}"
        yield within(
            id,
            f"{letter}, {names[i].replace('_', ' ')}' over {columns[j].replace('_', ' ')}",
            value,
            float(computed[i, j]),
            f"[1] example {place}",
            relative=FIGURES,
            tolerance=0.6e-4 if place == "5.3-1" else 0.0,
            must_hold=id != MISPRINT,
            note="A misprint: the entry is tan(pitch), 0.0369 here." if id == MISPRINT else "",
        )


def _poles(place: str, printed: Any, computed: Any) -> Iterator[Row]:
    """Yield each pole of a printed and a computed matrix.

    The tolerance follows from that of the entries, to first order.
    """
    found: Any = eig(printed, left=True, right=True)
    poles, left, right = found
    ours = np.linalg.eigvals(computed)
    entries = np.where(np.isin(printed, (0.0, 1.0)), 0.0, FIGURES * np.abs(printed))
    entries += 0.6e-4 * (entries > 0) if place == "5.3-1" else 0.0
    for i in np.argsort(-np.abs(poles)):
        if poles[i].imag < 0:
            continue
        slope = np.outer(left[:, i].conj(), right[:, i]) / (left[:, i].conj() @ right[:, i])
        off = float((np.abs(slope) * entries).sum())
        near = ours[np.argmin(np.abs(ours - poles[i]))]
        name = NAMES[place][int((np.abs(poles) > np.abs(poles[i]) * (1 + 1e-9)).sum())]
        for part, value, own in (("real", poles[i].real, near.real), ("imaginary", poles[i].imag, near.imag)):
            if value:
                id, what = f"{place}/pole/{name}/{part}", f"{name.replace('-', ' ')}, {part} part"
                about = f"[1] example {place}, poles of its matrix"
                yield within(id, what, float(value), float(own), about, tolerance=off, unit="1/s", basis="reference")


def rows() -> Iterator[Row]:
    """Yield the entries of the matrices, the derivatives of the load factor, and the poles of the printed matrices."""
    along = linear_model().part(ALONG, ["elevator"], ["normal_load"])
    yield from _entries("A", A_ALONG, along.A, ALONG, ALONG, "4.4-1")
    yield from _entries("B", B_ALONG[:, None], along.B, ALONG, ("elevator",), "4.4-1")
    yield from _poles("4.4-1", A_ALONG, along.A)
    aside = linear_model().part(ASIDE, ["aileron", "rudder"], [])
    yield from _entries("A", A_ASIDE, aside.A, ASIDE, ASIDE, "5.3-1")
    yield from _entries("B", B_ASIDE, aside.B, ASIDE, ("aileron", "rudder"), "5.3-1")
    misprinted = aside.A.copy()
    misprinted[1, 3] = A_ASIDE[1, 3]
    yield from _poles("5.3-1", A_ASIDE, misprinted)
    normal = along.part(NORMAL, ["elevator"], ["normal_load"])
    ours = [*-normal.C[0], -normal.D[0, 0]]
    for name, printed, computed in zip((*NORMAL, "elevator"), LOADS, ours, strict=True):
        what = f"commanded minus actual load per {name.replace('_', ' ')}"
        yield within(f"5.4-1/{name}", what, printed, computed, "[1] example 5.4-1", relative=FIGURES)

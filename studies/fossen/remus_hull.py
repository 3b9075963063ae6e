"""REMUS: what its shape, its tables and slender-body theory make of the coefficients."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studies.fossen import _hull
from studies.fossen._pictures import draw_hull
from trimtab.study import Row, within
from trimtab.vehicles.torpedo import Torpedo

SECTION = "chapters 2, 4 and 9"
STRIPS = 0.02
"""Tolerance of strips: the ends of hull and fins are given to 1 mm of 36 mm, and printed to 3 figures."""
LIMITS = "The strips of hull and fins that [1] took here are not known: the sum is a small difference of large ones."


def rows() -> Iterator[Row]:
    """Yield lengths and areas, added mass, cross-flow drag, lift."""
    yield from _shape()
    yield from _added_mass()
    yield from _lift_and_drag()
    yield from _depth_plane()


def _shape() -> Iterator[Row]:
    yield within("shape/length", "length of the hull", 1.33, _hull.LENGTH, "[1] table 2.1", tolerance=0.005, unit="m")
    yield within(
        "shape/frontal", "frontal area", 0.0285, np.pi * _hull.D**2 / 4, "[1] table A.1", relative=0.01, unit="m^2"
    )
    yield within(
        "shape/projected", "area seen from the side", 0.226, _hull.projected_area(), "[1] table A.1", relative=0.01,
        unit="m^2",
    )  # fmt: skip
    yield within("shape/volume", "volume", 0.0315, _hull.volume(), "[1] table A.1", relative=0.01, unit="m^3")
    yield within(
        "shape/centroid", "centroid of the hull ahead of the centre of buoyancy", 5.54e-3, _hull.centroid(),
        "[1] table 2.7", tolerance=1e-3, unit="m", note="The nose's distance from that centre is given to 1 mm.",
    )  # fmt: skip


def _added_mass() -> Iterator[Row]:
    hull, place = Torpedo().hull, "[1] appendix B"
    yield within(
        "added-mass/axial", "axial, X_u'", -0.93, -_hull.axial_added_mass(), place, relative=STRIPS, unit="kg",
        note="Lamb's factor of the ellipsoid; [1] reads it from a table for that.",
    )  # fmt: skip
    yield within(
        "added-mass/cross", "across, Y_v' and Z_w'", -35.5, -_hull.added_mass(0), place, relative=STRIPS, unit="kg"
    )
    yield within(
        "added-mass/coupling", "M_w' and Z_q', opposite N_v' and Y_r'", -1.93, _hull.added_mass(1), place,
        relative=STRIPS, unit="kg m",
    )  # fmt: skip
    yield within(
        "added-mass/pitch", "M_q' and N_r'", -4.88, -_hull.added_mass(2), place, relative=STRIPS, unit="kg m^2"
    )
    for name, value, of in (
        ("X_wq", hull.Xwq, hull.Yvdot), ("X_vr", hull.Xvr, -hull.Yvdot), ("Y_wp", hull.Ywp, -hull.Yvdot),
        ("Z_vp", hull.Zvp, hull.Yvdot), ("X_qq", hull.Xqq, -hull.Yrdot), ("X_rr", hull.Xrr, -hull.Yrdot),
        ("Y_pq", hull.Ypq, hull.Yrdot), ("M_vp", hull.Mvp, -hull.Yrdot), ("N_wp", hull.Nwp, -hull.Yrdot),
    ):  # fmt: skip
        yield within(f"added-mass/{name}", f"{name}, of the ideal fluid", value, of, place, tolerance=0.005)
    yield within(
        "added-mass/M_rp", "M_rp, of the ideal fluid: K_p' - N_r'", 4.86, hull.Kpdot - hull.Mqdot, place,
        tolerance=0.005, must_hold=False, unit="kg m^2",
        note="4.81 with the K_p' that flew: [1] raised that afterwards and kept this.",
    )  # fmt: skip


def _lift_and_drag() -> Iterator[Row]:
    yield within(
        "drag/across", "drag across the flow, Z_ww", -131, -_hull.cross_drag(lambda x: 1.0), "[1] appendix B",
        relative=STRIPS, unit="kg/m", note="Y_vv is printed there as -1310: ten times that, fitted to flights.",
    )  # fmt: skip
    yield within(
        "drag/moment", "moment of cross-flow drag, M_ww", 3.18, _hull.cross_drag(lambda x: x), "[1] appendix B",
        relative=STRIPS, unit="kg", must_hold=False, note=LIMITS,
    )  # fmt: skip
    yield within(
        "drag/pitch", "pitch drag before correction by [1], M_qq", -9.40,
        -_hull.cross_drag(lambda x: x * x * abs(x)), "[1] table 8.2", relative=STRIPS, unit="kg m^2", must_hold=False,
        note=f"10 % less. {LIMITS}",
    )  # fmt: skip
    slope = 1 / (1 / (2 * 0.9 * np.pi) + 1 / (np.pi * 2.21))
    yield within("lift/slope", "lift of a fin per angle, c_La", 3.12, slope, "[1] fin lift", tolerance=0.005)
    body = 0.5 * _hull.RHO * _hull.D**2 * 0.003 * _hull.LENGTH / _hull.D * 180 / np.pi
    yield within("lift/body", "lift of the body per u w", 22.4, body, "[1] chapter 9", relative=0.01, unit="kg/m")
    fin = _hull.RHO * slope * _hull.FIN_AREA / 2
    yield within(
        "lift/fins", "rudder, Y_uudr", 9.64, fin, "[1] table C.10", relative=STRIPS, unit="kg/(m rad)",
        must_hold=False, note="0.90 of what its formula gives with its own numbers.",
    )  # fmt: skip
    yield within(
        "lift/arm", "arm of the fins: rudder moment over force", -0.638, -6.15 / 9.64, "[1] table C.10",
        tolerance=5e-4, unit="m",
    )  # fmt: skip


def _depth_plane() -> Iterator[Row]:
    """[1] table 9.3 has M_q = -6.87, M_theta = -5.77, M_ds = -34.6 at 1.54 m/s; over Iyy - M_q' they make eq. 9.40."""
    inertia = Torpedo().inertia[1] - Torpedo().hull.Mqdot
    for what, printed, of in (("damping", 0.82, 6.87), ("stiffness", 0.69, 5.77), ("gain", 4.16, 34.6)):
        yield within(
            f"depth-plane/{what}", f"pitch by the stern planes: its {what}", printed, of / inertia, "[1] eq. 9.40",
            tolerance=0.01,
        )  # fmt: skip
    root = np.roots([1, 6.87 / inertia, 5.77 / inertia])[0]
    yield within(
        "depth-plane/real",
        "poles of pitch by the stern planes, real part",
        -0.41,
        root.real,
        "[1] eq. 9.40",
        tolerance=0.01,
    )
    yield within(
        "depth-plane/imaginary",
        "poles of pitch by the stern planes, imaginary part",
        0.72,
        abs(root.imag),
        "[1] eq. 9.40",
        tolerance=0.01,
    )


def figures(folder: Path) -> Iterator[Path]:
    """Draw the hull and its strips."""
    yield draw_hull(folder / "hull.png")

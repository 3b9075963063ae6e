"""REMUS: steady flight, and fin steps compared with the curves of Prestero's simulation."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from studies.fossen._flights import Flight, fly_fins
from studies.fossen._pictures import draw_fin_steps
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.study import Row, band, within
from trimtab.vehicles.torpedo import Torpedo

SECTION = "chapters 4 and 8"
HEAVE = 2.26
"""Weight minus buoyancy (N), from the initial force sums in [1] figure 8-8. Figure 8-13 has -6.63, figure 8-3 zero."""
SINK = -6.63
WEAK = "A fifth weaker than printed: appendix B damps pitch twice as much as yaw, though the body is round."
ROUND = "Computed with M_qq = N_rr, as for a round body. Appendix B has M_qq = 2 N_rr."


@cache
def turn() -> Flight:
    """Fly rudder +4 degrees from 10 s, -4 from 40 s. [1] figures 8-1 to 8-3."""
    return fly_fins(
        Torpedo(buoyancy=299.0), lambda t: 4 * DEG * (10 <= t < 40) - 4 * DEG * (t >= 40), lambda t: 0.0, 70
    )


@cache
def climb(is_round: bool = False) -> Flight:
    """Fly stern planes -4 degrees from 2 s. [1] figures 8-6 to 8-10. is_round: pitch damped as much as yaw."""
    return fly_fins(_ballast(HEAVE, is_round), lambda t: 0.0, lambda t: -4 * DEG * (t >= 2), 4)


@cache
def dive(is_round: bool = False) -> Flight:
    """Fly stern planes +8 degrees from 2 s. [1] figures 8-11 to 8-15. is_round: pitch damped as much as yaw."""
    return fly_fins(_ballast(SINK, is_round), lambda t: 0.0, lambda t: 8 * DEG * (t >= 2), 4)


def _ballast(heaviness: float, is_round: bool) -> Torpedo:
    torpedo = Torpedo(buoyancy=299.0 - heaviness)
    hull = torpedo.hull
    return replace(torpedo, hull=replace(hull, Mqq=hull.Nrr)) if is_round else torpedo


def rows() -> Iterator[Row]:
    """Yield the steady speed and roll, the turn, the climb and the dive."""
    torpedo = Torpedo()
    speed = np.sqrt(torpedo.thrust / -torpedo.hull.Xuu)
    yield within("steady/speed", "speed at 1500 rpm", 1.54, speed, "[1] table 8.1", tolerance=0.005, unit="m/s")
    roll = np.degrees(np.arcsin(torpedo.torque / (torpedo.lowered * torpedo.weight)))
    yield within(
        "steady/roll", "roll that balances the propeller's torque", -5.3, roll, "[1] eq. 4.47", tolerance=0.05,
        unit="deg", note="Measured at sea. [1] derives the propeller's torque from this roll.",
    )  # fmt: skip
    yield from _turn_rows()
    yield from _plane_rows()
    yield from _round_rows()


def _turn_rows() -> Iterator[Row]:
    f, place = turn(), "[1] figures 8-1 to 8-3"
    r, u, sway = np.degrees(f.rate[:, 2]), f.velocity[:, 0], f.velocity[:, 1]
    first, second = (f.t >= 25) & (f.t <= 38), (f.t >= 50) & (f.t <= 68)
    for id, what, read, got, off, unit in (
        ("peak", "yaw rate 4 s after the rudder step", -9.5, f.at(14, r), 0.3, "deg/s"),
        ("rate", "steady yaw rate to port", -9.0, r[first].mean(), 0.3, "deg/s"),
        ("back", "steady yaw rate to starboard", 9.3, r[second].mean(), 0.4, "deg/s"),
        ("surge", "surge in the turns", 1.39, u[first].mean(), 0.03, "m/s"),
        ("sway", "steady sway in the turn to port", 0.07, sway[first].mean(), 0.02, "m/s"),
        ("heading", "heading at 42 s", -245.0, f.at(42, np.degrees(f.angles[:, 2])), 5.0, "deg"),
        ("north", "northernmost position", 31.0, f.place[:, 0].max(), 1.0, "m"),
        ("south", "southernmost position", -3.0, f.place[:, 0].min(), 1.0, "m"),
        ("west", "westernmost position", -18.0, f.place[:, 1].min(), 1.0, "m"),
        ("east", "easternmost position", 3.0, f.place[:, 1].max(), 1.0, "m"),
    ):
        yield band(
            f"turn/{id}", what, read, got, place, low=read - off, high=read + off, unit=unit, basis="axis",
        )  # fmt: skip


def _plane_rows() -> Iterator[Row]:
    for name, f, place, read in (
        ("climb", climb(), "[1] figures 8-6 to 8-10", (1.0, 24.5, -0.47, 1.43, 0.17, 4.0, 4.5)),
        ("dive", dive(), "[1] figures 8-11 to 8-15", (-2.3, -36.5, 0.55, 1.19, -0.20, -7.5, -6.2)),
    ):
        pitch, heading = np.degrees(f.angles[:, 1]), np.degrees(f.angles[:, 2])
        u, w = f.velocity[:, 0], f.velocity[:, 2]
        for id, what, value, got, off, unit, holds in (
            ("early", "pitch at 1 s", read[0], f.at(1, pitch), 0.3, "deg", True),
            ("pitch", "pitch at 3.8 s", read[1], f.at(3.8, pitch), 0.1 * abs(read[1]), "deg", False),
            ("depth", "depth gained at 3.8 s", read[2], f.at(3.8, f.place[:, 2]), 0.05, "m", False),
            ("surge", "surge at 3.8 s", read[3], f.at(3.8, u), 0.08, "m/s", True),
            ("heave", "heave at 3.8 s", read[4], f.at(3.8, w), 0.05, "m/s", True),
            ("heading", "heading at 3.8 s", read[5], f.at(3.8, heading), 1.2, "deg", True),
            ("yaw", "yaw rate at 3.8 s", read[6], f.at(3.8, np.degrees(f.rate[:, 2])), 0.5, "deg/s", True),
        ):
            yield band(
                f"{name}/{id}", f"{name}: {what}", value, got, place, low=value - off, high=value + off, unit=unit,
                basis="axis", must_hold=holds, note="" if holds else WEAK,
            )  # fmt: skip


def _round_rows() -> Iterator[Row]:
    for name, f, place, read in (
        ("climb", climb(is_round=True), "[1] figure 8-6", (6.0, 15.5, 24.5)),
        ("dive", dive(is_round=True), "[1] figure 8-11", (-12.0, -26.0, -36.5)),
    ):
        pitch = np.degrees(f.angles[:, 1])
        for t, value in zip((2.0, 3.0, 3.8), read, strict=True):
            off = max(0.3, 0.05 * abs(value))
            yield band(
                f"{name}/round-{t:g}", f"{name}, damped as in yaw: pitch at {t:g} s", value, f.at(t, pitch), place,
                low=value - off, high=value + off, unit="deg", basis="axis", note=ROUND,
            )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot the turn, and pitch in climb and dive with the values read off the publication's figures."""
    yield draw_fin_steps(
        folder / "fin-steps.png", turn(), (climb(), climb(is_round=True)), (dive(), dive(is_round=True))
    )

"""Rows and plots of a case: distance of each signal outside the band of NASA's simulations."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.nesc2015._data import SIGNALS, Band, band_of, turn_near
from studies.nesc2015._flights import cases, fly
from studies.nesc2015._jet import fly_jet, jet_cases
from trimtab.plots.style import BLUE, GREY, VERMILION, new_figure, save_figure, style_axes
from trimtab.study import Row, at_most

OF_BAND, OF_SIZE, OF_FEW = 0.01, 1e-6, 0.1
"""Accepted distance outside a band: OF_BAND times its largest width, plus OF_SIZE times the largest magnitude of the
signal, as units (feet, slugs) were rounded. If the band is of at most FEW simulations, OF_FEW replaces OF_BAND."""
FEW = 3
JUMPS = {"13p1": 5, "13p2": 5, "13p3": 15, "13p4": 20}
"""Times of command steps (s). At these times and at the start, surfaces and aerodynamic forces jump."""
OPEN = {
    ("13p4", "aero_bodyForce_lbf_Y"): "A second after the step the force falls from 44 to 20 kN; here 50 ms earlier.",
    ("13p4", "airDensity_slug_ft3"): "Off by 6e-8: the air here is a millionth thinner, the height 1 cm larger.",
}
"""Signals that leave their band by a little more than its margin, with the reason."""
DRAWN = ("altitudeMsl_ft", "feVelocity_ft_s_Y", "eulerAngle_deg_Yaw", "bodyAngularRateWrtEi_deg_s_Pitch", "mach")


def ours_in(band: Band, case: str, signal: str) -> Any:
    """Return the computed signal (n,) at the band's instants, with an angle on the same turn as the band."""
    flight = fly_jet(case) if case in jet_cases() else fly(case)
    ours = flight[signal][np.isin(flight["time"], band.t)]
    return band.middle + turn_near(ours - band.middle) if SIGNALS[signal].unit == "rad" else ours


def title_of(case: str) -> str:
    """Return the title of a case."""
    return (jet_cases()[case] if case in jet_cases() else cases()[case]).title


def margin_of(band: Band) -> float:
    """Return the accepted distance of a signal outside a band."""
    of_band = OF_FEW if len(band.simulations) <= FEW else OF_BAND
    return float(of_band * np.max(band.high - band.low) + OF_SIZE * np.max(np.abs(band.values)))


def outside(band: Band, ours: Any, leave_out: tuple[float, ...] = ()) -> float:
    """Return the largest distance of a signal outside a band, except at some instants (s)."""
    off = np.maximum(np.maximum(band.low - ours, ours - band.high), 0.0)
    return float(np.max(off[~np.isin(band.t, leave_out)]))


def rows_of(numbers: tuple[str, ...]) -> Iterator[Row]:
    """Yield each signal of each case against its band, and for bodies the height against the nearest simulation."""
    for case in numbers:
        title = title_of(case)
        for signal, (name, unit, _) in SIGNALS.items():
            band = band_of(case, signal)
            yield at_most(
                f"{case}/{signal}",
                f"{title}: {name}",
                float(np.max(band.high - band.low)),
                outside(band, ours_in(band, case, signal), _jumps(case, signal)),
                f"[1] case {case.lstrip('0').replace('p', '.')}, its data",
                high=margin_of(band),
                unit=unit,
                must_hold=(case, signal) not in OPEN,
                note=OPEN.get((case, signal), "")
                or f"Printed: spread of {len(band.simulations)} simulations. Computed: distance outside their band.",
            )
        if case in jet_cases():
            continue
        band = band_of(case, "altitudeMsl_ft")
        away = np.max(np.abs(band.values - ours_in(band, case, "altitudeMsl_ft")), axis=1)
        nearest = int(np.argmin(away))
        yield at_most(
            f"{case}/nearest",
            f"{title}: height, difference from simulation {band.simulations[nearest]}",
            float(np.median(away)),
            float(away[nearest]),
            f"[1] case {case.lstrip('0').replace('p', '.')}, its data",
            high=OF_SIZE * float(np.max(np.abs(band.values))),
            unit="m",
            note="This simulation is the nearest. Printed: median difference of all simulations.",
        )


def _jumps(case: str, signal: str) -> tuple[float, ...]:
    """Return the instants at which a signal of a case jumps."""
    return (0.0, JUMPS.get(case, 0.0)) if case in jet_cases() and signal.startswith("aero") else ()


def draw_cases(folder: Path, numbers: tuple[str, ...]) -> Iterator[Path]:
    """Plot each case as difference from the median of NASA's simulations: simulations, their band, and trimtab."""
    folder.mkdir(parents=True, exist_ok=True)
    for case in numbers:
        figure = new_figure(15.0, 3.4)
        for axes, signal in zip(np.ravel(figure.subplots(1, len(DRAWN))), DRAWN, strict=True):
            band, (name, unit, _) = band_of(case, signal), SIGNALS[signal]
            axes.fill_between(band.t, band.low - band.middle, band.high - band.middle, color=GREY, alpha=0.3, lw=0)
            for theirs in band.values:
                axes.plot(band.t, theirs - band.middle, color=BLUE, lw=0.8)
            axes.plot(band.t, ours_in(band, case, signal) - band.middle, color=VERMILION, lw=1.4, ls="--")
            style_axes(axes, name, f"size {np.max(np.abs(band.values)):.4g} {unit}", unit)
            axes.set_xlabel("s", fontsize=9)
        path = folder / f"case-{case}.png"
        title = f"case {case.lstrip('0').replace('p', '.')}, {title_of(case)}"
        figure.suptitle(
            f"{title}: difference from the median of NASA's simulations (blue); trimtab red, dashed", fontsize=10
        )
        save_figure(figure, path)
        yield path

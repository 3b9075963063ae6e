"""The three cases most sensitive to the step converge at the integrator's order.

RK4 with steps from 1 s to 1/8 s is compared with a step of 5 ms. Each halving divides the error by sixteen. Smaller
steps are limited by rounding: positions of the size of the earth's radius resolve 10 nm.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studies.nesc2015._data import SIGNALS
from studies.nesc2015._flights import cases, fly
from trimtab.plots.style import SEVERAL, new_figure, save_figure, style_axes
from trimtab.study import Row, band

SECTION = "check-cases 2, 3 and 9"
CASES = {
    "02": "eulerAngle_deg_Pitch",
    "03": "bodyAngularRateWrtEi_deg_s_Pitch",
    "09": "altitudeMsl_ft",
}
STEPS = (1.0, 0.5, 0.25, 0.125)
EXACT = 0.005
LAST = 10
"""Duration of the flights (s). After that, the damped brick is at rest."""


def errors_of(case: str, signal: str) -> list[float]:
    """Return the largest error of a signal with each of STEPS."""
    exact = fly(case, LAST, EXACT)[signal]
    return [float(np.max(np.abs(fly(case, LAST, step)[signal] - exact))) for step in STEPS]


def order_of(errors: list[float]) -> float:
    """Return the order of convergence between the two smallest steps."""
    return float(np.log2(errors[-2] / errors[-1]))


def rows() -> Iterator[Row]:
    """Yield the order of convergence of each case."""
    for case, signal in CASES.items():
        yield band(
            f"{case}/order", f"{cases()[case].title}: order of the error of {SIGNALS[signal].name}", 4.0,
            order_of(errors_of(case, signal)), "Hairer, Nørsett, Wanner, table 1.2", low=3.7, high=4.6,
            basis="reference", note="The classical Runge-Kutta method is of order 4.",
        )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot the largest errors over the step size."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = new_figure(6.0, 4.5)
    axes = figure.subplots()
    for (case, signal), colour in zip(CASES.items(), SEVERAL, strict=False):
        errors = np.array(errors_of(case, signal))
        axes.loglog(STEPS, errors, "o-", color=colour, label=f"case {int(case)}, {SIGNALS[signal].name}")
        axes.loglog(STEPS, errors[-1] * (np.array(STEPS) / STEPS[-1]) ** 4, ":", color=colour)
    style_axes(axes, "error over the step", "dotted: fourth order", "m, rad, rad/s")
    axes.set_xlabel("step (s)", fontsize=9)
    axes.legend(frameon=False, fontsize=8)
    path = folder / "step-size.png"
    save_figure(figure, path)
    yield path

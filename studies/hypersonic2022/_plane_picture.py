"""Plot of the conditions that the paper's claim needs: share of successful flights as one parameter worsens."""

from pathlib import Path
from typing import Any

from studies.hypersonic2022._plane import FREQUENCIES, Axis, axis_shares
from trimtab.plots.style import BLUE, DPI, VERMILION


def draw_shares(folder: Path, axes: tuple[Axis, ...]) -> Path:
    """Draw one panel for each axis into plane-truth.png."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.6), dpi=DPI, facecolor="white", layout="constrained")
    panels: Any = figure.subplots(3, 4, sharey=True)
    for panel, axis in zip(panels.ravel(), axes, strict=True):
        for shares, frequency, colour, style in zip(
            axis_shares()[axis.name], FREQUENCIES, (BLUE, VERMILION), ("o-", "s--"), strict=True
        ):
            panel.plot(axis.values, 100 * shares, style, color=colour, markersize=4, label=f"modes × {frequency}")
        panel.set(xscale="log", title=axis.name, xlabel=axis.unit, ylim=(-5, 105))
        if axis.values[0] > axis.values[-1]:
            panel.invert_xaxis()
        panel.set_xticks(axis.values, labels=[f"{v:g}" for v in axis.values])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    for row in panels:
        row[0].set_ylabel("flights that succeed (%)")
    panels[0, 0].legend(fontsize=8)
    figure.suptitle("Hypersonic climb in rough air, one parameter at a time made worse (to the right)", fontsize=12)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "plane-truth.png"
    figure.savefig(path)
    return path

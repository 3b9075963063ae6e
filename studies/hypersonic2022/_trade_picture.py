"""Plot of the trade-off: elevator activity against tracking, and against errors of the modal frequencies.

Colours: Okabe and Ito, "Color universal design", 2008.
"""

from pathlib import Path
from typing import Any

import numpy as np

from studies.hypersonic2022._linear_loop import loop_quality
from studies.hypersonic2022._trade import (
    BETTER,
    EQUAL,
    EQUAL_SETTINGS,
    SEPARATE_SETTINGS,
    Activity,
    Setting,
    trade_curve,
)
from trimtab.plots.style import BLUE, DPI, GREEN, GREY, VERMILION

HIGHEST = 0.3
TRACKING = (0.008, 0.027)


def draw_trade(folder: Path) -> Path:
    """Draw both panels into elevator-trade.png."""
    from matplotlib.figure import Figure

    found = {setting.name: (setting, a) for setting, a in trade_curve()}
    figure = Figure(figsize=(12.5, 5.2), dpi=DPI, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_tracking(left, found)
    _draw_growth(right)
    figure.suptitle(
        "Elevator activity by filter tuning: noise of 0.01 rad/s² per sample, large climb, 20 seeds", fontsize=12
    )
    path = folder / "elevator-trade.png"
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def _draw_tracking(axes: Any, found: dict[str, tuple[Setting, Activity]]) -> None:
    axes.axhspan(*TRACKING, color="#EEEEEE", zorder=0)
    axes.text(0.53, 0.0084, "required", fontsize=8, color=GREY, ha="right", va="bottom")
    for settings, colour, words in (
        ((*EQUAL_SETTINGS[:4], EQUAL, *EQUAL_SETTINGS[4:]), BLUE, "the same on both modes"),
        ((*SEPARATE_SETTINGS[:5], BETTER, SEPARATE_SETTINGS[5]), VERMILION, "each mode its own"),
    ):
        flown = [found[s.name][1] for s in settings]
        x = np.array([np.rad2deg(np.sqrt(np.mean(a.elevator**2))) for a in flown])
        h = np.array([np.sqrt(np.mean(a.h**2)) for a in flown])
        spans = np.array([(y - a.h.min(), a.h.max() - y) for y, a in zip(h, flown, strict=True)]).T
        axes.errorbar(x, h, yerr=spans, color=colour, marker="o", markersize=4, lw=1.0, capsize=2, label=words)
        for s, at, a in zip(settings, x, flown, strict=True):
            y, near = (a.h.max(), (0, 3)) if colour == BLUE else (a.h.min(), (0, -10))
            style: dict[str, Any] = {"fontsize": 7, "color": colour, "ha": "center"}
            axes.annotate(_label(s), (at, y), near, textcoords="offset points", **style)
    _mark_settings(axes, found)
    axes.set(ylabel="rms error of h (ft), with the smallest and largest of the seeds", ylim=(0, 0.07), xlim=(0, 0.54))
    _style_axes(axes, "Tracking")


def _draw_growth(axes: Any) -> None:
    both = [loop_quality((1e-5, q, 1e-5, q)) for q in np.geomspace(0.5, 1000, 24)]
    separate = np.array([s.Q for s in (*SEPARATE_SETTINGS, BETTER)])
    first, second = separate[:, 1], separate[:, 3]
    order = np.argsort(first)
    grid = np.geomspace(first.min(), first.max(), 24)
    twos = np.exp(np.interp(np.log(grid), np.log(first[order]), np.log(second[order])))
    apart = [loop_quality((1e-5, a, 1e-5, b)) for a, b in zip(grid, twos, strict=True)]
    for many, colour, words in ((both, BLUE, "the same on both modes"), (apart, VERMILION, "each mode its own")):
        axes.plot(np.rad2deg([q.elevator for q in many]), [q.worst for q in many], color=colour, lw=1.2, label=words)
    for setting, colour, marker in ((EQUAL, "black", "*"), (BETTER, GREEN, "D")):
        q = loop_quality(setting.Q)
        axes.plot(np.rad2deg(q.elevator), q.worst, marker=marker, color=colour, markersize=11 if marker == "*" else 6)
    axes.axhspan(0, 0.15, color="#F6DDD0", zorder=0)
    axes.text(0.53, 0.135, "vehicle lost", fontsize=9, color=VERMILION, ha="right", va="top")
    axes.set(
        ylabel="real part of the slowest pole (1/s), modal frequencies 10 % off, worst of 8",
        ylim=(-0.25, 0.15),
        xlim=(0, 0.54),
    )
    axes.axvline(HIGHEST, color=GREY, lw=0.9, ls="--")
    _style_axes(axes, "Robustness")


def _mark_settings(axes: Any, found: dict[str, tuple[Setting, Activity]]) -> None:
    for setting, colour, marker, words in (
        (EQUAL, "black", "*", "equal noise"),
        (BETTER, GREEN, "D", "better on both, the default"),
    ):
        a = found[setting.name][1]
        x, h = np.rad2deg(np.sqrt(np.mean(a.elevator**2))), np.sqrt(np.mean(a.h**2))
        size = 11 if marker == "*" else 6
        axes.plot(x, h, marker=marker, color=colour, markersize=size, ls="none", label=words, zorder=5)
    axes.axvline(HIGHEST, color=GREY, lw=0.9, ls="--")
    axes.text(HIGHEST + 0.004, 0.002, "allowed", fontsize=8, color=GREY)
    axes.legend(loc="upper left", bbox_to_anchor=(0.17, 1.0), fontsize=8, frameon=False)


def _label(setting: Setting) -> str:
    one, two = setting.Q[1], setting.Q[3]
    return f"{one:g}" if one == two else f"{one:g}, {two:g}"


def _style_axes(axes: Any, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=11, weight="bold")
    axes.set_xlabel("elevator activity from noise (deg rms)")
    axes.grid(color="#d8d8d8", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)

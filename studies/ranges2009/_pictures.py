"""Plots of the study of ranging radios."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.logs.consistency import chi_square_bounds
from trimtab.plots.style import BLUE, GREEN, GREY, ORANGE, SEVERAL, VERMILION, new_figure, save_figure, style_axes

LAGS = 20


def draw_noise(path: Path, name: str, noise: Any, ids: tuple[int, ...]) -> Path:
    """Plot the errors of a log's ranges over distance, and residuals, distribution and autocorrelation."""
    figure = new_figure(13.0, 8.0)
    over, left, shape, memory = np.ravel(figure.subplots(2, 2))
    for i, radio in enumerate(ids):
        me, colour = noise.beacon == i, SEVERAL[i]
        over.plot(noise.distance[me], noise.error[me], ".", color=colour, ms=2, label=f"radio {radio}")
        ends = np.array([noise.distance[me].min(), noise.distance[me].max()])
        over.plot(ends, noise.fits[i, 0] + noise.fits[i, 1] * ends, color=colour, lw=1.2)
        left.plot(noise.distance[me], noise.residual[me], ".", color=colour, ms=2)
        r = noise.residual[me] - noise.residual[me].mean()
        rho = [float(r[:-k] @ r[k:] / (r @ r)) for k in range(1, LAGS + 1)]
        memory.plot(range(1, LAGS + 1), rho, ".-", color=colour, lw=0.8)
    sigma = noise.residual.std()
    bins = np.linspace(-4 * sigma, 4 * sigma, 61)
    shape.hist(noise.residual, bins.tolist(), density=True, color=BLUE, alpha=0.5)
    shape.plot(bins, np.exp(-0.5 * (bins / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)), color=VERMILION, lw=1.2)
    shape.set_yscale("log")
    bound = 2 / np.sqrt(len(noise.residual) / len(ids))
    for level in (-bound, bound):
        memory.axhline(level, color=GREY, lw=0.8, ls="--")
    style_axes(over, "range minus true distance", "lines: fit to each radio", "m")
    style_axes(left, "residuals of the fits", f"standard deviation {sigma:.3f} m", "m")
    style_axes(shape, "distribution of the residuals", "red: normal", "1/m")
    style_axes(memory, "autocorrelation of the residuals", "dashed: two sigmas of white noise")
    over.legend(frameon=False, fontsize=8, markerscale=4)
    for axes, label in ((over, "distance (m)"), (left, "distance (m)"), (shape, "m"), (memory, "lag (ranges)")):
        axes.set_xlabel(label, fontsize=9)
    return _save(figure, path, f"{name}: noise of the ranges")


def draw_way(path: Path, name: str, plaza: Any, flights: Mapping[str, Any], batch: Mapping[str, Any]) -> Path:
    """Plot the true path, each filter's path and that of gtsam's batch, with north up."""
    figure = new_figure(5.0 + 5.5 * len(flights), 6.5)
    every = np.ravel(figure.subplots(1, len(flights) + 1, sharex=True, sharey=True))
    rows = np.asarray(batch["row"])
    drawn = {f"{kind} filter": (f.rms, f.place) for kind, f in flights.items()}
    drawn["gtsam, whole drive"] = (batch["rms"], np.stack([batch["north"], batch["east"]], axis=1))
    for axes, (label, (rms, way)) in zip(every, drawn.items(), strict=True):
        axes.plot(plaza.east, plaza.north, color=GREY, lw=2.0, alpha=0.6, label="truth")
        axes.plot(way[:, 1], way[:, 0], color=BLUE if len(way) > len(rows) else GREEN, lw=0.7, label=label)
        axes.plot(plaza.beacons[:, 1], plaza.beacons[:, 0], "^", color=VERMILION, label="radios")
        for place, radio in zip(plaza.beacons, plaza.ids, strict=True):
            axes.annotate(str(radio), (place[1], place[0]), xytext=(4, 4), textcoords="offset points", fontsize=8)
        style_axes(axes, label, f"rms {rms:.3f} m", "m")
        axes.set_xlabel("east (m)", fontsize=9)
        axes.set_aspect("equal", adjustable="box")
        axes.legend(frameon=False, fontsize=8, loc="lower left")
    every[0].set_ylabel("north (m)", fontsize=9)
    return _save(figure, path, f"{name}: path")


def draw_errors(path: Path, title: str, flight: Any) -> Path:
    """Plot errors with three sigmas, NEES over time with the band of a single instant, and normalised innovations."""
    figure = new_figure(13.0, 9.5)
    grid = figure.add_gridspec(4, 2)
    north, east, nees = (figure.add_subplot(grid[k, :]) for k in range(3))
    shape, tails = (figure.add_subplot(grid[3, k]) for k in range(2))
    for k, (axes, name) in enumerate(((north, "north"), (east, "east"))):
        sigma = 3 * np.sqrt(flight.P[:, k, k])
        axes.fill_between(flight.t, -sigma, sigma, color=ORANGE, alpha=0.3, lw=0)
        axes.plot(flight.t, flight.error[:, k], color=BLUE, lw=0.7)
        axes.set_ylim(-2.5, 2.5)
        beyond = float(np.mean(np.abs(flight.error[:, k]) > sigma))
        style_axes(axes, f"{name}: estimate minus truth", f"three sigmas; {100 * beyond:.2f} % outside", "m")
    z = flight.normalised
    values, judged = np.sum(z * z, axis=1), flight.consistency()
    low, high = chi_square_bounds(2, 1)
    nees.fill_between(flight.t, low, high, color=ORANGE, alpha=0.3, lw=0)
    nees.plot(flight.t, values, color=BLUE, lw=0.6)
    nees.axhline(judged.mean, color=VERMILION, lw=1.2)
    nees.set_ylim(0, 20)
    words = f"mean {judged.mean:.2f}, band of the mean {judged.low:.2f} to {judged.high:.2f}; shaded: 95 % of instants"
    style_axes(nees, "NEES of the position", words)
    nees.set_xlabel("time (s)", fontsize=9)
    fix = "estimate.state.position_fix"
    y = flight.log[f"{fix}.normalised"][flight.log[f"{fix}.innovation"] != 0]
    bins = np.linspace(-5, 5, 61)
    shape.hist(y, bins.tolist(), density=True, color=BLUE, alpha=0.5)
    shape.plot(bins, np.exp(-0.5 * bins**2) / np.sqrt(2 * np.pi), color=VERMILION, lw=1.2)
    style_axes(shape, "innovations of the ranges", "normalised; red: normal")
    levels = np.linspace(0, 4.5, 91)
    tails.semilogy(levels, [max(float(np.mean(np.abs(y) > v)), 1e-5) for v in levels], color=BLUE)
    tails.semilogy(levels, [_normal_beyond(v) for v in levels], color=VERMILION, lw=1.2)
    tails.set_ylim(1e-4, 1)
    style_axes(tails, "share beyond a number of sigmas", "red: normal")
    return _save(figure, path, title)


def _save(figure: Any, path: Path, title: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path, title, "", title_size=14)
    return path


def _normal_beyond(level: float) -> float:
    return math.erfc(level / math.sqrt(2))

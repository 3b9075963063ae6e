"""Plots of the study of marine vehicles."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from studies.fossen import _hull
from trimtab.core.integrate import rk4
from trimtab.core.record import to_arrays
from trimtab.core.rotation import DEG
from trimtab.plots.style import BLUE, GREEN, GREY, ORANGE, SEVERAL, VERMILION, new_figure, save_figure, style_axes
from trimtab.vehicles.surface_vessel import TURN, SurfaceVessel, VesselControls, VesselState


def draw_hull(path: Path) -> Path:
    """Draw the profile of the hull with its fins, and its added mass per length."""
    figure = new_figure(10.0, 5.0)
    lines, mass = figure.subplots(2, 1, sharex=True)
    s = np.linspace(0, _hull.LENGTH, 600)
    R, x = np.array([_hull.radius(v) for v in s]), _hull.NOSE - s
    lines.fill_between(x, -R, R, color=BLUE, alpha=0.25, lw=0)
    lines.plot(x, R, color=BLUE, lw=1.2)
    lines.plot(x, -R, color=BLUE, lw=1.2)
    fins = [_hull.FIN_END, _hull.FIN_START]
    for side in (-1, 1):
        lines.fill_between(fins, [0, 0], [side * _hull.FIN_RADIUS] * 2, color=VERMILION, alpha=0.4, lw=0)
    lines.plot(0, 0, "o", color=GREY, ms=4)
    lines.set_aspect("equal")
    a = _hull.FIN_RADIUS
    within = (x > _hull.FIN_END) & (x < _hull.FIN_START)
    strip = np.where(within, a**2 - R**2 + R**4 / a**2, R**2) * np.pi * _hull.RHO
    mass.plot(x, strip, color=BLUE, lw=1.2)
    style_axes(lines, "hull of REMUS by Myring's formula", "dot: centre of buoyancy; red: fins", "m")
    style_axes(mass, "added mass per length", "including the fins", "kg/m")
    mass.set_xlabel("ahead of the centre of buoyancy (m)", fontsize=9)
    return _save(figure, path)


def draw_fin_steps(path: Path, turn: Any, climb: Any, dive: Any) -> Path:
    """Plot turns to both sides (seen from above), their yaw rate, and the pitch after steps of the stern planes."""
    figure = new_figure(13.0, 4.2)
    plan, rate, pitch = figure.subplots(1, 3)
    plan.plot(turn.place[:, 1], turn.place[:, 0], color=BLUE, lw=1.2)
    plan.set_aspect("equal")
    plan.set_xlabel("east (m)", fontsize=9)
    rate.plot(turn.t, np.degrees(turn.rate[:, 2]), color=BLUE, lw=1.0)
    rate.plot([14, 25, 38], [-9.5, -9.0, -9.0], "o", color=VERMILION, ms=4)
    rate.plot([50, 68], [9.3, 9.3], "o", color=VERMILION, ms=4)
    for pair, read, colour in ((climb, (1.0, 6.0, 15.5, 24.5), GREEN), (dive, (-2.3, -12.0, -26.0, -36.5), ORANGE)):
        for flight, style in zip(pair, ("-", "--"), strict=True):
            pitch.plot(flight.t, np.degrees(flight.angles[:, 1]), style, color=colour, lw=1.2)
        pitch.plot((1, 2, 3, 3.8), read, "o", color=VERMILION, ms=4)
    style_axes(plan, "rudder ±4°", "from above", "north (m)")
    style_axes(rate, "yaw rate in this turn", "dots: read off the thesis", "deg/s")
    style_axes(pitch, "pitch, planes −4°, +8°", "dashed: pitch damped like yaw", "deg")
    for axes in (rate, pitch):
        axes.set_xlabel("time (s)", fontsize=9)
    return _save(figure, path)


def draw_turning(path: Path) -> Path:
    """Plot CyberShip II turning with four rudder angles, from straight ahead at 1000 rpm."""
    vessel, step = SurfaceVessel(), 0.05
    figure = new_figure(6.5, 5.0)
    plan = figure.subplots()
    for angle, colour in zip((5, 10, 20, 35), SEVERAL, strict=False):
        told = VesselControls(-angle * DEG, 1000 / 60 * TURN)

        def advance(x: Any, _: Any, told: VesselControls = told) -> Any:
            return rk4(lambda t, x: vessel.dynamics(t, x, told), 0.0, x, step), (x.north, x.east)

        first = to_arrays(VesselState(surge_velocity=0.5818, shaft_speed=told.shaft_speed))
        _, (north, east) = jax.lax.scan(advance, first, None, length=900)
        plan.plot(east, north, color=colour, lw=1.2, label=f"{angle}°")
    plan.set_aspect("equal")
    plan.set_xlabel("east (m)", fontsize=9)
    plan.legend(frameon=False, fontsize=8, title="rudder")
    style_axes(plan, "CyberShip II turns to starboard", "45 s from 0.58 m/s", "north (m)")
    return _save(figure, path)


def _save(figure: Any, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    return path

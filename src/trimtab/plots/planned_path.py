"""Plot of a planned path: floor, obstacles, route, and the simulated flight along the route with its inputs."""

from typing import TYPE_CHECKING, Any

import numpy as np

from trimtab.design.obstacles import PlanTask
from trimtab.plots.style import BLUE, GREEN, GREY, VERMILION, PicturePath, new_figure, save_figure, style_axes
from trimtab.run.planner import FlownPlan

if TYPE_CHECKING:  # matplotlib is imported when something is drawn
    from matplotlib.figure import Figure

EACH = 50
"""Number of points of the plan between two drawn outlines of the craft."""


def plot_planned_path(task: PlanTask, plan: FlownPlan, path: PicturePath = None, title: str = "Plan") -> "Figure":
    """Draw a planned path, with north up and east to the right. Circles show the craft, short lines the nose.

    Args:
        task: planning task.
        plan: plan to draw.
        path: file in which the plot is saved, or None to save no file (`PicturePath`).
        title: title of the plot.
    """
    figure = new_figure(12.0, 6.4)
    grid: Any = figure.add_gridspec(3, 2, width_ratios=(1.25, 1))
    floor: Any = figure.add_subplot(grid[:, 0])
    _draw_floor(floor, task)
    _draw_flight(floor, task, plan)
    flown, t = plan.flown, plan.flown["time"]
    speed = np.hypot(flown["surge_velocity"], flown["sway_velocity"])
    law = plan.law
    rows = (
        ("thrust", "N", flown["thrust"], (-float(law.pull), float(law.push))),
        ("force angle", "rad", flown["force_angle"], (-float(law.deflection), float(law.deflection))),
        ("speed and clearance", "m/s, m", speed, (0.0,)),
    )
    for k, (name, unit, values, limits) in enumerate(rows):
        axes: Any = figure.add_subplot(grid[k, 1])
        style_axes(
            axes, name, "dashed: limits" if len(limits) > 1 else "blue: speed, green: distance from obstacles", unit
        )
        axes.plot(t, values, color=BLUE, lw=1.2)
        for limit in limits:
            axes.axhline(limit, color=VERMILION, lw=0.9, ls="--")
        if k == 2:
            axes.plot(t, flown["clearance"], color=GREEN, lw=1.2)
            axes.set_xlabel("time (s)")
    return save_figure(figure, path, title, f"{plan.length:.1f} m in {plan.times[-1]:.1f} s")


def _draw_floor(axes: Any, task: PlanTask) -> None:
    from matplotlib.patches import Circle, Polygon, Rectangle

    floor = task.floor
    corner = floor.east[0], floor.north[0]
    axes.add_patch(Rectangle(corner, np.ptp(floor.east), np.ptp(floor.north), fill=False, color="black", lw=1.2))
    for north, east, radius in np.reshape(floor.circles, (-1, 3)):
        axes.add_patch(Circle((east, north), radius, color=GREY, alpha=0.6, lw=0))
    for corners in floor.polygons:
        axes.add_patch(Polygon(corners[:, ::-1], color=GREY, alpha=0.6, lw=0))
    axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    axes.set(xlim=np.add(floor.east, (-0.2, 0.2)), ylim=np.add(floor.north, (-0.2, 0.2)))


def _draw_flight(axes: Any, task: PlanTask, plan: FlownPlan) -> None:
    from matplotlib.patches import Circle

    flown = plan.flown
    axes.plot(plan.route.places[:, 1], plan.route.places[:, 0], color=GREY, lw=1.0, ls="--", label="searched path")
    axes.plot(flown["east"], flown["north"], color=BLUE, lw=1.4, label="flight, centre of mass")
    for k in range(0, len(flown["time"]), EACH):
        north, east, heading = flown["north"][k], flown["east"][k], flown["heading"][k]
        axes.add_patch(Circle((east, north), task.radius, fill=False, color=BLUE, lw=0.4, alpha=0.7))
        tip = task.radius * np.array([np.sin(heading), np.cos(heading)])
        nose = "nose" if k == 0 else None
        axes.plot([east, east + tip[0]], [north, north + tip[1]], color=VERMILION, lw=0.9, label=nose)
    axes.plot(task.start[1], task.start[0], "o", color=GREEN, ms=6, label="start")
    axes.plot(task.goal[1], task.goal[0], "*", color=GREEN, ms=11, label="goal")
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)

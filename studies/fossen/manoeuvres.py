"""The Mariner's standard manoeuvres: turning circles, and zigzags.

[4] gives the derivatives. Its measurements of these manoeuvres were not available, so each row compares with an
independent program. The approach is straight. Advance and transfer are measured from the point where the rudder is
ordered to 90 degrees of heading. The tactical diameter is the transfer at 180 degrees of heading.
"""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.integrate import rk4
from trimtab.core.record import to_arrays
from trimtab.core.rotation import DEG
from trimtab.plots.style import SEVERAL, new_figure, save_figure, style_axes
from trimtab.study import Row, within
from trimtab.vehicles.mariner import Mariner, MarinerControls, MarinerState

SECTION = "turning circles and zigzags of [4]"
CIRCLE, ZIGZAG = (0.1, 700.0), (0.02, 200.0)
"""Time step and duration (s). A rudder order is at most one step late, which is 0.01 degrees of heading in a zigzag."""
CIRCLES = {
    15: {"advance": 752.91, "transfer": 553.35, "tactical": 1273.61, "radius": 665.38},
    35: {"advance": 570.18, "transfer": 420.23, "tactical": 1029.22, "radius": 555.72},
}
"""Rudder angle (deg) -> dimensions of the turn to starboard (m), computed by python -m oracles.mariner."""
ZIGZAGS = {10: (4.927, 4.456), 20: (7.784, 6.309)}
"""Rudder and heading angle of a zigzag (deg) -> first and second overshoot (deg), by python -m oracles.mariner."""


@cache
def turn(rudder: float) -> dict[str, float]:
    """Return advance, transfer, tactical diameter and steady radius (m) of a turn to starboard. rudder: in degrees."""
    path = _fly(lambda x, side: (-rudder * DEG + 0 * x.rudder, side), *CIRCLE)
    heading = path.heading

    def at(angle: float, place: Any) -> float:
        return float(np.interp(angle * DEG, heading, place))

    speed = np.hypot(path.surge_velocity[-1], path.sway_velocity[-1])
    return {
        "advance": at(90, path.north),
        "transfer": at(90, path.east),
        "tactical": at(180, path.east),
        "radius": float(speed / path.yaw_rate[-1]),
    }


@cache
def zigzag(angle: float) -> tuple[float, float]:
    """Return the first and second overshoot (deg).

    The rudder, first to starboard, reverses at +-`angle` (deg) of heading.
    """

    def steer(x: MarinerState, side: Any) -> tuple[Any, Any]:
        side = jnp.where(side * x.heading >= angle * DEG, -side, side)
        return -side * angle * DEG, side

    heading = _fly(steer, *ZIGZAG).heading / DEG
    back = int(np.argmax(heading <= -angle))
    return float(heading[:back].max() - angle), float(-heading[back:].min() - angle)


def _fly(steer: Any, dt: float, seconds: float) -> Any:
    """Return the states after a straight approach.

    steer: (state, side of the rudder) -> (commanded rudder (rad), side).
    """
    ship = Mariner()

    def step(carry: Any, _: Any) -> Any:
        x, side = carry
        told, side = steer(x, side)
        after = rk4(lambda t, x: ship.dynamics(t, x, MarinerControls(told)), 0.0, x, dt)
        return (after, side), x

    first = to_arrays(MarinerState()), jnp.asarray(1.0)
    return jax.tree.map(np.asarray, jax.jit(lambda c: jax.lax.scan(step, c, None, round(seconds / dt))[1])(first))


def rows() -> Iterator[Row]:
    """Yield each dimension of both turning circles, and the overshoots of both zigzags."""
    place = "not printed; computed by tests/oracles/mariner.py"
    words = {"advance": "advance", "transfer": "transfer", "tactical": "tactical diameter", "radius": "steady radius"}
    for rudder, wanted in CIRCLES.items():
        for name, number in wanted.items():
            what = f"Mariner, rudder {rudder}°: {words[name]}"
            about: dict[str, Any] = {"tolerance": 0.05, "unit": "m", "basis": "reference"}
            yield within(f"circle-{rudder}/{name}", what, number, turn(rudder)[name], place, **about)
    for angle, pair in ZIGZAGS.items():
        for which, number, computed in zip(("first", "second"), pair, zigzag(angle), strict=True):
            what = f"Mariner, zigzag {angle}/{angle}: {which} overshoot"
            about = {"tolerance": 0.02, "unit": "deg", "basis": "reference"}
            yield within(f"zigzag-{angle}/{which}", what, number, computed, place, **about)


def figures(folder: Path) -> Iterator[Path]:
    """Plot both circles from above, and the heading of both zigzags."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = new_figure(10.0, 4.2)
    plan, heading = figure.subplots(1, 2)
    for rudder, colour in zip(CIRCLES, SEVERAL, strict=False):
        path = _fly(lambda x, side, rudder=rudder: (-rudder * DEG + 0 * x.rudder, side), *CIRCLE)
        plan.plot(path.east, path.north, color=colour, lw=1.2, label=f"{rudder}°")
    for angle, colour in zip(ZIGZAGS, SEVERAL, strict=False):

        def steer(x: MarinerState, side: Any, angle: int = angle) -> tuple[Any, Any]:
            side = jnp.where(side * x.heading >= angle * DEG, -side, side)
            return -side * angle * DEG, side

        path = _fly(steer, *ZIGZAG)
        time = ZIGZAG[0] * np.arange(len(path.heading))
        heading.plot(time, path.heading / DEG, color=colour, lw=1.2, label=f"{angle}/{angle}")
        heading.plot(time, -path.rudder / DEG, color=colour, lw=0.8, ls="--")
    plan.set_aspect("equal")
    plan.set_xlabel("east (m)", fontsize=9)
    heading.set_xlabel("time (s)", fontsize=9)
    for axes in (plan, heading):
        axes.legend(frameon=False, fontsize=8)
    style_axes(plan, "the Mariner turns to starboard", "rudder", "north (m)")
    style_axes(heading, "zigzags", "dashed: rudder, starboard positive", "deg")
    file = folder / "manoeuvres.png"
    save_figure(figure, file)
    yield file

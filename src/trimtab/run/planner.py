"""Planner of a flyable path between obstacles for the hovercraft: search for a route, then a simulated flight along it.

The plan is the motion in the simulated flight with the law `laws.receding_horizon`. It is a reference for the heading
and for the position of P, the centre of percussion. Therefore the plan respects the limits of fan and rudder.
Collisions are checked along the flight. If the craft touches an obstacle or does not reach the goal, other speeds and
accelerations are tried. If all of them fail, an InputError is raised.

Source: Y. Kuwata, J. Teo, G. Fiore, S. Karaman, E. Frazzoli, J. How, "Real-time motion planning with applications to
autonomous urban driving", IEEE Trans. Control Systems Technology 17 (2009) 1105, for planning with a simulated closed
loop.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.reference import PiecewisePath, interpolate_path
from trimtab.core.time import ms
from trimtab.design.obstacles import PlanTask
from trimtab.design.route import Route, Tempo, find_route
from trimtab.estimators.passthrough import Passthrough
from trimtab.laws.receding_horizon import RecedingHorizon
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.run.simulate import simulate
from trimtab.sensors.planar_pose import PlanarPose
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

LAW = RecedingHorizon(push=1.2, pull=0.5, deflection=0.32, thrust_rate=6.0, angle_rate=2.0, yaw=0.2, lag=0.0)
"""Control law of the planned flight. It uses less than the available forces and rates, so that the law that follows the
plan later has a reserve of a tenth of the forces and more than a tenth of the rates."""
PIECES = 96
"""Number of polynomial pieces of the reference path. It is the same for all routes, so that the flight is compiled only
once."""
SETTLE = 6.0
"""Simulated flight time after the end of the route (s)."""
TICK = ms(20)
SAMPLE = 0.2
"""Time between two points of a plan (s)."""
TEMPOS = (1.0, 1.0), (0.8, 0.7), (1.0, 1.6), (0.65, 0.7)
"""Pairs of factors, on the speed and on the accelerations of a route, that are tried one after the other. Slower
flights are not always better, because the craft turns slowly at low thrust."""
KEEP = 0.05
"""Minimum distance between the circle around the craft and an obstacle in the planned flight (m). It allows for
tracking errors of the law that follows the plan."""
ARRIVED = 0.15, 0.04
"""Largest accepted distance from the goal (m) and largest accepted speed (m/s) at the end of the planned flight."""


class FlownPlan(NamedTuple):
    """Plan with n points, one every SAMPLE seconds, and its simulated flight with m points, one every 20 ms.

    times: times of the plan (n,), in s.  places: positions of the centre of percussion P in the world frame W (n, 2),
    in m.  headings: headings (n,), in rad, unwrapped.  flown: arrays (m,) of the simulated flight: time, north and east
    of the centre of mass, heading, thrust (N), force angle (rad), clearance (m).  route: result of the route search.
    clearance: smallest distance between the circle around the craft and an obstacle (m).  arrival: distance from the
    goal (m) and speed (m/s) at the end.  tempo: speed and accelerations of the route.  law: control law of the
    simulated flight.
    """

    times: Any
    places: Any
    headings: Any
    flown: dict[str, Any]
    route: Route
    clearance: float
    arrival: tuple[float, float]
    tempo: Tempo
    law: RecedingHorizon

    @property
    def length(self) -> float:
        """Return the length of the planned path of the centre of percussion P (m)."""
        return float(np.hypot(*np.diff(self.places, axis=0).T).sum())

    def path(self) -> PiecewisePath:
        """Return the plan as a reference path for a law."""
        return interpolate_path(self.times, self.places, self.headings)

    def table(self) -> str:
        """Return the plan as the text of a CSV file that can be used as ``--reference``."""
        rows = [",".join(("time [s]", "north [m]", "east [m]", "heading [deg]"))]
        for t, (north, east), heading in zip(self.times, self.places, self.headings, strict=True):
            rows.append(f"{t:.3f},{north:.5f},{east:.5f},{np.degrees(heading):.4f}")
        return "\n".join(rows) + "\n"


def plan_path(task: PlanTask, tempo: Tempo | None = None, part: str = "plan") -> FlownPlan:
    """Return a flyable plan that begins at rest at the start and ends near the goal, almost at rest (`ARRIVED`).

    Args:
        task: floor with obstacles, start, goal, and radius of the circle around the craft.
        tempo: desired speed and accelerations of the route.
        part: name of the caller, for error messages.

    Raises:
        InputError: no gap between obstacles is wide enough, or the craft cannot fly the route without a collision
            within its limits of thrust and rudder.
    """
    tempo = tempo or Tempo()
    problem = ""
    for speed, acceleration in TEMPOS:
        tried = Tempo(tempo.speed * speed, tempo.along * acceleration, tempo.across * acceleration)
        route = find_route(task, tried, part)
        flown = _fly(task, route)
        problem = problem or _find_problem(task, flown)
        if not _find_problem(task, flown):
            return _sample(task, route, flown, tried)
    problem += f"; {len(TEMPOS) - 1} other tempos (speed and accelerations) fail too"
    raise InputError(part, problem, fix="move the obstacles apart there, or plan for a craft of smaller radius")


def _fly(task: PlanTask, route: Route) -> dict[str, Any]:
    """Return the simulated flight along a route, sampled every 20 ms."""
    ends = np.linspace(route.times[0], route.times[-1], PIECES - 3)
    way = np.column_stack([np.interp(ends, route.times, route.places[:, k]) for k in range(2)])
    reference = interpolate_path(ends, way, rests=True)
    law, arm = replace(LAW, reference=reference), float(Hovercraft().percussion_arm)
    soon = route.places[min(8, len(route.places) - 1)] - route.places[0]
    heading = float(np.arctan2(soon[1], soon[0])) if task.heading is None else task.heading
    north, east = np.asarray(task.start) - arm * np.array([np.cos(heading), np.sin(heading)])
    still = DirectActuation(period=TICK)
    scenario = Scenario(
        world=World(
            vehicle=Hovercraft(),
            sensors={"truth": PlanarPose(period=TICK)},
            downlink=Wire(period=TICK),
            uplink=Wire(period=TICK),
            actuators=still,
        ),
        autopilot=Autopilot(estimator=Passthrough("truth"), law=law, allocation=DirectAllocation(), period=TICK),
        initial=HovercraftState(north=float(north), east=float(east), heading=heading),
        duration=TICK * round((route.times[-1] + SETTLE) / 0.02),
        name="plan",
    )
    log = simulate(scenario, log_period=TICK, signals=("truth", "law"))
    names = {n: f"truth.{n}" for n in ("north", "east", "heading", "surge_velocity", "sway_velocity", "yaw_rate")}
    names |= {"thrust": "law.thrust", "force_angle": "law.force_angle"}
    flown = {"time": log.t} | {n: np.asarray(log[path]) for n, path in names.items()}
    places = np.column_stack([flown["north"], flown["east"]])
    flown["clearance"] = task.floor.clearance(places) - task.radius
    return flown


def _find_problem(task: PlanTask, flown: dict[str, Any]) -> str:
    """Return the reason why a simulated flight is not a valid plan, or "" if it is valid."""
    places = np.column_stack([flown["north"], flown["east"]])
    between = np.hypot(*np.diff(places, axis=0).T).max() / 2
    worst = int(np.argmin(flown["clearance"]))
    left = float(flown["clearance"][worst]) - between
    if left < KEEP:
        north, east = places[worst]
        comes = "touches an obstacle" if left < 0 else f"comes within {100 * left:.0f} cm of an obstacle"
        return f"flown within its limits, the craft {comes} at {north:.2f} {east:.2f}, {flown['time'][worst]:.1f} s"
    away, speed = _arrival(task, flown)
    if away > ARRIVED[0] or speed > ARRIVED[1]:
        return f"flown within its limits, the craft ends {away:.2f} m from the goal, at {speed:.2f} m/s"
    return ""


def _arrival(task: PlanTask, flown: dict[str, Any]) -> tuple[float, float]:
    """Return the distance from the goal (m) and the speed (m/s) at the end of a simulated flight."""
    away = np.hypot(*(_percussion_points(flown)[-1] - np.asarray(task.goal)))
    return float(away), float(np.hypot(flown["surge_velocity"][-1], flown["sway_velocity"][-1]))


def _percussion_points(flown: dict[str, Any]) -> Any:
    """Return the positions of the centre of percussion P (n, 2) in the world frame W (m)."""
    arm, heading = float(Hovercraft().percussion_arm), flown["heading"]
    return np.column_stack([flown["north"] + arm * np.cos(heading), flown["east"] + arm * np.sin(heading)])


def _sample(task: PlanTask, route: Route, flown: dict[str, Any], tempo: Tempo) -> FlownPlan:
    each = round(SAMPLE / 0.02)
    rows = slice(0, None, each)
    least = float(flown["clearance"].min())
    points = _percussion_points(flown)
    times, headings = flown["time"][rows], flown["heading"][rows]
    return FlownPlan(times, points[rows], headings, flown, route, least, _arrival(task, flown), tempo, LAW)

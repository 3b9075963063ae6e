"""First message from a console's server to a page (hello): signals of a row, data to draw the vehicle, possible
requests, and parameters.

Source: docs page, Protocol of the console.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.console.flight_numbers import ESTIMATE, FlightNumbers
from trimtab.core.interfaces import optional_member
from trimtab.core.quantity import Quantity
from trimtab.core.record import leaves
from trimtab.core.time import to_seconds
from trimtab.flight.autopilot import LiveAutopilot
from trimtab.flight.console_line import ConsoleLine
from trimtab.flight.console_packets import ROW_PERIOD
from trimtab.flight.flight_log import FlightRows
from trimtab.flight.flight_signals import FLIGHT_SIGNALS
from trimtab.flight.silence import SILENCE
from trimtab.flight.stick import CompiledStick
from trimtab.logs.spatial import ANGLES, FLIGHT, referenced_signal
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor_modes import CAUSES, MODES, REQUESTS

TRUTH = "truth."
STALE_AGE = 0.4
"""Maximum age (s) of a sample in a flight without a supervisor, equal to the default of a supervisor."""
SPEEDS = ("ground_speed", "climb", "air_speed")
LENGTH = 0.6
"""Default length (m) of the vehicle in a drawing."""


def describe_flight(autopilot: LiveAutopilot, line: ConsoleLine) -> dict[str, Any]:
    """Set the signals that are sent to the page, and return the description of a live flight."""
    scenario, step = autopilot.scenario, autopilot.autopilot_end.step
    rows = FlightRows(autopilot.autopilot_end.log_sources(), FLIGHT_SIGNALS)
    signals = [describe_signal(s.path, s.declared) for s in line.set_rows(rows)]
    signals += [describe_signal(path, d) for path, d in FlightNumbers(signals).declared.items()]
    paths = [s["path"] for s in signals]
    supervisor = scenario.autopilot.supervisor
    return {
        "kind": "flight",
        "title": scenario.name,
        "calibration": shorten_hash(scenario.choices),
        "signals": signals,
        "row_period": to_seconds(ROW_PERIOD),
        "view": describe_view(paths, scenario),
        "set_points": list_set_points(scenario, paths),
        "parameters": autopilot.parameters.describe(),
        "supervisor": None if supervisor is None else _describe_supervisor(),
        "pilot": _describe_pilot(scenario, CompiledStick(scenario, step), signals),
        "ages": _list_ages(scenario, paths),
    }


def shorten_hash(choices: Any) -> str:
    """Return the short hash of a scenario's calibration, or "" if the scenario has no calibration."""
    used = choices.get("calibration") if choices else None
    return "" if used is None else str(used["sha256"])[:8]


def describe_signal(path: str, declared: Quantity | None) -> dict[str, Any]:
    """Return the description of a signal for the page: path, unit, meaning, kind, names of modes, and coordinate
    frame."""
    if declared is None:
        return {"path": path, "unit": "", "meaning": "", "kind": "real", "modes": None, "frame": ""}
    named = {"path": path, "unit": declared.unit, "meaning": declared.doc, "kind": declared.kind}
    return named | {"modes": list(declared.modes) or None, "frame": declared.frame}


def describe_view(paths: Sequence[str], scenario: Scenario | None) -> dict[str, Any]:
    """Return the data from which the page draws the vehicle: artificial horizon, view from above, view from the side,
    or no drawing."""
    known = set(paths)

    def pick(prefix: str, names: Mapping[str, str]) -> dict[str, str] | None:
        found = {name: prefix + own for name, own in names.items()}
        return found if known.issuperset(found.values()) else None

    attitude = {name: p if (p := FLIGHT + name) in known else None for name in ANGLES}
    if attitude["roll"] and attitude["pitch"]:
        numbers = {name: p if (p := FLIGHT + name) in known else None for name in ("altitude", *SPEEDS)}
        place = pick(FLIGHT, {"north": "north", "east": "east"})
        return {
            "kind": "spatial",
            "attitude": attitude,
            **numbers,
            "plan": None if place is None else _describe_plan(place | {"heading": attitude["yaw"]}, scenario),
        }
    position, bend = {"north": "north", "east": "east"}, {"eta1": "eta1", "eta2": "eta2"}
    side = {"altitude": "h", "speed": "V", "alpha": "alpha"}
    velocity = pick(ESTIMATE, {"surge": "surge_velocity", "sway": "sway_velocity"})
    heading = pick(ESTIMATE, {"heading": "heading"}) or pick(TRUTH, {"heading": "heading"})
    if velocity is not None and heading is not None:
        place = pick(ESTIMATE, position) or pick(TRUTH, position) or {"north": None, "east": None}
        more = {
            "velocity": velocity,
            "truth": pick(TRUTH, position | {"heading": "heading"}),
            "covariance": pick(ESTIMATE, {"nn": "sigma_north", "ee": "sigma_east"}),
        }
        return {"kind": "planar", **_describe_plan(place | heading, scenario), **more}
    for prefix, angle in ((TRUTH, {"theta": "theta"}), (ESTIMATE, {"theta": "theta"}), (ESTIMATE, {"climb": "h_rate"})):
        seen = pick(prefix, side | angle)
        if seen is not None:
            bent, felt = pick(TRUTH, bend), pick(ESTIMATE, bend)
            attitude = {name: seen.pop(name) for name in ("alpha", *angle)}
            modes = {"modes": bent or felt, "estimated": felt if bent else None}
            return {"kind": "longitudinal", **seen, "attitude": attitude, **modes}
    return {"kind": "plain"}


def _describe_plan(pose: Mapping[str, str | None], scenario: Scenario | None) -> dict[str, Any]:
    """Return the data of a view from above. pose: path of the signal for each element of the pose, by the element's
    name."""
    return {
        "pose": dict(pose),
        "velocity": None,
        "truth": None,
        "covariance": None,
        "beacons": [] if scenario is None else _list_beacons(scenario),
        "fence": None if scenario is None else _describe_fence(scenario),
        "length": LENGTH if scenario is None else 2 * float(getattr(scenario.world.vehicle, "arm", LENGTH / 2)),
    }


def _list_beacons(scenario: Scenario) -> list[list[float]]:
    """Return the position, north and east (m), of each beacon that a sensor uses."""
    found = [v for path, v, _ in leaves(scenario.world, "") if path.endswith("beacons.map")]
    return [] if not found else np.asarray(found[0], float)[:, :2].tolist()


def _describe_fence(scenario: Scenario) -> dict[str, list[float]] | None:
    supervisor = scenario.autopilot.supervisor
    limits = [] if supervisor is None else [x for x in supervisor.limits if x.kind == "geofence"]
    bounds = {x.fields[0]: [float(x.low), float(x.high)] for x in limits if len(x.fields) == 1}
    return bounds if {"north", "east"} <= set(bounds) else None


def list_set_points(scenario: Scenario, paths: Sequence[str]) -> dict[str, float | str]:
    """Return the set-point of each true or estimated signal that has one, by the signal's path. A set-point is the
    value of a target, or the path of a signal of the control law."""
    found: dict[str, float | str] = {}
    for target in scenario.targets:
        name = target.path.removeprefix(TRUTH)
        found |= {path: float(target.value) for path in (TRUTH + name, ESTIMATE + name) if path in paths}
    for path in paths:
        if name := referenced_signal(path):
            found |= {own: path for own in (TRUTH + name, ESTIMATE + name) if own in paths}
    return found


def _describe_supervisor() -> dict[str, Any]:
    paths = {"mode": "supervisor.mode", "cause": "supervisor.cause", "check": "supervisor.check"}
    return {**paths, "modes": MODES, "causes": CAUSES, "requests": REQUESTS[1:]}


def _describe_pilot(
    scenario: Scenario, stick: CompiledStick, signals: Sequence[Mapping[str, Any]]
) -> dict[str, Any] | None:
    if not stick.is_there:
        return None
    path = f"downlink.{optional_member(scenario.autopilot.law, 'stick')}.value.mode"
    return {
        "modes": next(s["modes"] for s in signals if s["path"] == path),
        "forward": {"meaning": "forward; back is negative"},
        "turn": {"meaning": "turn; to starboard is positive"},
    }


def _list_ages(scenario: Scenario, paths: Sequence[str]) -> list[dict[str, Any]]:
    """Return the signals that contain the age of data, each with label and limit for the page."""
    supervisor = scenario.autopilot.supervisor
    stale = STALE_AGE if supervisor is None else float(supervisor.stale_age)
    ages = [("estimate.age", "estimate", stale), ("link.silence", "link", to_seconds(SILENCE))]
    ages += [(f"downlink.{name}.age", name, stale) for name in scenario.autopilot.estimator.listens]
    law = scenario.autopilot.law
    stick = optional_member(law, "stick")
    if stick:
        ages.append((f"downlink.{stick}.age", "stick", float(law.stick_timeout)))
    return [{"path": path, "label": label, "limit": limit} for path, label, limit in ages if path in paths]

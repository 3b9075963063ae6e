"""`trimtab trim`: find steady states of a vehicle."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import click

from trimtab.commands.options import AT, JSON, OUT, SET, VEHICLE
from trimtab.commands.output import check_out, new_table, print_files, print_json, print_table, write_text
from trimtab.design.coordinates import STANDS, unsmooth_outputs
from trimtab.design.trim import Trim
from trimtab.run.design_point import find_point, format_value
from trimtab.run.plant import Plant, load_plant

RESTS = 1e-9
"""Rate of change of a state (unit of the state per second) below which the state counts as constant."""


@click.command()
@VEHICLE
@AT
@SET
@OUT("FILE", "Write the trim point to this file (JSON).")
@JSON
def command(vehicle: str, at: tuple[str, ...], settings: dict[str, str], out: Path | None, as_json: bool) -> None:
    """Find the states and inputs of a steady motion.

    Examples are rest, level flight and a steady turn.

    VEHICLE is a scenario (its vehicle and initial state are used), a model of the package, or FILE.py:function. The
    function returns a Scenario, (vehicle, x, u) or a model. By default all inputs and states are free, positions and
    lengths are fixed, and all derivatives are zero, except those of positions and of states that nothing depends on.
    --at changes this. A vehicle with a quaternion has attitude.roll, .pitch, .yaw and velocities in body axes instead,
    and the outputs speed, angle_of_attack, sideslip and climb. If no trim was found, the reasons are printed, and the
    exit code is 1.

    \b
    trimtab trim hovercraft/forward --at surge_velocity=1 --at yaw_rate=0
    trimtab trim hypersonic --at h='90000 ft' --at V='8000 ft/s'
    trimtab trim hypersonic --at Phi=0.1..0.9 --at "V'=2"        bounds of an input; an accelerating speed
    trimtab trim my_jet.py:system --at speed='150 m/s' --at climb=0 --at attitude.roll='30 deg' --at sideslip=0
    """
    if out is not None:
        check_out("--out", out)
    plant = load_plant(vehicle, settings)
    point = find_point(plant, at)
    result = point_json(plant, point)
    files = [write_text(out, _as_text(result))] if out is not None and point.is_found else []
    if as_json:
        print_json(result, files)
    else:
        print_point(plant, point)
        print_files(files)
    sys.exit(0 if point.is_found else 1)


def point_json(plant: Plant, point: Trim) -> dict[str, Any]:
    """Return a trim as plain data for JSON, in SI units and radians, or in the units of the vehicle model."""
    model = plant.model
    rates, measured = model.evaluate(point.x, point.u)
    outputs = dict(zip(model.outputs, measured.tolist(), strict=True))
    return {
        "vehicle": plant.name,
        "is_found": point.is_found,
        "states": dict(zip(model.states, point.x.tolist(), strict=True)),
        "inputs": dict(zip(model.inputs, point.u.tolist(), strict=True)),
        "outputs": outputs,
        "rates": dict(zip(model.states, rates.tolist(), strict=True)),
        "undetermined": list(point.undetermined_unknowns),
        "at_bound": dict(point.active),
        "taken": dict(point.taken),
        "why": list(point.why),
    }


def print_point(plant: Plant, point: Trim) -> None:
    """Print a table of states, inputs and other outputs. If no trim was found, print the reasons."""
    model = plant.model
    rates, measured = model.evaluate(point.x, point.u)
    click.echo(f"{plant.name}: {'trim' if point.is_found else 'NO trim'}")
    table = new_table("", ">value", ">rate")
    for name, value, rate in zip(model.states, point.x, rates.tolist(), strict=True):
        moving = abs(rate) > 1e-9 * max(1.0, abs(float(value)))
        table.add_row(name, format_value(plant, name, float(value)), _rate_text(plant, name, rate) if moving else "0")
    table.add_section()
    for name, value in zip(model.inputs, point.u, strict=True):
        table.add_row(name, format_value(plant, name, float(value)), "")
    more = [n for n in model.outputs if n not in model.states]
    lacking = unsmooth_outputs(model._replace(x0=point.x, u0=point.u))
    values = dict(zip(model.outputs, measured.tolist(), strict=True))
    if more:
        table.add_section()
    for name in more:
        is_direction = name in lacking and name != "speed" and values.get("speed", 1.0) < STANDS
        table.add_row(name, "-" if is_direction else format_value(plant, name, values[name]), "")
    print_table(table)
    if point.is_found:
        click.echo(_motion_text(plant, point, rates))
    if point.taken:
        click.echo(_level_text(plant, point))
    for combination in point.undetermined_unknowns if point.is_found else ():
        click.echo(f"the trim is not unique: {combination} may change; fix one of these variables with --at NAME=VALUE")
    for name, side in point.active.items() if point.is_found else ():
        click.echo(f"at a bound: {name}, {side}")
    for reason in point.why:
        click.echo(f"  {reason}")


def _motion_text(plant: Plant, point: Trim, rates: Any) -> str:
    """Describe the motion at a trim, and how to request another motion."""
    moving = [(n, r) for n, r in zip(plant.model.states, rates.tolist(), strict=True) if abs(r) > RESTS]
    if not moving:  # a vehicle without a position moves if its velocities are not zero
        velocities = [n for n in plant.model.states if plant.units.get(n) == "m/s" or n.endswith("_rate")]
        at = dict(zip(plant.model.states, point.x.tolist(), strict=True))
        goes = [f"{n} {format_value(plant, n, at[n])}" for n in velocities if abs(at[n]) > RESTS]
        return f"in steady motion at {', '.join(goes)}" if goes else "at rest"
    text = ", ".join(f"{n} changes by {_rate_text(plant, n, r)}" for n, r in moving)
    name, rate = max(moving, key=lambda pair: abs(pair[1]))
    return f'in steady motion: {text}; request another motion with --at, e.g. --at "{name}\'={0.5 * rate:.2g}"'


def _level_text(plant: Plant, point: Trim) -> str:
    """Describe the assumed conditions of level flight, and how to change these conditions."""
    taken = {n: format_value(plant, n, v) for n, v in point.taken.items()}
    name = next((n for n, v in point.taken.items() if v), next(iter(taken)))
    text = ", ".join(f"{n} {v}" for n, v in taken.items())
    other = f"change it with --at, e.g. --at {name}='{taken[name]}' or --at {name}=free"
    return f"assumed, because the vehicle has no equilibrium at rest: {text}; {other}"


def _rate_text(plant: Plant, name: str, rate: float) -> str:
    unit = plant.units.get(name, "")
    if unit.startswith("rad"):
        return f"{math.degrees(rate):.6g} {unit.replace('rad', 'deg')}/s"
    return f"{rate:.6g} {unit}/s" if unit not in ("", "1") else f"{rate:.6g} 1/s"


def _as_text(result: dict[str, Any]) -> str:
    return json.dumps(result, indent=1) + "\n"

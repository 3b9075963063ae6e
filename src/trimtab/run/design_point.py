"""Operating points of a vehicle that satisfy the conditions ``--at`` of `trimtab trim`, `linearise` and `zeros`."""

import math
import re
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.suggestions import closest
from trimtab.core.units import find_unit
from trimtab.design.coordinates import STANDS, unsmooth_outputs
from trimtab.design.linearise import LinearModel, linearise
from trimtab.design.model import StateSpaceModel
from trimtab.design.trim import Trim, idle_states, is_length, trim
from trimtab.run.plant import Plant

ZERO = 1e-12
"""Magnitude below which a state or input of a trim point is rounded to zero."""


class Conditions(NamedTuple):
    """Conditions of an operating point, by the names of states, inputs and outputs.

    fixed: state or input -> desired value.  free: states and inputs that are unknowns of the trim.  kept: states and
    inputs that keep their initial value.  loose: states whose derivative may have any value.  rates: state -> desired
    derivative.  outputs: output -> desired value.  bounds: unknown -> lower and upper bound.
    """

    fixed: dict[str, float]
    free: set[str]
    kept: set[str]
    loose: set[str]
    rates: dict[str, float]
    outputs: dict[str, float]
    bounds: dict[str, tuple[float, float]]


def parse_conditions(plant: Plant, words: tuple[str, ...]) -> Conditions:
    """Return the conditions that the user typed as ``--at NAME=VALUE``. words: the texts NAME=VALUE."""
    c = Conditions({}, set(), set(), set(), {}, {}, {})
    model = plant.model
    for word in words:
        left, equals, right = word.partition("=")
        if not equals or not right.strip():
            raise InputError(
                argument_name("at"), f"{word!r} is not NAME=VALUE", fix=argument("at", "free", model.inputs[0])
            )
        name, text = left.strip(), right.strip()
        is_rate, name = name.endswith("'"), name.removesuffix("'")
        name = name if name in model.inputs else re.sub(r"^(x|u|y)\.", "", name)
        known = model.states if is_rate else tuple(dict.fromkeys((*model.states, *model.inputs, *model.outputs)))
        if name not in known:
            near = closest(name, known, 1) or list(known)[:1]
            what = "unknown state" if is_rate else "unknown state, input or output"
            fix = argument("at", text, near[0] + "'" * is_rate)
            raise InputError(argument_name("at", left), what, choices=known, fix=fix)
        _add_condition(c, plant, name, text, is_rate)
    return c


def find_point(plant: Plant, words: tuple[str, ...]) -> Trim:
    """Return the trim for ``--at``: at rest if possible, else level and straight flight, else any steady motion.

    Inputs, and states other than positions, are unknowns unless ``--at`` sets a value. All derivatives are zero, except
    those of positions and of states on which no other state depends. If a trim exists for which these derivatives are
    zero too, this trim is returned. If the vehicle has no equilibrium at rest and several trims satisfy ``--at``, level
    flight at the initial speed is chosen. `Trim.taken` contains the conditions that were added for level flight.
    """
    c, model = parse_conditions(plant, words), plant.model
    idle = idle_states(model, plant.units) | plant.places
    carried = _carried_states(plant)
    _refuse_carried(plant, c, carried)
    both = [*model.states, *model.inputs]
    free = [
        n
        for n in both
        if n in c.free or not (n in c.fixed or n in c.kept or n in carried or n in _steady_states(plant, idle))
    ]
    loose = [n for n in model.states if n in c.loose or (n in idle and n not in c.rates)]
    x = {n: v for n, v in c.fixed.items() if n in model.states}
    u = {n: v for n, v in c.fixed.items() if n in model.inputs}
    wanted: dict[str, Any] = {"derivatives": c.rates, "outputs": c.outputs, "bounds": c.bounds}
    rest, straight = _still_states(plant, c, loose)
    x |= {n: 0.0 for n in carried if rest and plant.units.get(n) == "m/s"}
    moving: Trim | None = None
    level = trim if carried else partial(_find_level, plant, c)
    for held, search in ((rest, trim), (straight, level), (straight, trim)):
        away = [n for n in loose if n not in held]
        still = search(model, free=free, x=x, u=u, loose=away, starts=2, **wanted) if held or search != trim else None
        if still is not None and still.is_found:
            if held is not rest or not _is_moving(plant, still):
                return still
            moving = still  # the state is constant, but the vehicle moves, because its state contains no position
    if moving is not None:
        return moving
    u = _holding_inputs(model, x, u, c, free) | u
    return trim(model, free=free, x=x, u=u, loose=loose, **wanted)


def _carried_states(plant: Plant) -> list[str]:
    """Return the velocity and angle states that only record the motion of a body that is moved along a given path.

    No other state depends on these states, so they are never unknowns of a trim. The list is empty if the vehicle's
    position depends on one of its velocities. Recorded velocities are zero if the body is at rest.
    """
    model = plant.model
    speeds = {n for n in model.states if plant.units.get(n) == "m/s"}
    if not speeds or not any(is_length(plant.units.get(n, "")) for n in plant.places):
        return []
    around = np.random.default_rng(0).uniform(-0.1, 0.1, (2, len(model.x0)))
    moves = np.any([model.slopes(model.x0 + shift, model.u0)[0] != 0 for shift in around], axis=0)
    own = np.array([n in speeds or (plant.units.get(n) == "rad" and n not in plant.places) for n in model.states])
    while (active := own & moves[~own].any(axis=0)).any():
        own &= ~active
    carried = [n for n, is_own in zip(model.states, own, strict=True) if is_own]
    return carried if speeds <= set(carried) else []


def _refuse_carried(plant: Plant, c: Conditions, carried: list[str]) -> None:
    """Raise InputError if ``--at`` sets a state that only records the motion, or an output of such a vehicle.

    carried: states that only record the motion.
    """
    model = plant.model
    said = {*c.fixed, *c.free, *c.kept, *c.rates, *c.outputs}
    asked = [n for n in (*carried, *model.outputs) if n in said and (n in carried or n not in model.states)]
    if carried and asked:
        causes = [n for n in (*model.states, *model.inputs) if n not in carried and n not in plant.places]
        near = next((n for n in causes if plant.units.get(n) in ("m/s", "rad/s")), causes[0])
        problem = "cannot be set, because it only records the motion: no other state of this vehicle depends on it"
        fix = argument("at", "VALUE", near)
        raise InputError(argument_name("at", asked[0]), problem, choices=causes, fix=fix)


def _is_moving(plant: Plant, point: Trim) -> bool:
    """Return True if the vehicle's speed at the trim is not zero."""
    y = dict(zip(plant.model.outputs, plant.model.evaluate(point.x, point.u)[1].tolist(), strict=True))
    y |= dict(zip(plant.model.states, point.x.tolist(), strict=True))
    return bool(y.get(plant.flight().get("speed", ""), 0.0) > STANDS)


def _still_states(plant: Plant, c: Conditions, loose: list[str]) -> tuple[set[str], set[str]]:
    """Return two sets of states: those in `loose` that are constant at rest, and those constant in straight flight.

    The first set is empty if the conditions require a motion. The second set is empty if they require a rate.
    """
    stay = {n for n in loose if n not in c.loose}
    moves = any(v and plant.units.get(n) in ("m/s", "rad/s") for n, v in c.fixed.items() if n in plant.model.states)
    turns = {n for n in stay if plant.units.get(n) == "rad" and n not in plant.places}
    rest = set() if moves or any(c.rates.values()) or any(c.outputs.values()) else stay
    return rest, set() if any(c.rates.values()) else turns


def _find_level(plant: Plant, c: Conditions, model: StateSpaceModel, **wanted: Any) -> Trim | None:
    """Return the trim of level flight at the initial speed and heading, or None if no such trim is found.

    Conditions of ``--at`` have priority. If level flight without roll is impossible, a roll angle is allowed, then also
    sideslip, then also climb. A torpedo, for example, rolls because of the torque of its propeller.
    """
    names = plant.flight()
    level = _level_conditions(plant, c, names)
    if any(c.rates.values()):  # the search for a turn starts from the straight flight
        straight = _find_level(plant, c._replace(rates={}), model, **wanted | {"derivatives": {}})
        if straight is not None:
            x, u = (dict(zip(n, v, strict=True)) for n, v in ((model.states, straight.x), (model.inputs, straight.u)))
            wanted |= {"x": x | wanted["x"], "u": u | wanted["u"]}
    loose = [n for n in wanted["loose"] if n in c.loose or n != names.get("height")]
    while level:
        fixed = {n: v for n, v in level.items() if n in model.states}
        asked = {n: v for n, v in level.items() if n not in fixed}
        own: dict[str, Any] = {"x": wanted["x"] | fixed, "outputs": wanted["outputs"] | asked, "loose": loose}
        own["free"] = [n for n in wanted["free"] if n not in fixed]
        found = trim(model, **(wanted | own))
        if found.is_found:
            return found._replace(taken=level)
        level.popitem()
    return None


def _level_conditions(plant: Plant, c: Conditions, names: Mapping[str, str]) -> dict[str, float]:
    """Return the conditions of level flight at the initial speed: state or output -> value.

    A state or output that ``--at`` sets is left out. Return {} if the initial state is at rest.
    """
    model = plant.model
    known = dict(zip(model.outputs, model.evaluate(model.x0, model.u0)[1].tolist(), strict=True))
    known |= dict(zip(model.states, np.asarray(model.x0).tolist(), strict=True))
    speed = names.get("speed")
    if speed is None or not known[speed] > STANDS:
        return {}
    said = {*c.fixed, *c.free, *c.kept, *c.outputs}
    own = {n for n in said if plant.units.get(n) == "m/s" and n != speed}
    order = (*(() if own else ("speed",)), "yaw", *(() if own else ("climb", "sideslip")))
    order = order if any(c.rates.values()) else (*order, "roll")
    values = {"yaw": known.get(names.get("yaw", ""), 0.0), "speed": known[speed]}
    return {names[n]: values.get(n, 0.0) for n in order if n in names and names[n] not in said}


def _holding_inputs(model: StateSpaceModel, x: Any, u: Any, c: Conditions, free: list[str]) -> dict[str, float]:
    """Return an initial guess of the free inputs: the inputs that best keep the initial state constant, to first order.

    From an initial guess of zero, e.g. stopped rotors, the search could find a steady fall.
    """
    x0, u0 = model.point(x, u)
    slope = model.slopes(x0, u0)[1]
    own = [i for i, n in enumerate(model.inputs) if n in free]
    step = np.linalg.lstsq(slope[:, own], -model.evaluate(x0, u0)[0], rcond=None)[0]
    held = {model.inputs[i]: float(u0[i] + v) for i, v in zip(own, step, strict=True)}
    inside = dict.fromkeys(held, (-np.inf, np.inf)) | {n: b for n, b in c.bounds.items() if n in held}
    return {n: float(np.clip(v, *inside[n])) for n, v in held.items() if np.isfinite(v)}


def linearise_at(plant: Plant, point: Trim) -> LinearModel:
    """Return the linear model of the vehicle's deviations from a trim point."""
    return linearise(smooth_model(plant, point))


def smooth_model(plant: Plant, point: Trim, outputs: tuple[str, ...] = ()) -> StateSpaceModel:
    """Return the model of the vehicle's deviations from a trim point, without outputs that are not differentiable
    there.

    outputs: outputs that the caller needs. Raise InputError if one of these is not differentiable.
    """
    model = plant.error(*(np.where(np.abs(v) < ZERO, 0.0, v) for v in (point.x, point.u)))
    lacking = unsmooth_outputs(model)
    asked = [n for n in outputs if n in lacking]
    if asked:
        near = [n for n in model.outputs if n not in lacking]
        leave, choose = argument("outputs", [asked[0]]), argument("at", "VALUE", asked[0])
        fix = f"leave {leave} out, or choose another trim point:  {choose}"
        raise InputError(
            argument_name("outputs", asked[0]),
            f"is not differentiable, because {lacking[asked[0]]}",
            choices=near,
            fix=fix,
        )
    return model.keep(outputs=[n for n in model.outputs if n not in lacking]) if lacking else model


def format_value(plant: Plant, name: str, value: float) -> str:
    """Return the text of a state's, input's or output's value with its unit. Angles are in degrees."""
    unit = plant.units.get(name, "")
    value = 0.0 if abs(value) < 1e-12 else value
    if unit in ("rad", "rad/s"):
        return f"{math.degrees(value):.6g} {unit.replace('rad', 'deg')}"
    return f"{value:.6g} {unit}" if unit not in ("", "1") else f"{value:.6g}"


def _steady_states(plant: Plant, idle: set[str]) -> set[str]:
    """Return the states that keep their initial value unless ``--at`` makes them free: idle states and positions."""
    lengths = {n for n in plant.model.states if is_length(plant.units.get(n, ""))}
    return idle | lengths


def _add_condition(c: Conditions, plant: Plant, name: str, text: str, is_rate: bool) -> None:
    model = plant.model
    if is_rate:
        if text == "any":
            c.loose.add(name)
        else:
            c.rates[name] = parse_amount(plant, argument_name("at", f"{name}'"), text, name, per_second=True)
        return
    is_unknown = name in model.states or name in model.inputs
    if text in ("free", "fixed"):
        if not is_unknown:
            fix = argument("at", "NUMBER", name)
            raise InputError(
                argument_name("at", name), "is an output, and only states and inputs can be free or fixed", fix=fix
            )
        (c.free if text == "free" else c.kept).add(name)
    elif ".." in text:
        low, high = (parse_amount(plant, argument_name("at", name), part, name) for part in text.split("..", 1))
        c.free.add(name)
        c.bounds[name] = (low, high)
    elif is_unknown:
        c.fixed[name] = parse_amount(plant, argument_name("at", name), text, name)
    else:
        c.outputs[name] = parse_amount(plant, argument_name("at", name), text, name)


def parse_amount(plant: Plant, part: str, text: str, name: str, *, per_second: bool = False) -> float:
    """Return the value of a state, input or output, or of a rate, from a text, in the unit that the vehicle uses.

    A number without a unit is assumed to be in the vehicle's unit.
    part: name of the argument in error messages.  per_second: True for the rate of the quantity.
    """
    match = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?", text)
    if match is None:
        fix = f"{part}=NUMBER, with or without a unit, or free, fixed, LOW..HIGH"
        raise InputError(part, f"{text!r} is not a number", fix=fix)
    number, unit, own = float(match[1]), match[2], plant.units.get(name, "1")
    if unit is None:
        return number
    own = {"rad": "rad/s", "m": "m/s", "m/s": "m/s^2", "rad/s": "rad/s^2"}.get(own, own) if per_second else own
    there, here = find_unit(part, unit), find_unit(part, own) if own != "1" else find_unit(part, "")
    if there.name != here.name:
        raise InputError(part, f"{unit!r} does not fit a quantity in {own}", fix=f"{part}='{number:g} {own}'")
    return number * there.scale / here.scale

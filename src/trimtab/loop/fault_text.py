"""Faults written as text, e.g. ``sensor:imu off @ 3 s for 1 s``: parsing, and injection into a scenario.

    WHERE WORD [by NUMBER] [bias NUMBER] [@ TIME] [for TIME] [when PATH above NUMBER | when PATH below NUMBER]

WHERE is the faulty part: ``sensor:NAME``, ``uplink``, ``downlink``, ``actuators``, or ``actuators:FIELD`` for one field
or array element (``speed[1]``) of the vehicle's input. WORD is the kind of fault (docs page, Faults). NUMBER after
``by`` is the severity.
"""

import re
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.interfaces import optional_member
from trimtab.core.quantity import component_paths
from trimtab.core.record import is_record, leaves, replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.suggestions import closest
from trimtab.core.time import FOREVER, format_time, parse_time
from trimtab.loop.checks import check_part
from trimtab.loop.faults import DELAYED, KINDS, NONE, Fault, FaultyActuators, FaultyChannel, FaultySensor, delay_slots
from trimtab.loop.scenario import Scenario
from trimtab.loop.structure import zeros_like
from trimtab.loop.walk import start

SEVERITY = {"garbage": 10.0, "wrong": 0.5, "slow": 5.0, "delayed": 0.2, "intermittent": 0.5}
"""Default severity of each kind of fault."""
OF_ACTUATORS = {"garbage": 1.0, "wrong": -2.0}
"""Default severities of actuator faults that differ from SEVERITY. `garbage`: a random input with standard deviation 1.
`wrong`: an input of opposite sign."""
CLAUSES = ("by NUMBER", "bias NUMBER", "@ TIME", "for TIME", "when PATH above NUMBER", "when PATH below NUMBER")
EXAMPLE = "sensor:NAME off @ 3 s for 1 s"


def inject_faults(scenario: Scenario, texts: Iterable[str]) -> Scenario:
    """Return the scenario with the faults added.

    Raise InputError for an unknown part, an unknown kind of fault or an invalid number.
    """
    for text in texts:
        where, fault = parse_fault(scenario, text)
        scenario = _wrap_part(scenario, where, fault, float(fault.severity))
    return scenario


def check_fault_times(scenario: Scenario, texts: Iterable[str]) -> None:
    """Raise InputError for a fault that begins after the end of the flight.

    Call this for flights in virtual time only, because a real flight may last longer than the scenario's duration.
    """
    for text in texts:
        begin = int(parse_fault(scenario, text)[1].start)
        if begin >= scenario.duration:
            problem = (
                f"{text!r} begins at {format_time(begin)}, but the flight ends at {format_time(scenario.duration)}"
            )
            raise InputError(
                argument_name("faults"),
                problem,
                fix=f"choose an earlier time, or {argument('duration', format_time(2 * begin))}",
            )


def add_dormant_faults(scenario: Scenario, longest: float = 0.5) -> Scenario:
    """Return the scenario with an inactive fault in every part that can have one.

    The user activates a fault by changing its parameters during the run.

    Args:
        scenario: scenario without faults.
        longest: longest delay (s) to which a fault can be set during the run.
    """
    for where in fault_locations(scenario):
        scenario = _wrap_part(scenario, where, Fault(), longest)
    return scenario


def fault_locations(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the parts of a scenario that can have a fault: sensors, links and actuators.

    The actuators are included only if the vehicle has an input.
    """
    acting = ("actuators",) if jax.tree.leaves(scenario.world.actuators.neutral()) else ()
    return (*(f"sensor:{name}" for name in scenario.world.sensors), "downlink", "uplink", *acting)


def _input_fields(scenario: Scenario) -> list[str]:
    """Return the paths of the fields of the vehicle's input, and of the elements of its array fields.

    Return an empty list if the vehicle's input is not a record.
    """
    u = scenario.world.actuators.neutral().u
    fields = [(path, component_paths(path, np.shape(value))) for path, value, _ in leaves(u)] if is_record(u) else []
    return [p for path, numbers in fields for p in (path, *(n for n in numbers if n != path))]


def parse_fault(scenario: Scenario, text: str) -> tuple[str, Fault]:
    """Return the name of the faulty part and the fault that a text describes, e.g. ``uplink off @ 3 s for 1 s``."""
    about = f"fault {text!r}"
    first, *others = re.split(r"\s*(?:\b(by|bias|for|when)\b|(@))\s*", " ".join(text.split()))
    head = first.split()
    if len(head) != 2:
        problem = "a fault must begin with the name of a part and a kind of fault"
        raise InputError(about, problem, choices=fault_locations(scenario), fix=f"write e.g. '{EXAMPLE}'")
    places = (*fault_locations(scenario), *(f"actuators:{name}" for name in _input_fields(scenario)))
    where = _check_choice(about, "part", head[0], places)
    where, _, field = where.partition(":") if where.startswith("actuators:") else (where, "", "")
    kind = _check_choice(about, "kind of fault", head[1], KINDS[1:])
    defaults = SEVERITY | (OF_ACTUATORS if where == "actuators" else {})
    fields: dict[str, Any] = {"kind": KINDS.index(kind), "severity": defaults.get(kind, 1.0), "field": field}
    names = [others[i] or others[i + 1] for i in range(0, len(others), 3)]
    for name, said in zip(names, others[2::3], strict=True):
        if names.count(name) > 1:
            raise InputError(about, f"contains the clause {name!r} twice", fix="write this clause once")
        fields |= _parse_clause(about, name, said)
    fault = Fault(**fields)
    check_part(about, fault.check)
    if fault.watch:
        known = watchable_paths(scenario, where)
        if fault.watch not in known:
            near = closest(fault.watch, known, 1) or known[:1]
            problem = f"{where} has no signal {fault.watch!r}"
            raise InputError(about, problem, choices=known, fix=f"when {near[0]} {fault.side} {float(fault.level):g}")
    return where, fault


def watchable_paths(scenario: Scenario, where: str) -> list[str]:
    """Return the paths of the signals that can trigger a fault in the part `where`."""
    paths: list[str] = []
    for path, value, _ in leaves(_visible_signals(scenario, where)):
        paths += [f"{path}.{i}" for i in range(np.size(value))] if np.shape(value) else [path]
    return paths


def _parse_clause(about: str, name: str, text: str) -> dict[str, Any]:
    """Return the fields of a fault that one clause of the fault's text sets, e.g. "by 0.5"."""
    if name == "when":
        condition = re.fullmatch(r"(\S+) (above|below) (\S+)", text)
        if not condition:
            raise InputError(about, f"{text!r} is not a condition", choices=CLAUSES[-2:], fix=f"when {text} above 0")
        return {"watch": condition[1], "side": condition[2], "level": _parse_number(about, condition[3])}
    if name in ("by", "bias"):
        return {"severity" if name == "by" else "bias": _parse_number(about, text)}
    return {"start" if name == "@" else "duration": _parse_start_time(about, text)}


def _parse_number(about: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(about, f"{text!r} is not a number", choices=CLAUSES, fix="write e.g. by 0.5")
    return value


def _parse_start_time(about: str, text: str) -> int:
    try:
        value = parse_time(text)
    except InputError as error:
        raise InputError(about, error.problem, choices=CLAUSES, fix="write a time as in '@ 3 s for 200 ms'") from None
    if not 0 <= value < FOREVER:
        raise InputError(about, f"the time must not be negative, got {text!r}", fix="write a time of at least 0 s")
    return value


def _check_choice(about: str, what: str, name: str, choices: tuple[str, ...]) -> str:
    if name not in choices:
        near = closest(name, choices, 1) or [f"sensor:{name}" if f"sensor:{name}" in choices else choices[0]]
        raise InputError(about, f"unknown {what} {name!r}", choices=choices, fix=f"write {near[0]!r}")
    return name


def _wrap_part(scenario: Scenario, where: str, fault: Fault, longest: float) -> Scenario:
    """Return the scenario with a fault added to the part `where`.

    longest: longest delay (s) for which the faulty part must be able to store samples.
    """
    world, (kind, _, name) = scenario.world, where.partition(":")
    inner = world.sensors[name] if name else getattr(world, kind)
    capacity = max(2, delay_slots(longest, inner.period)) if int(fault.kind) in (NONE, DELAYED) else 2
    if name:
        felt = None if optional_member(inner, "FEELS") == "motion" else _visible_signals(scenario, where)
        sensor = FaultySensor(inner=inner, fault=fault, example=felt, capacity=capacity)
        return replace(scenario, world=replace(world, sensors={**world.sensors, name: sensor}))
    make = FaultyActuators if kind == "actuators" else FaultyChannel
    return replace(scenario, world=replace(world, **{kind: make(inner=inner, fault=fault, capacity=capacity)}))


def _visible_signals(scenario: Scenario, where: str) -> Any:
    """Return the record of the signals that can trigger a fault in the part `where`. All values in the record are 0."""
    world, (kind, _, name) = scenario.world, where.partition(":")
    if name:
        feels = optional_member(world.sensors[name], "FEELS")
        x, u = scenario.initial, world.actuators.neutral().u
        if feels in ("state", "input"):
            return zeros_like(x if feels == "state" else u)
        return zeros_like(jax.eval_shape(world.vehicle.motion, np.int64(0), x, u))
    s, _ = start(to_arrays(world), to_arrays(scenario.autopilot), to_arrays(scenario.initial), key(0))
    return zeros_like(next(iter(s.received.values())) if kind == "downlink" else s.commanded)

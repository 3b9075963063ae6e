"""Faults with ranges, and piecewise constant inputs, as coordinates of a search. One compiled program flies all values.

    --fault-range 'downlink off @ 2..10 s for 0.1..2 s'     each LOW..HIGH of a fault's text is a coordinate
    --vary 'stick.turn=pieces(5, -1:1)'                    an input is constant in each of 5 equal pieces of the run

A fault is written as for ``--fault``, with LOW..HIGH in place of a number. A unit follows both limits, or only HIGH. A
pilot's stick follows a script of entries, each with a time (`loop.stick_script`). One entry for each piece replaces the
script's entries. Stick fields that do not vary keep the value that the script has at the beginning of the piece.

Source: docs page, Falsify. Pieces: control points of Annapureddy et al., "S-TaLiRo", TACAS 2011, held constant rather
than interpolated.
"""

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import declarations, leaves, replace
from trimtab.core.time import format_time
from trimtab.loop.fault_text import parse_fault
from trimtab.loop.faults import FaultyPart
from trimtab.loop.scenario import Scenario
from trimtab.loop.stick_script import StickScript

NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_RANGE = re.compile(
    rf"(?P<low>{NUMBER})\s*(?P<unit>[a-zµ]+)?\s*\.\.\s*(?P<high>{NUMBER})(?:\s*(?P<last>s|ms|us|µs|ns)\b)?"
)
_PIECES = re.compile(
    r"(?P<sensor>\w+)\.(?P<field>\w+)\s*=\s*"
    rf"pieces\(\s*(?P<count>\d+)\s*,\s*(?P<low>{NUMBER})\s*:\s*(?P<high>{NUMBER})\s*\)"
)
FAULT_EXAMPLE = "downlink off @ 2..10 s for 0.1..2 s"
VARY_EXAMPLE = "stick.turn=pieces(5, -1:1)"
MOST_PIECES = 100
FIELDS = ("forward", "turn")


class FaultRange(NamedTuple):
    """Fault with ranges. text: text of the fault with the upper end of each range, which determines the program's size.

    where: part of the loop that fails.  ranges: field of the fault -> minimum and maximum, in the field's unit (times:
    100 ns).
    """

    text: str
    where: str
    ranges: dict[str, tuple[float, float]]


def parse_fault_range(scenario: Scenario, text: str) -> FaultRange:
    """Read a fault with ranges. Raise InputError if an end of a range is not valid in this scenario."""
    part, example = argument_name("fault_ranges", text), argument("fault_ranges", [FAULT_EXAMPLE])
    if not _RANGE.search(text):
        raise InputError(
            part, "has no range LOW..HIGH", fix=f"{example}; or {argument_name('faults')}, for a fault without ranges"
        )
    low, high = (_RANGE.sub(lambda match, end=end: _end_text(match, end), text) for end in ("low", "high"))
    where, least = parse_fault(scenario, low)
    _, greatest = parse_fault(scenario, high)
    ranges = {}
    for (field, a, _), (_, b, _) in zip(leaves(least), leaves(greatest), strict=True):
        if not isinstance(a, str) and a != b:
            if a > b:
                raise InputError(
                    part, f"{field}: the first number of the range must be below the second", fix="swap them"
                )
            ranges[field] = (float(a), float(b))
    if not ranges:
        raise InputError(part, "the lower and the upper end of each range are equal", fix=example)
    return FaultRange(high, where, ranges)


def _end_text(match: re.Match[str], end: str) -> str:
    unit = (match["unit"] or match["last"]) if end == "low" else match["last"]
    return match[end] + (f" {unit}" if unit else "")


def fault_spread(standing: Iterable[str], scenario: Scenario, texts: Iterable[str]) -> tuple[list[str], dict[str, str]]:
    """Return all faults of a search as texts, and the spread of the faults with ranges.

    Args:
        standing: texts of the faults without ranges.
        scenario: scenario without any of these faults.
        texts: texts of the faults with ranges.
    """
    faults, standing = [parse_fault_range(scenario, text) for text in texts], list(standing)
    places = [parse_fault(scenario, text)[0] for text in standing] + [f.where for f in faults]
    first, spread = len(places) - len(faults), dict[str, str]()
    for i, fault in enumerate(faults):
        kind, _, name = fault.where.partition(":")
        around = places[first + i + 1 :].count(fault.where)  # later faults wrap earlier ones
        path = f"world.{'sensors.' + name if name else kind}{'.inner' * around}.fault"
        spread |= {f"{path}.{field}": f"uniform({a!r}, {b!r})" for field, (a, b) in fault.ranges.items()}
    return [*standing, *(f.text for f in faults)], spread


class HeldInput(NamedTuple):
    """Input that is constant in equal pieces of a run. sensor, field: name of the stick, and name of its varied field.

    number: number of pieces.  low, high: bounds of the field's value in each piece.
    """

    sensor: str
    field: str
    number: int
    low: float
    high: float


def parse_pieces(text: str) -> HeldInput:
    """Read a varied input, ``SENSOR.FIELD=pieces(COUNT, LOW:HIGH)``."""
    match = _PIECES.fullmatch(text.strip())
    if match is None:
        raise InputError(
            argument_name("vary", text),
            "must be SENSOR.FIELD=pieces(COUNT, LOW:HIGH)",
            fix=argument("vary", [VARY_EXAMPLE]),
        )
    pieces = HeldInput(match["sensor"], match["field"], int(match["count"]), float(match["low"]), float(match["high"]))
    if not 1 <= pieces.number <= MOST_PIECES:
        problem = f"the number of pieces must be from 1 to {MOST_PIECES}, got {pieces.number}"
        raise InputError(argument_name("vary", text), problem, fix=argument("vary", [VARY_EXAMPLE]))
    return pieces


def with_pieces(scenario: Scenario, texts: Iterable[str]) -> Scenario:
    """Return the scenario with a stick's script that has one entry for each piece.

    Each entry contains the values of the old script at the beginning of the piece.
    """
    counts: dict[str, int] = {}
    for text in texts:
        pieces, part = parse_pieces(text), argument_name("vary", text)
        script = _find_script(scenario, pieces.sensor, part)[0]
        if pieces.field not in FIELDS:
            raise InputError(
                part, f"a stick has no field {pieces.field!r}", choices=FIELDS, fix=argument("vary", [VARY_EXAMPLE])
            )
        bounds: Any = declarations(script)[pieces.field]
        if not bounds.low <= pieces.low < pieces.high <= bounds.high:
            problem = f"the range {pieces.low:g}:{pieces.high:g} must rise and lie within {bounds.low}:{bounds.high}"
            raise InputError(part, problem, fix=argument("vary", [VARY_EXAMPLE]))
        if counts.setdefault(pieces.sensor, pieces.number) != pieces.number:
            problem = f"{pieces.sensor!r} already has {counts[pieces.sensor]} pieces"
            raise InputError(part, problem, fix="use the same number of pieces for all fields of one stick")
    for sensor, count in counts.items():
        scenario = _replace_script(scenario, sensor, count)
    return scenario


def pieces_spread(scenario: Scenario, texts: Iterable[str]) -> dict[str, str]:
    """Return for each script entry that varies: path of the value -> distribution, as text."""
    spread: dict[str, str] = {}
    for text in texts:
        pieces = parse_pieces(text)
        path = f"{_find_script(scenario, pieces.sensor, text)[1]}.{pieces.field}"
        spread |= {f"{path}[{k}]": f"uniform({pieces.low!r}, {pieces.high!r})" for k in range(pieces.number)}
    return spread


def _find_script(scenario: Scenario, name: str, part: str) -> tuple[StickScript, str]:
    """Return the script of a stick, and the script's path. Faults that wrap the stick are skipped."""
    sensor, path = scenario.world.sensors.get(name), f"world.sensors.{name}"
    while isinstance(sensor, FaultyPart):
        sensor, path = sensor.inner, f"{path}.inner"
    if isinstance(sensor, StickScript):
        return sensor, path
    sticks = [n for n, s in scenario.world.sensors.items() if isinstance(s, StickScript)]
    problem = f"{name!r} is not a stick of this scenario" + ("" if sticks else ", which has no stick")
    fix = (
        argument("vary", [f"{sticks[0]}.turn=pieces(5, -1:1)"])
        if sticks
        else "use a scenario with a pilot: hovercraft/pilot"
    )
    raise InputError(part, problem, choices=sticks, fix=fix)


def _replace_script(scenario: Scenario, name: str, count: int) -> Scenario:
    """Return the scenario with script entries at the beginning of each of `count` equal pieces."""
    old, _ = _find_script(scenario, name, argument_name("vary"))
    if count > scenario.duration // old.period:
        problem = f"{count} pieces in {format_time(scenario.duration)} are shorter than the stick's sampling period"
        raise InputError(argument_name("vary"), problem, fix="use fewer pieces")
    times = np.arange(count, dtype=np.int64) * scenario.duration // count
    entry = np.searchsorted(np.asarray(old.times), times, side="right") - 1
    held = {f: np.append(np.asarray(getattr(old, f)), 0)[entry] for f in (*FIELDS, "mode")}
    script = replace(old, times=times, **{f: v.astype(np.asarray(getattr(old, f)).dtype) for f, v in held.items()})

    def inside(sensor: Any) -> Any:
        return replace(sensor, inner=inside(sensor.inner)) if isinstance(sensor, FaultyPart) else script

    sensors = {**scenario.world.sensors, name: inside(scenario.world.sensors[name])}
    return replace(scenario, world=replace(scenario.world, sensors=sensors))

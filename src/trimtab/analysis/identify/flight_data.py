"""Data for identification, read from a log: commands, the vehicle's input computed from the commands, measurements."""

import dataclasses
import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import Option, Quantity, declarations, leaves, records
from trimtab.core.record import replace
from trimtab.core.rng import key as random_key
from trimtab.core.signals import Sample
from trimtab.core.time import UNITS_PER_SECOND, to_seconds
from trimtab.core.units import UNITS, find_size
from trimtab.logs.log import Log
from trimtab.logs.measurements import NEIGHBOURS, SPIKE
from trimtab.loop.scenario import Scenario

LONGEST_STEP = 0.02
"""Longest integration step (s) of the vehicle model between two measurements."""
FASTEST_TURN, MOST_TURNS = 1.0, 1000
"""Largest plausible values of a measured angle: median change between two measurements (rad), and number of turns."""
LEAST_MEASURED, LEAST_TIME = 20, 1.0
"""Least number of measurements in a log, and least time (s) that commands and measurements must have in common."""
MISSPELT = 0.8
"""Smallest similarity of a mapped name and the name of a state that counts as a misspelling. Names of other quantities
reach 0.78, e.g. heading_std and east_velocity."""
GAP = 2.0
"""Longest gap between two measurements (s). After a longer gap the vehicle's state counts as unknown."""


class FlightData(NamedTuple):
    """Data for identification, read from a log. name: name of the log.  commands: record of arrays (m, …).

    command_ticks: time of each command (m,), 100 ns.  ticks: time of each measurement (n,), 100 ns.
    y: measured fields of the vehicle's state (n, k); NaN: not measured.
    valid: (m,) bool, False while the actuators were neutral because no command had arrived; None: always valid.
    """

    name: str
    commands: Any
    command_ticks: Any
    ticks: Any
    y: Any
    valid: Any = None


def read_flight(log: Log, scenario: Scenario, sensor: str | None = None, name: str = "") -> FlightData:
    """Return the commands in a log, and the measured fields of the vehicle's state.

    Args:
        log: log of a run, of a flight, or of another system (converted by a mapping).
        scenario: scenario with the same vehicle and actuators.
        sensor: sensor to use, e.g. "sensors.mocap". None: the only sensor that measures the vehicle's state.
        name: name of the log, for error messages.

    Raises: InputError if the log has no commands of these actuators, or no field of the vehicle's state.
    """
    where = f"log {name!r}"
    if not len(log):
        raise InputError(where, "contains no rows", fix="give a complete log")
    vectors = [path for path, value, _ in leaves(scenario.initial) if np.shape(value)]
    if vectors:
        problem = f"each field of the vehicle's state must be one number, but these are vectors: {', '.join(vectors)}"
        fix = "give a vehicle whose state has one field for each number, e.g. north, east and heading"
        raise InputError(f"identify, scenario {scenario.name!r}", problem, fix=fix)
    known = ("uplink.value", "command.value", "downlink.command.value")
    base = next((b for b in known if any(p.startswith(f"{b}.") for p in log.paths)), None)
    example = _example_command(scenario)
    fields = [f.name for f in dataclasses.fields(example)]
    if base is None or any(f"{base}.{f}" not in log for f in fields):
        has = sorted({p.rpartition(".")[2] for p in log.paths if ".value." in p})
        problem = f"does not contain the commands {', '.join(fields)} of {type(scenario.world.actuators).__name__}"
        fix = "check that the log is of this vehicle; for a log of another system, map the commands as [sensor.command]"
        raise InputError(where, problem, choices=has[:12], fix=fix)
    flag = f"{base.removesuffix('.value')}.valid"
    valid = log[flag].astype(bool) if flag in log else np.ones(len(log.ticks), bool)
    units = {f: getattr(d, "unit", "1") for f, d in declarations(type(example)).items()}
    shapes = {f: np.shape(getattr(example, f)) for f in fields}
    commands = replace(example, **{f: _read_values(where, log, f"{base}.{f}", units[f], shapes[f]) for f in fields})
    states = {path: getattr(d, "unit", "1") for path, _, d in leaves(scenario.initial)}
    block = _measuring_block(log, list(states), sensor, where)
    ticks, y = _read_measured(where, log, block, states)
    if base.startswith("downlink."):  # log of another system: inputs before the first command are unknown
        times, first = log[f"{base.removesuffix('.value')}.t"], log.ticks[int(np.argmax(valid))]
        only_changes = len(np.unique(times[valid])) < LEAST_MEASURED  # the last command then holds to the end
        last = log.ticks[-1] if only_changes else times[-1]
        _refuse_other_times(where, log.ticks[0], (first, last), ticks)
        driven = ticks >= first
        ticks, y = ticks[driven], y[driven]
        _refuse_misspelt(where, log, block, list(states))
    _refuse_little(where, ticks, y, list(states))
    _refuse_jumps(where, scenario, list(states), ticks, y)
    return FlightData(name, commands, np.asarray(log.ticks, np.int64), ticks, y, valid)


def _read_values(where: str, log: Log, path: str, unit: str, shape: tuple[int, ...] = ()) -> Any:
    """Return the values of a signal (n, …), converted to a unit. Raise InputError for another shape or quantity."""
    values, written = np.asarray(log[path], np.float64), log.unit(path)
    signal = path.rpartition(".value.")[2]
    if values.shape[1:] != shape:
        counts = [int(np.prod(s)) for s in (shape, values.shape[1:])]
        fix = f'in the mapping, name {counts[0]} of the columns: {signal} = {{ from = …, unit = "{unit}" }}'
        problem = f"the count of numbers of {signal!r} in each row must be {counts[0]}, got {counts[1]}"
        raise InputError(where, problem, fix=fix)
    size = 1.0 if written in ("", unit) else find_size(written, unit)
    if size is None:
        problem = f"{signal!r} must be in {unit}, got the unit {written!r}"
        fix = f'in the mapping, correct the unit, or the column: {signal} = {{ from = "…", unit = "{unit}" }}'
        raise InputError(where, problem, choices=UNITS.get(unit, [unit]), fix=fix)
    return values * size


def _refuse_misspelt(where: str, log: Log, block: str, states: Sequence[str]) -> None:
    """Raise InputError if a mapped field of another system's log has nearly the name of a state that is not mapped."""
    mapped = [p.removeprefix(f"{block}.value.") for p in log.paths if p.startswith(f"{block}.value.")]
    for field in [f for f in mapped if f not in states]:
        near = difflib.get_close_matches(field, [s for s in states if s not in mapped], 1, cutoff=MISSPELT)
        if near:
            problem = f"{field!r} is not a field of the vehicle's state"
            fix = f"write {near[0]} in the mapping, or remove {field!r}"
            raise InputError(where, problem, choices=states, fix=fix)


def _refuse_other_times(where: str, start: int, commands: tuple[int, int], ticks: Any) -> None:
    """Raise InputError if commands and measurements of another system have little time in common.

    start: time of the first row of the log.  commands: times of the first and of the last command.
    ticks: times of the measurements (n,).
    """
    measured = (ticks[0], ticks[-1]) if len(ticks) else (start, start)
    common = to_seconds(min(commands[1], measured[1]) - max(commands[0], measured[0]))
    if common >= LEAST_TIME:
        return
    spans = [f"{to_seconds(a - start):.6g} to {to_seconds(b - start):.6g} s" for a, b in (commands, measured)]
    problem = f"the commands are from {spans[0]}, and the measurements from {spans[1]}; they must have at least"
    problem += f" {LEAST_TIME:g} s in common, got {max(common, 0.0):.3g} s"
    fix = 'in the mapping, correct the units of both times, or the offset of one: time = { offset = "-3 s", … }'
    raise InputError(where, problem, fix=fix)


def _refuse_little(where: str, ticks: Any, y: Any, states: Sequence[str]) -> None:
    """Raise InputError if there are few measurements, if they are far apart, or if none of them changes."""
    there = np.isfinite(y).any(axis=1)
    t, y = to_seconds(ticks[there]), y[there]
    if len(t) < LEAST_MEASURED:
        problem = f"at least {LEAST_MEASURED} measurements of the vehicle's state are needed, got {len(t)}"
        raise InputError(where, problem, fix="give a flight of at least several seconds")
    apart = float(np.median(np.diff(t)))
    if apart > GAP:
        problem = f"the measurements must be at most {GAP:g} s apart, got {apart:.3g} s"
        raise InputError(where, problem, fix="measure more often, or correct the unit of the times in the mapping")
    seen = [i for i in range(len(states)) if np.isfinite(y[:, i]).any()]
    if not np.nanmax(np.nanmax(y[:, seen], axis=0) - np.nanmin(y[:, seen], axis=0)) > 0:
        problem = f"{', '.join(states[i] for i in seen)} never change in this log"
        raise InputError(where, problem, fix="give the log of a flight, or map other columns")


def _refuse_jumps(where: str, scenario: Scenario, states: Sequence[str], ticks: Any, y: Any) -> None:
    """Raise InputError if an angle changes too fast, e.g. because it is in degrees, or if there are outliers."""
    angles = {path for path, _, d in leaves(scenario.initial) if isinstance(d, Quantity) and d.kind == "angle"}
    for i, state in enumerate(states):
        at = np.flatnonzero(np.isfinite(y[:, i]))
        values, t = y[at, i], to_seconds(ticks[at])
        if len(values) < LEAST_MEASURED:
            continue
        if state in angles:
            change = np.abs((np.diff(values) + np.pi) % (2 * np.pi) - np.pi)
            if np.median(change) > FASTEST_TURN or np.max(np.abs(values)) > MOST_TURNS * 2 * np.pi:
                problem = f"{state!r} reaches {np.max(np.abs(values)):.3g} rad and changes by {np.median(change):.2g}"
                problem += " rad from one measurement to the next"
                fix = f'if the log is in degrees, write in the mapping: {state} = {{ from = …, unit = "deg" }}'
                raise InputError(where, problem, fix=fix)
            values = np.unwrap(values)
        around = np.lib.stride_tricks.sliding_window_view(np.pad(values, NEIGHBOURS, mode="edge"), 2 * NEIGHBOURS + 1)
        off = np.abs(values - np.median(around, axis=1))
        wild = off > np.maximum(SPIKE * 1.4826 * np.median(off), 0.05 * np.ptp(np.median(around, axis=1)))
        if wild.any():
            k = int(np.argmax(np.where(wild, off, 0.0)))
            problem = f"{state!r} differs by {off[k]:.3g} from the neighbouring measurements at {t[k] - t[0]:.3f} s"
            problem += (
                f" (measurement {at[k] + 1}); there are {int(wild.sum())} such outliers" if wild.sum() > 1 else ""
            )
            raise InputError(where, problem, fix="leave that log row out, because an outlier distorts the fit")


def refuse_copies(flights: Sequence[FlightData], held_out: Sequence[FlightData]) -> None:
    """Raise InputError if two logs, or the part of a log that another one has too, contain the same measurements."""
    for (i, one), (k, other) in itertools.combinations(enumerate([*flights, *held_out]), 2):
        n = min(len(one.ticks), len(other.ticks))
        if np.array_equal(one.ticks[:n], other.ticks[:n]) and np.array_equal(one.y[:n], other.y[:n], equal_nan=True):
            problem = f"the log has the same measurements as log {one.name!r}"
            if i < len(flights) <= k:
                problem += ", so it does not test the fit"
            raise InputError(f"log {other.name!r}", problem, fix="give each flight once")


def _example_command(scenario: Scenario) -> Any:
    """Return an example of an actuator command: the actuators' neutral input, or the failsafe's command."""
    actuators = scenario.world.actuators
    neutral = getattr(actuators, "neutral_input", None)
    if neutral is not None:
        return neutral
    return scenario.failsafe.safe if hasattr(scenario.failsafe, "safe") else actuators.neutral().u


def _measuring_block(log: Log, states: Sequence[str], sensor: str | None, where: str) -> str:
    blocks = dict.fromkeys(
        p.partition(".value.")[0] for p in log.paths if p.startswith(("sensors.", "downlink.")) and ".value." in p
    )
    fitting = [b for b in blocks if any(f"{b}.value.{s}" in log for s in states)]
    unique = {b.partition(".")[2]: b for b in reversed(fitting)}
    if sensor is not None:
        short = sensor.partition(".")[2] if sensor.startswith(("sensors.", "downlink.")) else sensor
        if short not in unique:
            raise InputError(
                argument_name("sensor", sensor),
                f"{where} does not contain measurements of this sensor",
                choices=unique,
                fix=argument("sensor", next(iter(unique)))
                if unique
                else "map a sensor to fields of the vehicle's state",
            )
        return unique[short]
    if len(unique) != 1:
        problem = (
            f"{where}: {'several sensors measure' if unique else 'no sensor measures'} fields of the vehicle's state"
        )
        choices = unique or states
        fix = argument("sensor", next(iter(unique))) if unique else "map a sensor to fields with these names"
        raise InputError("identify", problem, choices=choices, fix=fix)
    return next(iter(unique.values()))


def _read_measured(where: str, log: Log, block: str, states: Mapping[str, str]) -> tuple[Any, Any]:
    """Return times (n,) in ticks, and measured state fields (n, number of fields), of a sensor's valid samples.

    Each sample is returned once, although the log repeats a sample in each row until the next sample. states: name of
    a state field -> unit.
    """
    t = np.asarray(log[f"{block}.t"], np.int64) if f"{block}.t" in log else np.asarray(log.ticks)
    valid = log[f"{block}.valid"].astype(bool) if f"{block}.valid" in log else np.ones(len(t), bool)
    own = valid & (np.diff(t, prepend=np.iinfo(np.int64).min // 2) > 0)
    y = np.full((int(own.sum()), len(states)), np.nan)
    for i, (state, unit) in enumerate(states.items()):
        if f"{block}.value.{state}" in log:
            y[:, i] = _read_values(where, log, f"{block}.value.{state}", unit)[own]
    return t[own], y


def find_grid(actuators: Any) -> int:
    """Return the time step of the actuators' output (ticks): greatest common divisor of the actuators' periods."""
    own = actuators.period
    periods = [
        getattr(r, name)
        for path, r in records(actuators)
        for name, d in declarations(type(r)).items()
        if isinstance(d, Option) and d.kind == "period" and not (path == "" and name == "period")
    ]
    return math.gcd(*periods) if periods and getattr(actuators, "fan", None) is None else own


class GridCommands(NamedTuple):
    """Commands at multiples of a time step. t: times (n,), ticks.  value: record of arrays (n, …). valid: (n,) bool."""

    t: Any
    value: Any
    valid: Any


def lay_on_grid(grid: int, flight: FlightData) -> GridCommands:
    """Return the command in effect at each multiple of the time step `grid` (ticks), for the whole flight."""
    first = int(flight.command_ticks[0] // grid * grid)
    n = int((flight.command_ticks[-1] - first) // grid) + 1
    t = first + grid * np.arange(n, dtype=np.int64)
    at = np.maximum(np.searchsorted(flight.command_ticks, t, side="right") - 1, 0)
    valid = np.ones(n, bool) if flight.valid is None else np.asarray(flight.valid)[at]
    return GridCommands(t, jax.tree.map(lambda v: np.asarray(v)[at], flight.commands), valid)


def actuate(actuators: Any, grid: int, commands: GridCommands) -> Any:
    """Return the time integral (n + 1,) of the vehicle's input, from the first time of the grid to each later time."""
    drive = replace(actuators, period=grid)

    def advance(state: Any, row: Any) -> Any:
        sample = Sample(value=row.value, t=row.t, age=0.0, fresh=True, valid=row.valid)
        state, output = drive.step(row.t, state, sample)
        return state, output.u

    start = jax.tree.map(jnp.asarray, drive.init(random_key(0)))
    shape = jax.eval_shape(advance, start, jax.tree.map(lambda v: v[0], commands))[0]
    start = jax.tree.map(lambda v, s: jnp.asarray(v, s.dtype), start, shape)
    _, u = lax.scan(advance, start, jax.tree.map(jnp.asarray, commands))
    step = to_seconds(grid)
    return jax.tree.map(lambda v: jnp.concatenate([jnp.zeros((1, *v.shape[1:])), jnp.cumsum(v, axis=0) * step]), u)


def mean_input(integral: Any, grid: int, edges: Any, delay: Any) -> Any:
    """Return the mean input of the vehicle over each integration step (n,), if commands take effect after a delay.

    Args:
        integral: result of `actuate`.  grid: time step of the integral (ticks).
        edges: boundaries of the integration steps (n,), in units of `grid` since the first time.  delay: delay (s).
    """
    place = jnp.asarray(edges) - delay / to_seconds(grid)

    def mean(total: Any) -> Any:
        n, shape = total.shape[0] - 1, (-1, *(1,) * (total.ndim - 1))
        inside = jnp.clip(place, 0.0, n)
        index = jnp.minimum(jnp.floor(inside), n - 1).astype(np.int32)
        part, beyond = (inside - index).reshape(shape), (place - inside).reshape(shape)
        low, high = total[index], total[index + 1]
        before, after = (total[1] - total[0]) * (beyond < 0), (total[-1] - total[-2]) * (beyond > 0)
        value = low + (high - low) * part + beyond * (before + after)
        length = jnp.maximum((place[1:] - place[:-1]) * to_seconds(grid), 1e-12).reshape(shape)
        return jnp.concatenate([jnp.zeros((1, *total.shape[1:])), (value[1:] - value[:-1]) / length])

    return jax.tree.map(mean, integral)


def fill_gaps(ticks: Any) -> tuple[Any, Any]:
    """Return times (ticks) with others inserted where two are far apart, and the indices of the original times."""
    longest = LONGEST_STEP * UNITS_PER_SECOND
    parts = np.maximum(np.ceil(np.diff(ticks) / longest).astype(int), 1)
    parts = np.where(np.diff(ticks) > GAP * UNITS_PER_SECOND, 1, parts)
    at = np.concatenate([[0], np.cumsum(parts)])
    instants = np.interp(np.arange(at[-1] + 1), at, ticks)
    return np.round(instants).astype(np.int64), at

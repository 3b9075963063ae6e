"""simulate: a scenario in virtual time, one compiled walk over its instants."""

import functools
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, children, is_record, leaves, numeric, replace
from trimtab.core.rng import Key
from trimtab.core.time import Timetable, ms, show, timetable, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import Signals, Walked, walk

MAX_INSTANTS = 200_000_000


def simulate(
    scenario: Scenario, *, seed: int = 0, run: int = 0, duration: int | None = None, log_period: int = ms(1)
) -> Log:
    """Run a scenario in virtual time and give its log.

    Args:
        scenario: what flies; checked whole before anything runs.
        seed: of the random numbers, 0 … 2**32 - 1.
        run: number of the run within a study; (seed, run) decides every random number.
        duration: integer time (100 ns units); the scenario's own when None.
        log_period: how often signals are logged; a multiple of it is logged where some block is due.

    Returns:
        The log: every signal by its path, the true state at the end, and what is needed to run it again.

    Raises:
        InputError: a value, a period, a name or a pair of parts that can't be flown, with the fix.
    """
    scenario, table, written = _prepare(scenario, [seed, run], duration, log_period)
    walked = _compiled(_world(scenario, seed, run), *_timing(table, written))
    return _log(scenario, walked, table, written, seed, run, log_period)


def simulate_many(
    scenario: Scenario, *, seeds: Iterable[int], duration: int | None = None, log_period: int = ms(10)
) -> list[Log]:
    """`simulate` for many seeds at once, one log each; row i is equal to the single run of seeds[i]."""
    chosen = list(seeds)
    scenario, table, written = _prepare(scenario, chosen, duration, log_period)
    if not chosen:
        return []
    world, autopilot, x, key = _world(scenario, 0, 0)
    walked = _compiled_many(
        (world, autopilot, x, replace(key, seed=np.array(chosen, np.uint32))), *_timing(table, written)
    )
    rows, finals = np.asarray(walked.rows), jax.tree.map(np.asarray, (walked.last, walked.x))
    logs = []
    for i, seed in enumerate(chosen):
        last, x = jax.tree.map(lambda a, i=i: a[i], finals)
        logs.append(_log(scenario, Walked(rows[i], last, x), table, written, seed, 0, log_period))
    return logs


@functools.partial(jax.jit, static_argnums=(2, 3))
def _compiled(fly: Any, instants: Any, rows: int, always: frozenset[int]) -> Walked:
    return walk(*fly, instants, rows, always)


@functools.partial(jax.jit, static_argnums=(2, 3))
def _compiled_many(fly: Any, instants: Any, rows: int, always: frozenset[int]) -> Walked:
    world, autopilot, x, key = fly
    return jax.vmap(lambda seed: walk(world, autopilot, x, replace(key, seed=seed), instants, rows, always))(key.seed)


def _prepare(
    scenario: Scenario, seeds: list[int], duration: int | None, log_period: int
) -> tuple[Scenario, Timetable, Any]:
    if duration is not None:
        scenario = replace(scenario, duration=duration)
    scenario.check()
    for seed in seeds:
        if not 0 <= seed < 2**32:
            raise InputError("--seed", f"{seed} is not in 0 … {2**32 - 1}", fix="--seed 0")
    if log_period < 1:
        raise InputError("log_period", f"{show(log_period)} is too short", fix="log_period=ms(1)")
    count = sum(scenario.duration // p for p in {*scenario.world.periods(), scenario.autopilot.period})
    if count > MAX_INSTANTS:
        problem = f"{show(scenario.duration)} takes about {count:.1e} instants, more than {MAX_INSTANTS:.0e}"
        raise InputError("duration", problem, fix="a shorter duration, or longer periods")
    periods = [*scenario.world.periods(), scenario.autopilot.period]
    table = timetable(periods, scenario.duration, scenario.world.max_step)
    return scenario, table, table.t % log_period == 0


def _world(scenario: Scenario, seed: int, run: int) -> Any:
    key = Key(np.uint32(seed), np.uint32(run))
    return numeric(scenario.world), numeric(scenario.autopilot), numeric(scenario.initial), key


def _timing(table: Timetable, written: Any) -> Any:
    rows = int(written.sum())
    index = np.where(written, np.cumsum(written) - 1, rows).astype(np.int32)
    return (table.t, table.h, index), rows, table.always


def _log(
    scenario: Scenario, walked: Walked, table: Timetable, written: Any, seed: int, run: int, log_period: int
) -> Log:
    ticks = table.t[written]
    signals, declared = _unpack(np.asarray(walked.rows), walked.last)
    final = {f"truth.{p}": np.asarray(v)[()] for p, v, _ in leaves(walked.x)}
    metadata = {
        "scenario": scenario.name,
        "seed": seed,
        "run": run,
        "backend": "jax",
        "duration_s": to_seconds(scenario.duration),
        "log_period_s": to_seconds(log_period),
        "parameters": {p: _plain(v) for p, v, _ in leaves(scenario)},
    }
    return Log(
        t=to_seconds(ticks), ticks=ticks, signals=signals, declared=declared, metadata=metadata, final=final
    )


def _plain(value: Any) -> Any:
    if isinstance(value, str | bool | int) or value is None:
        return value
    return np.asarray(value).tolist()


def _unpack(rows: Any, last: Signals) -> tuple[dict[str, Any], dict[str, Quantity]]:
    """Columns of the log by path, each in its own type, and what they mean."""
    signals: dict[str, Any] = {}
    declared: dict[str, Quantity] = {}
    start = 0
    for path, value, meaning in _logged(last):
        shape, dtype = np.shape(value), np.asarray(value).dtype
        stop = start + int(np.prod(shape))
        signals[path] = rows[:, start:stop].reshape(len(rows), *shape).astype(dtype)
        declared[path] = meaning
        start = stop
    return signals, declared


def _logged(value: Any, path: str = "") -> list[tuple[str, Any, Quantity]]:
    """Quantities in the order in which jax flattens them: fields as declared, mappings by sorted key."""
    found: list[tuple[str, Any, Quantity]] = []
    below = children(value)
    for name, child, declared in below if is_record(value) else sorted(below):
        here = f"{path}.{name}" if path else name
        if isinstance(declared, Quantity):
            found.append((here, child, declared))
        elif children(child):
            found += _logged(child, here)
    return found

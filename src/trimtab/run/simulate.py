"""simulate: a scenario in virtual time, one compiled walk over its instants."""

import functools
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.record import Quantity, leaves, numeric, replace
from trimtab.core.rng import Key
from trimtab.core.time import Timetable, ms, show, timetable, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import Signals, Walked, logged, walk

MAX_INSTANTS = 200_000_000


def simulate(
    scenario: Scenario,
    *,
    seed: int = 0,
    run: int = 0,
    duration: int | None = None,
    log_period: int = ms(1),
    signals: tuple[str, ...] = (),
) -> Log:
    """Run a scenario in virtual time and give its log.

    Args:
        scenario: what flies; checked whole before anything runs.
        seed: of the random numbers, 0 … 2**32 - 1.
        run: number of the run within a study; (seed, run) decides every random number.
        duration: integer time (100 ns units); the scenario's own when None.
        log_period: how often signals are logged; a multiple of it is logged where some block is due.
        signals: which signals are logged, e.g. ("truth", "law.mode"): a name takes all below it; all when empty.

    Returns:
        The log: every signal by its path, the true state at the end, and what is needed to run it again.

    Raises:
        InputError: a value, a period, a name or a pair of parts that can't be flown, with the fix.
    """
    scenario, table, written = _prepare(scenario, [seed, run], duration, log_period)
    walked = _compiled(_world(scenario, seed, run), *_timing(table, written), signals)
    _check_signals(walked.seen, signals)
    return _log(scenario, walked, table.t[written], Request(seed, run, log_period, signals))


def simulate_many(
    scenario: Scenario,
    *,
    seeds: Iterable[int],
    duration: int | None = None,
    log_period: int = ms(10),
    signals: tuple[str, ...] = (),
) -> list[Log]:
    """`simulate` for many seeds at once, one log each; row i is equal to the single run of seeds[i]."""
    chosen = list(seeds)
    scenario, table, written = _prepare(scenario, chosen, duration, log_period)
    if not chosen:
        return []
    world, autopilot, x, key = _world(scenario, 0, 0)
    words = replace(key, seed=np.array(chosen, np.uint32))
    walked = _compiled_many((world, autopilot, x, words), *_timing(table, written), signals)
    _check_signals(walked.seen, signals)
    rows, finals = np.asarray(walked.rows), jax.tree.map(np.asarray, walked.x)
    logs = []
    for i, seed in enumerate(chosen):
        x = jax.tree.map(lambda a, i=i: a[i], finals)
        seen = jax.tree.map(lambda a, i=i: a[i], walked.seen)
        one = Walked(rows[i], seen, x, None)
        logs.append(_log(scenario, one, table.t[written], Request(seed, 0, log_period, signals)))
    return logs


class Request(NamedTuple):
    """What was asked of a run besides its scenario."""

    seed: int
    run: int
    log_period: int
    signals: tuple[str, ...]


@functools.partial(jax.jit, static_argnums=(2, 3, 4))
def _compiled(fly: Any, instants: Any, rows: int, always: frozenset[int], signals: tuple[str, ...]) -> Walked:
    world, autopilot, x, key = fly
    return walk(world, autopilot, x, key, instants, rows, always, signals)


@functools.partial(jax.jit, static_argnums=(2, 3, 4))
def _compiled_many(fly: Any, instants: Any, rows: int, always: frozenset[int], signals: tuple[str, ...]) -> Walked:
    world, autopilot, x, key = fly

    def one(seed: Any) -> Walked:
        return walk(world, autopilot, x, replace(key, seed=seed), instants, rows, always, signals)

    return jax.vmap(one)(key.seed)


def _check_signals(seen: Signals, wanted: tuple[str, ...]) -> None:
    known = [path for path, _, _ in logged(seen)]
    for name in wanted:
        if not any(path == name or path.startswith(name + ".") for path in known):
            near = closest(name, known, 6) or sorted({p.split(".")[0] for p in known})
            raise InputError("signals", f"there is no signal {name!r}", choices=near, fix=f"signals=({near[0]!r},)")


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


def _log(scenario: Scenario, walked: Walked, ticks: Any, request: Request) -> Log:
    signals, declared = _unpack(np.asarray(walked.rows), walked.seen, request.signals)
    final = {f"truth.{p}": np.asarray(v)[()] for p, v, _ in leaves(walked.x)}
    metadata = {
        "scenario": scenario.name,
        "seed": request.seed,
        "run": request.run,
        "backend": "jax",
        "duration_s": to_seconds(scenario.duration),
        "log_period_s": to_seconds(request.log_period),
        "parameters": {p: _plain(v) for p, v, _ in leaves(scenario)},
    }
    return Log(t=to_seconds(ticks), ticks=ticks, signals=signals, declared=declared, metadata=metadata, final=final)


def _plain(value: Any) -> Any:
    if isinstance(value, str | bool | int) or value is None:
        return value
    return np.asarray(value).tolist()


def _unpack(rows: Any, seen: Signals, wanted: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Quantity]]:
    """Columns of the log by path, each in its own type, and what they mean."""
    signals: dict[str, Any] = {}
    declared: dict[str, Quantity] = {}
    start = 0
    for path, value, meaning in logged(seen, wanted):
        shape, dtype = np.shape(value), np.asarray(value).dtype
        stop = start + int(np.prod(shape))
        signals[path] = rows[:, start:stop].reshape(len(rows), *shape).astype(dtype)
        declared[path] = meaning
        start = stop
    return signals, declared

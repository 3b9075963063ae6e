"""What comes before every run: checks, timetable, inputs, and the choice of what flies it."""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import Key
from trimtab.core.time import Timetable, format_time, timetable
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import Signals, logged_signals
from trimtab.native.build import BuildError
from trimtab.native.compiler import NoCompilerError
from trimtab.run.program import check_seed

MAX_INSTANTS = 200_000_000
BACKENDS = ("auto", "c", "jax")
_reported_parts: set[str] = set()


def prepare_run(
    scenario: Scenario, seeds: list[int], duration: int | None, log_period: int
) -> tuple[Scenario, Timetable, Any]:
    """The checked scenario, its instants, and which of them are logged."""
    if duration is not None:
        scenario = replace(scenario, duration=duration)
    scenario.check()
    for seed in seeds:
        check_seed(seed)
    if log_period < 1:
        raise InputError("log_period", f"{format_time(log_period)} is too short", fix="log_period=ms(1)")
    count = sum(scenario.duration // p for p in {*scenario.world.periods(), scenario.autopilot.period})
    if count > MAX_INSTANTS:
        problem = f"{format_time(scenario.duration)} takes about {count:.1e} instants, more than {MAX_INSTANTS:.0e}"
        raise InputError("duration", problem, fix="a shorter duration, or longer periods")
    periods = [*scenario.world.periods(), scenario.autopilot.period]
    table = timetable(periods, scenario.duration, scenario.world.max_step)
    return scenario, table, table.t % log_period == 0


def run_inputs(scenario: Scenario, seed: int, run: int) -> Any:
    """World, autopilot, first state and key: all that a run starts from, as numbers of fixed types."""
    key = Key(np.uint32(seed), np.uint32(run))
    return to_arrays(scenario.world), to_arrays(scenario.autopilot), to_arrays(scenario.initial), key


def check_signals(seen: Signals, wanted: tuple[str, ...]) -> None:
    """Refuse names of signals that there are none of."""
    known = [path for path, _, _ in logged_signals(seen)]
    for name in wanted:
        if not any(path == name or path.startswith(name + ".") for path in known):
            near = closest(name, known, 6) or sorted({p.split(".")[0] for p in known})
            raise InputError("signals", f"there is no signal {name!r}", choices=near, fix=f"signals=({near[0]!r},)")


def choose_c(backend: str, ready: Callable[[], Any]) -> bool:
    """Whether C flies: where it is asked for, or can be had; `ready` makes the program or says why not.

    Without C, "auto" flies on JAX, about ten times slower, and says so once.
    """
    if backend not in BACKENDS:
        raise InputError("backend", f"{backend!r} is not a backend", choices=BACKENDS, fix='backend="auto"')
    if backend == "jax":
        return False
    try:
        ready()
    except InputError as error:
        if backend == "c" or not (isinstance(error, NoCompilerError | BuildError) or error.part == "export"):
            raise
        if error.part not in _reported_parts:
            _reported_parts.add(error.part)
            print(f"note: flying on JAX, about ten times slower: {error}", file=sys.stderr)
        return False
    return True

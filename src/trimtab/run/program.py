"""A scenario ready to fly in C: library, inputs, and the meaning of what comes out. Needs no JAX, so it can be kept."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, children, is_record, leaves
from trimtab.core.time import timetable, to_seconds
from trimtab.logs.log import Log, provenance
from trimtab.run.library import RunResults, fly_runs, row_numbers


class Column(NamedTuple):
    """One signal of a row, or one of the last values."""

    path: str
    shape: tuple[int, ...]
    dtype: str
    declaration: Quantity | None = None


class Program(NamedTuple):
    """A compiled scenario.

    library: scalar C.  shared: its inputs, float64, with the key words (seed, run) at `words` to be filled in.
    periods, duration, max_step: what the timetable follows from.  columns: of a row.  final: the last values.
    metadata: what a log says besides seed and backend.
    """

    library: Path
    shared_inputs: Any
    words: tuple[int, int]
    periods: tuple[int, ...]
    duration: int
    max_step: int
    columns: list[Column]
    final: list[Column]
    metadata: dict[str, Any]

    def fly(self, seed: int, run: int, log_period: int) -> Log:
        """One run, as `simulate` gives it."""
        table = timetable(self.periods, self.duration, self.max_step)
        written = table.t % log_period == 0
        shared = self.shared_inputs.copy()
        shared[list(self.words)] = seed, run
        widths = row_width(self.columns), row_width(self.final)
        flown = fly_runs(self.library, shared, np.empty((1, 0)), table, row_numbers(written), widths)
        metadata = self.metadata | {"seed": seed, "run": run, "log_period_s": to_seconds(log_period)}
        return make_log(self, flown, 0, table.t[written], metadata)


def check_seed(seed: int) -> None:
    """Refuse a number that is no seed, or no number of a run."""
    if not 0 <= seed < 2**32:
        raise InputError("--seed", f"{seed} is not in 0 … {2**32 - 1}", fix="--seed 0")


def row_width(columns: list[Column]) -> int:
    """How many numbers some columns take."""
    return sum(int(np.prod(c.shape)) for c in columns)


def split_columns(rows: Any, columns: list[Column]) -> dict[str, Any]:
    """Columns by path, each in its own type and shape, of rows (..., width); what has its type already is a view."""
    found, start = {}, 0
    for c in columns:
        stop = start + int(np.prod(c.shape))
        found[c.path] = rows[..., start:stop].reshape((*rows.shape[:-1], *c.shape)).astype(c.dtype, copy=False)
        start = stop
    return found


def make_log(program: Program, flown: RunResults, run: int, ticks: Any, metadata: dict[str, Any]) -> Log:
    """The log of one of the runs."""
    signals = split_columns(flown.log[run], program.columns)
    final = split_columns(flown.final[run], program.final)
    return Log(
        t=to_seconds(ticks),
        ticks=ticks,
        signals=signals,
        declarations={c.path: c.declaration for c in program.columns if c.declaration is not None},
        metadata=metadata | {"backend": "c"},
        final={path: value[()] for path, value in final.items() if path.startswith("truth.")},
    )


def describe_scenario(scenario: Any) -> dict[str, Any]:
    """What a log says of its scenario."""
    return {
        "scenario": scenario.name,
        "duration_s": to_seconds(scenario.duration),
        "parameters": {p: plain_setting(v) for p, v, _ in leaves(scenario)},
        "parts": part_classes(scenario),
        **provenance(),
    }


def part_classes(tree: Any, path: str = "") -> dict[str, str]:
    """Path of each record below a tree -> the name of its class."""
    found = {}
    for name, child, _ in children(tree):
        here = f"{path}.{name}" if path else name
        found |= ({here: type(child).__name__} if is_record(child) else {}) | part_classes(child, here)
    return found


def plain_setting(value: Any) -> Any:
    """A quantity or an option as a log's metadata has it."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    return np.asarray(value).tolist()

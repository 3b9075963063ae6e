"""Stability map: success of a scenario over a grid of two parameters, refined near the boundary of success.

Source: docs page, Stability maps; R. A. Finkel, J. L. Bentley, "Quad trees: a data structure for retrieval on composite
keys", Acta Informatica 4 (1974), for the tree of cells. The rule for splitting cells was developed for this package.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.campaign.grammar import parse_condition
from trimtab.analysis.campaign.search.axes import Axis, enlarge_rings, find_quantity, with_values
from trimtab.analysis.campaign.statistics.metrics import find_metric, name_option, swing_amplitude
from trimtab.analysis.campaign.store.memo import FlightMemo
from trimtab.analysis.campaign.workers.block import batch_rows
from trimtab.core.errors import InputError
from trimtab.core.quantity import split_component
from trimtab.logs.metrics import full_path
from trimtab.loop.scenario import Scenario
from trimtab.run.known_signals import find_signals
from trimtab.run.runner import LEAST_LANE_RUNS
from trimtab.run.simulate import Batch, simulate_batch

Cell = tuple[int, int, int]
"""Cell of the grid: indices of the lower corner, and size, in steps of the finest grid (lattice)."""
DEEPEST = 12
Success = Callable[[Batch], Any]
"""Function from a batch with its log to the success (n,) of each run."""
SWING = 0.1
"""Largest accepted residual oscillation at the end of a run, as a fraction of a target's band."""
ROWS = 300
"""Approximate number of log rows that are evaluated in each run."""
NUMBERS = 20_000_000
"""Maximum number of logged values in memory. A batch that needs more is flown in parts."""
ALL = 100
"""Approximate number of values in a log row if all signals are logged."""


class TracedBoundary(NamedTuple):
    """Values on a lattice (grid with the finest step) of `shape` points. Only some points were evaluated.

    index: (n, 2), lattice indices of the evaluated points, in the order of evaluation.  value: (n,), value of each of
    these points, in [0, 1].  call_index: (n,), number of the function call that evaluated each point, from 0.  cells:
    (k, 3), lower corner and size of the cells that tile the lattice.  threshold: a point is inside if its value is at
    least the threshold.
    """

    shape: tuple[int, int]
    index: Any
    value: Any
    call_index: Any
    cells: Any
    threshold: float

    @property
    def evaluated_points(self) -> int:
        """Return the number of evaluated points."""
        return len(self.index)

    @property
    def of(self) -> int:
        """Return the number of points of a complete grid with the same resolution."""
        return self.shape[0] * self.shape[1]

    def grid(self) -> Any:
        """Return the values on the whole lattice, NaN where a point was not evaluated."""
        whole = np.full(self.shape, np.nan)
        whole[self.index[:, 0], self.index[:, 1]] = self.value
        return whole

    def boundary_cells(self) -> Any:
        """Return the cells (k, 3) that contain the boundary of success, i.e. with edge points on both sides."""
        inside, known = self.grid() >= self.threshold, ~np.isnan(self.grid())
        mixed = [_is_mixed(inside, known, c) for c in self.cells.tolist()]
        return self.cells[np.array(mixed, bool)]

    def crossings(self, line: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return the crossings of the boundary of success along one line of the lattice.

        Each crossing is a pair of neighbouring evaluated points, as lattice indices along `axis`.
        line: index of the line on the other axis. Lines that are not part of the coarse grid have few evaluated points.
        """
        values = self.grid().take(line, axis=1 - axis)
        known = np.flatnonzero(~np.isnan(values))
        inside = values[known] >= self.threshold
        return [(int(known[i]), int(known[i + 1])) for i in np.flatnonzero(inside[1:] != inside[:-1])]


def trace_boundary(
    values: Callable[[Any], Any], coarse: tuple[int, int], depth: int, *, threshold: float = 0.5
) -> TracedBoundary:
    """Evaluate a coarse grid, then refine only the cells whose edges have points on both sides of the boundary.

    On each of `depth` levels, these cells are halved, and their new points are evaluated in one call. If a new point on
    an edge shows that the boundary enters the neighbouring cell, that cell is split too, in a further call. A region
    that contains no point of the coarse grid is not found.

    Args:
        values: function from lattice points (k, 2) to their values (k,).
        coarse: number of points of the coarse grid along each axis, 2 or more.
        depth: number of times that a cell is halved. The lattice has (c - 1) 2^depth + 1 points along an axis with c
            points of the coarse grid.
        threshold: a point is inside if its value is at least the threshold.
    """
    check_grid(coarse, depth)
    size = 2**depth
    shape = ((coarse[0] - 1) * size + 1, (coarse[1] - 1) * size + 1)
    inside, known = np.zeros(shape, bool), np.zeros(shape, bool)
    calls: list[tuple[Any, Any]] = []

    def look(points: Any) -> None:
        if len(points):
            value = np.asarray(values(points), float)
            calls.append((points, value))
            known[points[:, 0], points[:, 1]] = True
            inside[points[:, 0], points[:, 1]] = value >= threshold

    starts = [(i, j) for i in range(0, shape[0], size) for j in range(0, shape[1], size)]
    look(np.array(starts))
    cells: list[Cell] = [(i, j, size) for i, j in starts if i + size < shape[0] and j + size < shape[1]]
    while size > 1:
        size //= 2
        while True:
            split = [c for c in cells if c[2] > size and _is_mixed(inside, known, c)]
            if not split:
                break
            gone = set(split)
            cells = [c for c in cells if c not in gone] + [q for c in split for q in _split_cell(c)]
            look(np.array(sorted({p for c in split for p in _cell_nodes(c) if not known[p]})).reshape(-1, 2))
    index, value = (np.concatenate(parts) for parts in zip(*calls, strict=True))
    call_index = np.repeat(np.arange(len(calls)), [len(points) for points, _ in calls])
    return TracedBoundary(shape, index, value, call_index, np.array(cells), threshold)


def check_grid(coarse: tuple[int, int], depth: int) -> None:
    """Raise InputError for a coarse grid with fewer than 2 points along an axis, or for a depth out of range."""
    if min(coarse) < 2 or not 0 <= depth <= DEEPEST:
        problem = f"got a coarse grid of {coarse[0]} x {coarse[1]} points and depth {depth}"
        fix = f"use 2 points or more along each axis, and a depth of 0 to {DEEPEST}"
        raise InputError("boundary", problem, fix=fix)


def _is_mixed(inside: Any, known: Any, cell: Cell) -> bool:
    """Return True if the evaluated points on the edges of a cell lie on both sides of the boundary."""
    i, j, size = cell
    at = (slice(i, i + size + 1), slice(j, j + size + 1))
    sides = inside[at][known[at]]
    return bool(sides.any() and not sides.all())


def _split_cell(cell: Cell) -> list[Cell]:
    i, j, size = cell
    h = size // 2
    return [(i, j, h), (i + h, j, h), (i, j + h, h), (i + h, j + h, h)]


def _cell_nodes(cell: Cell) -> list[tuple[int, int]]:
    """Return the lattice points in the middle of a cell and in the middle of each edge of the cell."""
    i, j, size = cell
    h = size // 2
    return [(i + h, j), (i, j + h), (i + h, j + h), (i + size, j + h), (i + h, j + size)]


def parse_success(scenario: Scenario, texts: Iterable[str]) -> tuple[Success, tuple[str, ...]]:
    """Return a function that decides by conditions if each run of a batch succeeds, and the signals for the function.

    Args:
        scenario: scenario to fly.
        texts: conditions that must all hold, e.g. "error_rms:yaw_rate <= 0.5".

    Raises: InputError if a condition uses a metric or signal that the scenario does not have.
    """
    known = find_signals(scenario)
    conditions = [parse_condition(text) for text in texts]
    metrics = []
    for c in conditions:
        with name_option("success", f" {c.compare} {c.bound:g}"):
            metrics.append(find_metric(c.metric, known.shapes, scenario.targets, known.units, scenario.duration))

    def judge(batch: Batch) -> Any:
        rows = batch_rows(scenario, batch)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.all([c.holds(m.of(rows)) for c, m in zip(conditions, metrics, strict=True)], axis=0)

    return judge, known.source_signals(s for m in metrics for s in m.signals)


class StabilityMap(NamedTuple):
    """Stability map: share of successful runs at each point flown.

    scenario: scenario as flown, with links and buffers prepared for all latencies of the map.  x, y: axes.  at_x, at_y:
    values on the axes of the finest grid (nx,), (ny,).  traced_boundary: evaluated points, shares of successes, cells.
    runs: number of runs at each point.  backend: simulation backend used.
    """

    scenario: Scenario
    x: Axis
    y: Axis
    at_x: Any
    at_y: Any
    traced_boundary: TracedBoundary
    runs: int
    backend: str

    @property
    def sample_points(self) -> Any:
        """Return the values on the two axes (n, 2) of the points flown."""
        i, j = self.traced_boundary.index.T
        return np.column_stack([self.at_x[i], self.at_y[j]])

    @property
    def share(self) -> Any:
        """Return the share of successful runs at each of `sample_points` (n,)."""
        return self.traced_boundary.value

    def crossings(self, y: float) -> list[tuple[float, float]]:
        """Return the crossings of the boundary of success along the line of the finest grid that is nearest to y.

        Each crossing is a pair of neighbouring x values, one on each side of the boundary.
        """
        line = int(np.abs(self.at_y - y).argmin())
        return [(float(self.at_x[a]), float(self.at_x[b])) for a, b in self.traced_boundary.crossings(line)]


def stability_map(
    scenario: Scenario,
    x: Axis,
    y: Axis,
    *,
    runs: int = 8,
    depth: int = 4,
    threshold: float = 0.5,
    seed: int = 0,
    swing: float = SWING,
    success: Success | None = None,
    signals: tuple[str, ...] = (),
    log_period: int | None = None,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int], None] = lambda more: None,
    memo: FlightMemo | None = None,
) -> StabilityMap:
    """Fly a coarse grid of points, then refine the cells that contain the boundary of success.

    All new points of a level fly in one batch. All points have the same seeds, so that neighbouring points differ only
    by the parameters on the axes, and the boundary is smooth also with noise.

    Args:
        scenario: the scenario to fly.
        x, y: the axes. Their values are those of the coarse grid.
        runs: number of runs at each point.
        depth: number of times that a cell is halved.
        threshold: share of successful runs that defines the boundary.
        seed: seed of the first run at each point. The further runs at a point have seeds seed + 1, seed + 2, …
        swing: largest accepted residual oscillation, as a fraction of each target's band. Not used with `success`.
        success: function that returns the success of each run of a batch from its log. Default: `target_success`.
        signals: signals logged for `success`. Default without `success`: the targets' signals.
        log_period: period of the log rows (100 ns). Default: a multiple of the autopilot's period, for about 300 rows.
        backend, threads: as in `simulate_batch`.
        progress: function called with the number of points flown since the last call.
        memo: store of earlier flights of this scenario with the same success function.

    Raises:
        InputError: before any run starts, if the scenario at any point of the coarse grid is invalid.
    """
    if runs < 1 or not 0 < threshold <= 1:
        problem = f"runs must be at least 1, and threshold above 0 and at most 1; got {runs} and {threshold}"
        raise InputError("stability_map", problem, fix="give one run or more, and a threshold in (0, 1]")
    for axis in (x, y):
        axis.check()
    check_grid((len(x.values), len(y.values)), depth)
    judge = target_success(scenario, swing) if success is None else success
    if success is None:
        aimed = [split_component(full_path(t.path))[0] for t in scenario.targets]
        signals = signals or find_signals(scenario).source_signals(aimed)
    base, paths = _prepare_map(scenario, x, y)
    step = log_period or max(scenario.duration // scenario.autopilot.period // ROWS, 1) * scenario.autopilot.period
    at_x, at_y = (_lattice(axis.values, depth) for axis in (x, y))
    options: dict[str, Any] = {"signals": signals, "log_period": step, "backend": backend, "threads": threads}
    numbers = scenario.duration // step * (len(signals) or ALL)
    memo = memo or FlightMemo(None, {})
    flights = _PointFlights(base, range(seed, seed + runs), judge, numbers, options, memo, [])

    def fly_points_at(index: Any) -> Any:
        values = [values_at(base, x, y, at_x[i], at_y[j]) for i, j in index]
        share = flights.share({path: np.stack([v[path] for v in values]) for path in paths})
        progress(len(index))
        return share

    traced = trace_boundary(fly_points_at, (len(x.values), len(y.values)), depth, threshold=threshold)
    return StabilityMap(base, x, y, at_x, at_y, traced, runs, flights.used[0])


class _PointFlights(NamedTuple):
    """Settings of the runs at the points of a map, with methods that fly the runs.

    scenario: scenario to fly.  seeds: seeds of the runs at a point.  is_success: function that returns the success of
    each run.  numbers: number of logged values of a run.  options: options of `simulate_batch`.  memo: store of
    earlier flights.  used: backends used so far.
    """

    scenario: Scenario
    seeds: range
    is_success: Success
    numbers: int
    options: dict[str, Any]
    memo: FlightMemo
    used: list[str]

    def share(self, own: dict[str, Any]) -> Any:
        """Return the share of successful runs (k,) at k points. own: path -> parameter values at the points (k, …)."""
        points, runs = len(next(iter(own.values()))), len(self.seeds)
        each = max(NUMBERS // max(self.numbers * runs, 1), 1)
        slices = [slice(i, min(i + each, points)) for i in range(0, points, each)]
        ok = [self._fly_runs({path: np.repeat(v[part], runs, axis=0) for path, v in own.items()}) for part in slices]
        return np.concatenate(ok).reshape(points, runs).mean(axis=1)

    def _fly_runs(self, spread: dict[str, Any]) -> Any:
        """Return the success (n,) of each run. The runs of one point are consecutive."""
        count = len(next(iter(spread.values())))
        seeds = np.tile(self.seeds, count // len(self.seeds))
        if (
            self.used[:1] == ["c lanes"] and count < LEAST_LANE_RUNS
        ):  # otherwise another program would have to be compiled
            more = np.arange(LEAST_LANE_RUNS) % count
            spread, seeds = {path: v[more] for path, v in spread.items()}, seeds[more]
        asked = (" ".join(spread), *spread.values(), seeds, str(self.options | {"threads": None}))
        flown = self.memo.recall(asked, lambda: self._judge_batch(spread, seeds))
        self.used.append(str(flown["backend"]))
        return flown["success"][:count]

    def _judge_batch(self, spread: dict[str, Any], seeds: Any) -> dict[str, Any]:
        batch = simulate_batch(self.scenario, seeds=seeds.tolist(), spread=spread, log=True, **self.options)
        return {"success": np.asarray(self.is_success(batch), bool), "backend": np.array(batch.backend)}


def target_success(scenario: Scenario, swing: float = SWING) -> Success:
    """Return a function that decides by the targets if each run of a batch succeeds.

    Each target's signal must stay in its band over the last third of the run, with a small or decaying oscillation. An
    amplitude up to `swing` times the band is small, see `statistics.metrics.swing_amplitude`. A larger limit cycle is
    not a success, even inside the band. Angles count modulo full turns.
    """
    targets = tuple(scenario.targets)
    if not targets:
        fix = "add targets=(Target(…),) to the scenario, or pass a success function of your own"
        raise InputError(
            f"scenario {scenario.name!r}", "has no targets; define success with conditions or a function", fix=fix
        )

    def judge(batch: Batch) -> Any:
        ticks = np.asarray(batch.ticks)
        late = ticks >= ticks[0] + (ticks[-1] - ticks[0]) * 2 / 3
        logged = batch_rows(scenario, batch)
        ok = np.ones(len(batch.seeds), bool)
        for target in targets:
            path = full_path(target.path)
            rows = logged[path][:, late].astype(float)
            with np.errstate(invalid="ignore", over="ignore"):
                away = rows - target.value
                if split_component(path)[0] in logged.angles:
                    away = away - 2 * np.pi * np.round(away[:, -1:] / (2 * np.pi))
                ok &= (np.abs(away) <= target.band).all(axis=1) & (swing_amplitude(logged, path) <= swing * target.band)
        return ok

    return judge


def _prepare_map(scenario: Scenario, x: Axis, y: Axis) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario to fly, and the paths of parameters that differ between points. Check every coarse point."""
    base = y.prepare(x.prepare(scenario))
    last = with_values(base, values_at(base, x, y, x.values[-1], y.values[-1]))
    base = enlarge_rings(base, last)
    paths: tuple[str, ...] = ()
    for a in x.values:
        for b in y.values:
            values = values_at(base, x, y, a, b)
            paths = tuple(values)
            with_values(base, values).check()
    return base, paths


def values_at(base: Scenario, x: Axis, y: Axis, a: float, b: float) -> dict[str, Any]:
    """Return path -> parameter value at one point (a, b) of the map.

    The changes by axis y are made after those by axis x.
    """
    first = x.change(base, float(a))
    second = y.change(base, float(b))
    if {*first} & {*second}:
        second = y.change(with_values(base, first), float(b))
    both = {**first, **second}
    return {path: np.asarray(value, find_quantity(base, path)[1].dtype()) for path, value in both.items()}


def _lattice(values: Any, depth: int) -> Any:
    coarse = np.asarray(values, float)
    size = 2**depth
    return np.interp(np.arange((len(coarse) - 1) * size + 1) / size, np.arange(len(coarse)), coarse)

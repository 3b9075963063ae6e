"""Where in the plane of two parameters a scenario succeeds, its boundary traced by refining only what is near it.

Source: docs page, Stability maps; R. A. Finkel, J. L. Bentley, "Quad trees: a data structure for retrieval on composite
keys", Acta Informatica 4 (1974), for the tree of cells. The rule by which cells are split is ours.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.grammar import parse_condition
from trimtab.campaign.search.axes import Axis, enlarge_rings, find_quantity, with_values
from trimtab.campaign.statistics.metrics import find_metric, name_option, swing_amplitude
from trimtab.campaign.store.memo import FlightMemo
from trimtab.campaign.workers.block import batch_rows
from trimtab.campaign.workers.prepare import find_signals
from trimtab.core.errors import InputError
from trimtab.core.quantity import split_component
from trimtab.logs.metrics import full_path
from trimtab.loop.scenario import Scenario
from trimtab.run.runner import LEAST_LANE_RUNS
from trimtab.run.simulate import Batch, simulate_batch

Cell = tuple[int, int, int]
"""Lower corner and size, in steps of the finest lattice."""
DEEPEST = 12
Success = Callable[[Batch], Any]
"""The runs of a batch, with its log -> whether each succeeded (n,)."""
SWING = 0.1
"""Most that may go on swinging at a run's end, in parts of a target's band."""
ROWS = 300
"""About as many rows of each run are looked at."""
NUMBERS = 20_000_000
"""At most so many numbers of logs are held at once; larger rounds fly in parts."""
ALL = 100
"""About as many numbers are in a row where all signals are logged."""


class TracedBoundary(NamedTuple):
    """What is known on a lattice of `shape` points, of which only some were looked at.

    index: (n, 2) lattice points, in the order in which they were looked at.  value: (n,), in [0, 1].  call_index: (n,)
    in which call each was made, from 0.  cells: (k, 3) lower corner and size of the cells that tile the lattice.
    threshold: a point is inside where its value is at least that.
    """

    shape: tuple[int, int]
    index: Any
    value: Any
    call_index: Any
    cells: Any
    threshold: float

    @property
    def evaluated_points(self) -> int:
        """How many points were needed."""
        return len(self.index)

    @property
    def of(self) -> int:
        """How many points a full grid of the same resolution has."""
        return self.shape[0] * self.shape[1]

    def grid(self) -> Any:
        """The values on the whole lattice, NaN where nothing was looked at."""
        whole = np.full(self.shape, np.nan)
        whole[self.index[:, 0], self.index[:, 1]] = self.value
        return whole

    def boundary_cells(self) -> Any:
        """The cells through which the boundary passes (k, 3): points both inside and outside on their edges."""
        inside, known = self.grid() >= self.threshold, ~np.isnan(self.grid())
        mixed = [_is_mixed(inside, known, c) for c in self.cells.tolist()]
        return self.cells[np.array(mixed, bool)]

    def crossings(self, line: int, axis: int = 0) -> list[tuple[int, int]]:
        """Pairs of neighbouring known points between which a line along `axis` passes the boundary.

        line: the lattice index on the other axis; one of the coarse grid's, or few of its points are known.
        """
        values = self.grid().take(line, axis=1 - axis)
        known = np.flatnonzero(~np.isnan(values))
        inside = values[known] >= self.threshold
        return [(int(known[i]), int(known[i + 1])) for i in np.flatnonzero(inside[1:] != inside[:-1])]


def trace_boundary(
    values: Callable[[Any], Any], coarse: tuple[int, int], depth: int, *, threshold: float = 0.5
) -> TracedBoundary:
    """Look at a coarse grid, then only at the cells on whose edges there are points both inside and outside.

    Each of `depth` levels halves those cells; all their new points are asked for in one call. Where a new point on an
    edge shows that the boundary runs into the neighbour, the neighbour is split too, in a further call. What lies
    between the points of the coarse grid and touches none of them is not seen.

    Args:
        values: lattice points (k, 2) -> their values (k,).
        coarse: points of the coarse grid along both axes, 2 or more each.
        depth: how often a cell is halved; the lattice has (c - 1) 2^depth + 1 points along an axis.
        threshold: a point is inside where its value is at least that.
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
    """Refuse a coarse grid of less than a cell, and a depth beyond all use."""
    if min(coarse) < 2 or not 0 <= depth <= DEEPEST:
        problem = f"a coarse grid of {coarse[0]} x {coarse[1]} points and depth {depth}"
        fix = f"give 2 points or more along each axis, and a depth of 0 to {DEEPEST}"
        raise InputError("boundary", problem, fix=fix)


def _is_mixed(inside: Any, known: Any, cell: Cell) -> bool:
    """Whether known points on the edges of a cell, in which nothing else is known, lie on both sides."""
    i, j, size = cell
    at = (slice(i, i + size + 1), slice(j, j + size + 1))
    sides = inside[at][known[at]]
    return bool(sides.any() and not sides.all())


def _split_cell(cell: Cell) -> list[Cell]:
    i, j, size = cell
    h = size // 2
    return [(i, j, h), (i + h, j, h), (i, j + h, h), (i + h, j + h, h)]


def _cell_nodes(cell: Cell) -> list[tuple[int, int]]:
    """Middle of a cell and of its edges."""
    i, j, size = cell
    h = size // 2
    return [(i + h, j), (i, j + h), (i + h, j + h), (i + size, j + h), (i + h, j + size)]


def parse_success(scenario: Scenario, texts: Iterable[str]) -> tuple[Success, tuple[str, ...]]:
    """Which runs of a batch meet every condition, (n,), and the signals that must be logged for it.

    Args:
        scenario: what flies.
        texts: conditions, e.g. "error_rms:yaw_rate <= 0.5".

    Raises: InputError for a condition on what the scenario doesn't have.
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
    """Share of successes over the points that were flown.

    scenario: the one that was flown, with its links prepared and its rings long enough.  x, y: the axes.  at_x, at_y:
    values of the whole lattice (nx,), (ny,).  traced_boundary: lattice points, shares and cells.  runs: of each point.
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
        """What was flown, in values of the axes (n, 2)."""
        i, j = self.traced_boundary.index.T
        return np.column_stack([self.at_x[i], self.at_y[j]])

    @property
    def share(self) -> Any:
        """Of successes at each of `sample_points` (n,)."""
        return self.traced_boundary.value

    def crossings(self, y: float) -> list[tuple[float, float]]:
        """Neighbouring values of x between which the boundary passes, along the lattice's line nearest to y."""
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
    """Fly a coarse grid, then halve `depth` times the cells through which the boundary passes.

    All new points of a level fly in one batch. Every point has the same seeds, so that neighbours differ by the
    parameters alone and the boundary of a random scenario is smooth.

    Args:
        scenario: what flies.
        x, y: the axes; the coarse grid has their values.
        runs: of each point.
        depth: how often a cell is halved.
        threshold: the boundary is where the share of successes passes this.
        seed: of a point's first run; the others follow.
        swing: most that may go on swinging at a run's end, in parts of each target's band; not for a `success` given.
        success: which runs of a batch, with its log, succeed; `target_success` where not given.
        signals: what is logged for `success`; the targets' where neither is given.
        log_period: of the rows; a multiple of the autopilot's period with about 300 rows where not given.
        backend, threads: as `simulate_batch`.
        progress: called with the number of points flown since.
        memo: what was flown before, and where to keep it; made for this scenario and success.

    Raises:
        InputError: before anything flies; every point of the coarse grid is checked as a scenario of its own.
    """
    if runs < 1 or not 0 < threshold <= 1:
        problem = f"{runs} runs with threshold {threshold}"
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
    """Flies points. seeds: of each.  numbers: in the log of one run.  used: backends of the batches so far."""

    scenario: Scenario
    seeds: range
    is_success: Success
    numbers: int
    options: dict[str, Any]
    memo: FlightMemo
    used: list[str]

    def share(self, own: dict[str, Any]) -> Any:
        """Share of successes (k,) of k points; own: path -> values (k, …)."""
        points, runs = len(next(iter(own.values()))), len(self.seeds)
        each = max(NUMBERS // max(self.numbers * runs, 1), 1)
        slices = [slice(i, min(i + each, points)) for i in range(0, points, each)]
        ok = [self._fly_runs({path: np.repeat(v[part], runs, axis=0) for path, v in own.items()}) for part in slices]
        return np.concatenate(ok).reshape(points, runs).mean(axis=1)

    def _fly_runs(self, spread: dict[str, Any]) -> Any:
        """Whether each run succeeded (n,), the runs of a point side by side."""
        count = len(next(iter(spread.values())))
        seeds = np.tile(self.seeds, count // len(self.seeds))
        if self.used[:1] == ["c lanes"] and count < LEAST_LANE_RUNS:  # else another program had to be compiled
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
    """Success where each target is inside its band over the last third of a run, and its swing dies away or is small.

    Small: below `swing` times the band, see `statistics.metrics.swing_amplitude`. So a limit cycle inside a band is no
    success. Angles count modulo full turns.
    """
    targets = tuple(scenario.targets)
    if not targets:
        fix = "give the scenario targets=(Target(…),), or a success function of your own"
        raise InputError(f"scenario {scenario.name!r}", "has no targets, so nothing tells success", fix=fix)

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
    """The scenario to fly and the paths that its points differ in; every coarse point is checked."""
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
    """Path -> value at one point, y's changes on top of x's."""
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

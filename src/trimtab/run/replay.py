"""Replay: run an autopilot again with the samples in a log, and compare its outputs with the recorded outputs.

This module also compares two logs of the same run. It finds the first difference of a real number, and the first
difference of an integer or flag.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.compiler.folder import ROUNDINGS
from trimtab.core.errors import InputError, argument
from trimtab.core.explain_call import explain_call
from trimtab.core.record import replace
from trimtab.core.signals import Frame
from trimtab.core.time import format_time, to_seconds
from trimtab.logs.log import Log, check_log, provenance
from trimtab.loop.scenario import Scenario
from trimtab.loop.structure import cast_like, strengthen_types
from trimtab.run.blocks import autopilot_block, message_structures
from trimtab.run.inputs import leaf_paths
from trimtab.run.kept_blocks import compile_kept
from trimtab.run.parameter_changes import AutopilotChange, read_changes, with_changes
from trimtab.run.program import check_seed
from trimtab.run.runner import choose_c
from trimtab.scenarios.recorded import rebuild_scenario

TOLERANCE = 1e-10
"""Tolerance for differences between backends or types of machine, as a fraction of a signal's largest magnitude."""
LOSS_COUNTERS = ("log.dropped", "log.unwritten")
"""Paths of the signals in a flight's log that count the rows that are missing in the log."""


class Divergence(NamedTuple):
    """First difference between two runs: time (s), path of the signal, both values of the differing component."""

    t: float
    path: str
    recorded: float
    replayed: float


class Replay(NamedTuple):
    """Result of a replay.

    recorded_log, replayed_log: compared signals at the control instants.  exact: True if all bits are equal.  strict:
    True if all bits must be equal, because backend and type of machine are those of the recording.  equal: True if the
    required accuracy is reached.  first: first difference that is not accepted, or None.  worst: path of a signal ->
    largest difference, as a fraction of the signal's largest magnitude.  backend: backend of the replay.  end_reason:
    reason why the replay ended before the log, or "".  changed: True if another autopilot was run.
    """

    recorded_log: Log
    replayed_log: Log
    exact: bool
    strict: bool
    equal: bool
    first: Divergence | None
    worst: dict[str, float]
    backend: str
    end_reason: str
    changed: bool


@explain_call()
def replay(log: Log, scenario: Scenario | str | None = None, *, autopilot: Any = None, backend: str = "auto") -> Replay:
    """Run a scenario's autopilot with the samples in a log, and compare the outputs with those in the log.

    >>> from trimtab import replay, simulate
    >>> replay(simulate("hovercraft/spin", duration="100 ms")).exact
    True

    If backend and type of machine are those of the recording, every bit must be equal. Otherwise, results must agree
    within TOLERANCE.

    Args:
        log: log of a flight, or of `simulate` with a row at each control instant. Its signals ``downlink`` are used.
        scenario: recorded scenario, or its name. None: the scenario is rebuilt from the log's metadata.
        autopilot: autopilot with the same sensors to run instead of the recorded one. The samples are still the same.
        backend: "c", "jax" or "auto", as in `simulate`.

    Raises:
        InputError: samples are missing in the log, or the autopilot needs signals that the log does not contain.
    """
    check_log(log, "replay({})")
    if not isinstance(scenario, Scenario):
        scenario = rebuild_scenario(log, scenario)
    scenario.check()
    flown = scenario if autopilot is None else replace(scenario, autopilot=autopilot)
    _refuse_other_sensors(flown)
    flown.check()
    seed, run = (int(log.metadata.get(name, 0)) for name in ("seed", "run"))
    check_seed(seed)
    check_seed(run)
    compiled = choose_c(backend, lambda: compile_kept(autopilot_block, flown, seed=seed, run=run))
    steps = find_steps(log, leaf_paths(message_structures(flown)[0]), flown.autopilot.period)
    changes = read_changes(log) if autopilot is None else []
    if compiled is None:
        outputs = step_jax(autopilot_block(flown, seed=seed, run=run), steps, changes)
    else:
        outputs = step_c(compiled, steps, changes)
    return _compare_outputs(log, steps, outputs, "jax" if compiled is None else "c", changed=autopilot is not None)


def _refuse_other_sensors(flown: Scenario) -> None:
    """Raise InputError if the estimator reads a sensor that the scenario does not have."""
    sent = flown.world.sensors
    if lacking := [sensor for sensor in flown.autopilot.estimator.listens if sensor not in sent]:
        estimator = type(flown.autopilot.estimator).__name__
        problem = f"{estimator} reads sensor {lacking[0]!r}, but the recorded flight has only {', '.join(sent)}"
        fix = f"replay a flight with this sensor, e.g. one with {argument('navigation', 'ins')}"
        raise InputError("replay", problem, fix=fix)


def describe_replay(result: Replay) -> str:
    """Return the result of a replay in one sentence."""
    steps = f"{len(result.recorded_log)} steps"
    if result.changed:
        return f"{steps} repeated with another autopilot"
    if result.exact:
        return f"{steps} repeated, identical bit for bit, by backend {result.backend}"
    if result.first is None:
        return f"{steps} repeated, equal within {TOLERANCE:g}, by backend {result.backend}"
    f = result.first
    return f"differs from {f.t:.7f} s on: {f.path} was {f.recorded!r}, is now {f.replayed!r}, on {result.backend}"


class RecordedSteps(NamedTuple):
    """Successive control steps in a log, beginning with the first control step.

    rows: index of the log row of each step (n,).  ticks: times of the steps (n,), 100 ns.  inputs: inputs of the
    autopilot at each step, float64 (n, width).  end_reason: reason why later steps in the log cannot be repeated, or
    "".
    """

    rows: Any
    ticks: Any
    inputs: Any
    end_reason: str


def find_steps(log: Log, frames: list[str], period: int) -> RecordedSteps:
    """Return the control steps of a log, up to the first missing step.

    Args:
        log: log of a simulation, or log of a flight. In the log of a flight, each row is a control step.
        frames: paths of the autopilot's inputs, ``t`` and ``samples.…``, in order.
        period: time between two control instants (100 ns).

    Raises:
        InputError: the log does not begin with the first control instant, or a signal is missing.
    """
    if not len(log):
        raise InputError("replay", "the log contains no control step", fix="use a log with at least one row")
    rows, reason = _find_flight_steps(log) if LOSS_COUNTERS[0] in log else _find_simulation_steps(log, period)
    if log.metadata.get("truncated") and not reason:
        reason = f"the log was cut off at {log.t[-1]:g} s"
    for gap in log.metadata.get("gaps", ()):
        whole = rows[log.t[rows] <= (-1.0 if gap["after_s"] is None else gap["after_s"])]
        if len(whole) < len(rows):
            rows, reason = whole, f"the log has a gap: {gap['text']}"
    if not len(rows):
        raise InputError(
            "replay", f"the log lacks its first control steps: {reason}", fix="use a log with the first step"
        )
    columns = [np.asarray(_frame_column(log, path)[rows], np.float64).reshape(len(rows), -1) for path in frames]
    return RecordedSteps(rows, log.ticks[rows], np.concatenate(columns, axis=1), reason)


def _frame_column(log: Log, path: str) -> Any:
    if path == "t":
        return log.ticks
    name = "downlink" + path.removeprefix("samples")
    if name not in log:
        problem = f"the log lacks {name!r}, which the autopilot reads"
        fix = "record with all signals, or fly an autopilot that reads only recorded signals"
        sensors = sorted({p.split(".")[1] for p in log.paths if p.startswith("downlink.")})
        raise InputError("replay", problem, choices=sensors, fix=fix)
    return log[name]


def _find_flight_steps(log: Log) -> tuple[Any, str]:
    """Return the row indices of a flight's log up to the first missing row, and the reason why they end there, or "".

    Each row is a control step. Control steps after a missing row can't be repeated.
    """
    missing = np.sum([log[name] for name in LOSS_COUNTERS if name in log], axis=0)
    if missing[0]:
        raise InputError(
            "replay", f"the log lacks its first {missing[0]} steps", fix="use a log that begins with the first step"
        )
    whole = int(np.argmax(missing > 0)) if missing.any() else len(log)
    return np.arange(whole), f"the log lacks steps after {log.t[whole - 1]:g} s" if whole < len(log) else ""


def _find_simulation_steps(log: Log, period: int) -> tuple[Any, str]:
    """Return the index of the log row of each control instant in the log of a simulation, and the text ""."""
    rows = np.flatnonzero(log.ticks % period == 0)
    ticks = log.ticks[rows]
    if log.ticks[0] != 0:
        problem = f"the log begins at {to_seconds(int(log.ticks[0])):g} s, where the autopilot's state is unknown"
        raise InputError("replay", problem, fix="use a log that begins with the start of the run")
    if (np.diff(ticks) != period).any() or (len(rows) == 1 and len(log) > 1):
        usual = int(np.median(np.diff(log.ticks)))
        problem = f"the log has a row every {format_time(usual)}, but the autopilot steps every {format_time(period)}"
        raise InputError("replay", problem, fix=f"record again with {argument('log_period', format_time(period))}")
    return rows, ""


def _changes_by_step(steps: RecordedSteps, changes: Sequence[AutopilotChange]) -> dict[int, list[AutopilotChange]]:
    """Return the index of a control step -> parameter changes that take effect at this step."""
    by_step: dict[int, list[AutopilotChange]] = {}
    for change in changes:
        by_step.setdefault(int(np.searchsorted(steps.ticks, change.t)), []).append(change)
    return by_step


def step_c(step: CompiledBlock, steps: RecordedSteps, changes: Sequence[AutopilotChange] = ()) -> dict[str, Any]:
    """Return the outputs of a compiled block for n recorded steps, path -> values. changes: changes of parameters."""
    rows, by_step = np.empty((len(steps.inputs), len(step.outputs))), _changes_by_step(steps, changes)
    for k, row in enumerate(steps.inputs):
        for change in by_step.get(k, ()):
            change.put_into(step.parameters)
        step.inputs[:] = row
        step.step()
        rows[k] = step.outputs
    return {m.name: rows[:, step.writes[m.name]].reshape(len(rows), *m.shape) for m in step.text.outputs}


def step_jax(block: BlockDefinition, steps: RecordedSteps, changes: Sequence[AutopilotChange] = ()) -> dict[str, Any]:
    """Return the outputs of a block for n recorded steps, as `step_c` does, but computed with JAX."""
    shapes, tree = jax.tree.flatten(block.input)
    columns, at = [], 0
    for leaf in shapes:
        size = int(np.prod(leaf.shape))
        columns.append(steps.inputs[:, at : at + size].reshape(-1, *leaf.shape).astype(leaf.dtype))
        at += size

    @jax.jit
    def fly(parameters: Any, state: Any, frames: Frame) -> Any:
        def body(s: Any, frame: Frame) -> Any:
            after, output = block.step(parameters, s, frame)
            return cast_like(after, s), output

        return jax.lax.scan(body, state, frames)

    state, parameters = strengthen_types(block.init(block.parameters)), block.parameters
    by_step, parts = _changes_by_step(steps, changes), []
    starts = sorted({0, *(k for k in by_step if k < len(steps.inputs))})
    for k, end in zip(starts, [*starts[1:], len(steps.inputs)], strict=True):
        parameters = with_changes(parameters, by_step.get(k, ()))
        state, outputs = fly(parameters, state, jax.tree.unflatten(tree, [column[k:end] for column in columns]))
        parts.append(outputs)
    joined = [np.concatenate(leaves) for leaves in zip(*map(jax.tree.leaves, parts), strict=True)]
    return dict(zip(leaf_paths(parts[0]), joined, strict=True))


def _compare_outputs(log: Log, steps: RecordedSteps, outputs: dict[str, Any], backend: str, *, changed: bool) -> Replay:
    order = ("estimate", "predictor", "law", "supervisor", "monitor", "command")
    paths = sorted(outputs, key=lambda p: order.index(p.partition(".")[0]))
    shared = [p for p in paths if p in log and log[p].shape[1:] == outputs[p].shape[1:]]
    if not shared:
        own = "this is the log of the vehicle; use the log of the autopilot: flight.mcap, written by trimtab fly"
        every = 'log all signals, or signals=("downlink", "estimate", "law", "command")'
        fix = own if log.metadata.get("side") == "vehicle" else every
        raise InputError("replay", "the log contains no outputs of an autopilot", fix=fix)
    ticks, about = log.ticks[steps.rows], {**log.metadata, "backend": backend}
    was = {p: log[p][steps.rows] for p in shared}
    with np.errstate(invalid="ignore"):
        now = {p: outputs[p].astype(log[p].dtype if p in log else outputs[p].dtype) for p in paths}
    declared = {p: d for p, d in log.declarations.items() if p in now}
    recorded = Log(t=to_seconds(ticks), ticks=ticks, signals=was, declarations=declared, metadata=log.metadata)
    replayed = Log(t=to_seconds(ticks), ticks=ticks, signals=now, declarations=declared, metadata=about)
    machine = provenance()["machine"]
    strict = backend == log.metadata.get("backend") and log.metadata.get("machine", machine) == machine
    result = Replay(recorded, replayed, False, strict, True, None, {}, backend, steps.end_reason, changed)
    if changed:
        return result
    same = dataclasses.replace(replayed, signals={p: now[p] for p in shared})
    bit, near = first_bit_difference(recorded, same), compare_logs(recorded, same)
    result = result._replace(exact=bit is None, worst=near.worst)
    if bit is None or (not strict and near.is_equal):
        return result
    return result._replace(equal=False, first=near.number if near.number and not strict else bit)


class Difference(NamedTuple):
    """Result of the comparison of two logs of the same run.

    switch: first difference of an integer or flag, or None. After it, two correct backends may differ, because a
    rounding error has crossed a threshold.  instants: number of instants before this difference.  number: first
    difference of a real number, before `switch`, that exceeds the tolerance, or None.  worst: path of a signal ->
    largest difference before `switch`, as a fraction of the signal's largest magnitude.
    """

    instants: int
    switch: Divergence | None
    number: Divergence | None
    worst: dict[str, float]

    @property
    def is_equal(self) -> bool:
        """Return True if all real numbers agree up to the first difference of an integer or flag."""
        return self.number is None


def compare_logs(one: Log, other: Log, tolerance: float = TOLERANCE) -> Difference:
    """Compare two logs of the same run on two backends or machines. Differences due to rounding are accepted.

    For an exact comparison of two flights, also with different instants, use `logs.difference.find_difference`.

    Args:
        one, other: logs with the same instants and signals.
        tolerance: tolerance for real numbers, as a fraction of the signal's largest magnitude in `one`. A magnitude
            below 1e-3 counts as 1e-3. Differences of up to ROUNDINGS rounding errors of the largest signal in the same
            unit are also accepted, because a signal may be the difference of two large signals.

    Raises:
        InputError: the logs have different instants or different signals.
    """
    if not np.array_equal(one.ticks, other.ticks):
        raise InputError("difference", "the logs have different instants", fix="log both with the same log_period")
    if one.paths != other.paths:
        apart = sorted({*one.paths} ^ {*other.paths})
        raise InputError("difference", f"only one of the logs has {apart[0]!r}", fix="log the same signals")
    real = [p for p in one.paths if one[p].dtype.kind == "f"]
    whole = [p for p in one.paths if p not in real]
    switch = _first_difference(one, other, [(p, _differing_rows(one[p], other[p])) for p in whole], len(one))
    until = len(one) if switch is None else int(np.searchsorted(one.t, switch[0]))
    worst, off, largest = {}, [], _largest_by_unit(one, real)
    for path in real:
        gap = _largest_gap(one[path][:until], other[path][:until])
        size = max(float(np.nanmax(np.abs(one[path]), initial=0.0)), 1e-3)
        worst[path] = float(gap.max(initial=0.0)) / size
        rounding = ROUNDINGS * float(np.spacing(largest[one.unit(path)]))
        off.append((path, gap > max(tolerance * size, rounding)))
    return Difference(until, switch, _first_difference(one, other, off, until), worst)


def _largest_by_unit(log: Log, paths: list[str]) -> dict[str, float]:
    """Return the unit -> largest finite magnitude of all signals with this unit."""
    largest: dict[str, float] = {}
    for path in paths:
        finite = np.abs(log[path][np.isfinite(log[path])])
        largest[log.unit(path)] = max(largest.get(log.unit(path), 0.0), float(finite.max(initial=0.0)))
    return largest


def _largest_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest difference between the components of two signals at each instant. NaN equals only NaN."""
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        gap = np.where(same, 0.0, np.abs(a - b))
    return np.where(np.isnan(gap), np.inf, gap).max(axis=tuple(range(1, a.ndim)), initial=0.0)


def _differing_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a != b).reshape(len(a), -1).any(axis=1)


def _first_difference(one: Log, other: Log, apart: list[tuple[str, np.ndarray]], until: int) -> Divergence | None:
    """Return the first difference between two logs, or None.

    apart: path of each signal, and mask (n,) of the instants at which the signal differs.  until: number of instants
    that are searched. If several signals differ at the same instant, the first in alphabetical order is returned.
    """
    rows = [(int(bad.argmax()), path) for path, bad in apart if bad[:until].any()]
    if not rows:
        return None
    k, path = min(rows)
    a, b = np.ravel(one[path][k]), np.ravel(other[path][k])
    j = int(np.argmax(a != b))
    return Divergence(float(one.t[k]), path, float(a[j]), float(b[j]))


def first_bit_difference(one: Log, other: Log) -> Divergence | None:
    """Return the first difference, bit for bit, between two logs with the same signals, or None.

    Two NaN are equal, because a log does not store the payload bits of a NaN. -0.0 does not equal 0.0.
    """
    firsts: list[tuple[int, int, int]] = []
    for order, path in enumerate(one.paths):
        a, b = (np.atleast_2d(log[path].T).T.reshape(len(log), -1) for log in (one, other))
        if a.dtype.kind == "f":
            apart = ~((a == b) & (np.signbit(a) == np.signbit(b)) | np.isnan(a) & np.isnan(b))
        else:
            apart = a != b
        if apart.any():
            k = int(apart.any(axis=1).argmax())
            firsts.append((k, order, int(apart[k].argmax())))
    if not firsts:
        return None
    k, order, j = min(firsts)
    path = one.paths[order]
    return Divergence(float(one.t[k]), path, float(np.ravel(one[path][k])[j]), float(np.ravel(other[path][k])[j]))

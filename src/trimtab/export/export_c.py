"""export_c: the autopilot of a scenario, or its whole closed loop, as C for a microcontroller, with its own test."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab import __version__
from trimtab.compiler.block import ExportedBlock, export_step
from trimtab.core.errors import InputError
from trimtab.core.record import part, quantity, record, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import Frame
from trimtab.core.time import Clock, timetable, to_seconds
from trimtab.export.folder import SampleVectors, write_folder
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import instant, start
from trimtab.run.simulate import simulate

PARTS = ("autopilot", "loop")
REALS = {"double": "f64", "single": "f32"}
STEPS = 2000


@record
class AutopilotOutput:
    """What an exported autopilot gives at each step. Source: docs page, Export."""

    command: Any = part("For the actuators.")
    estimate: Any = part("What the estimator makes of the frame.")
    law: Any = part("Output of the law.")
    supervisor: Any = part("What the supervisor says; nothing without one.", default=())


@record
class LoopInput:
    """What an exported closed loop is given at each step. Source: docs page, Export."""

    t: Any = quantity("100 ns", "Now.", kind="time")
    h: Any = quantity("100 ns", "Time to the next instant.", kind="time")


@record
class LoopParameters:
    """Parameters of an exported closed loop. Source: docs page, Export."""

    world: Any = part("Vehicle, sensors, links and actuators.")
    autopilot: Any = part("What flies it.")
    initial: Any = part("First state of the vehicle.")
    key: Any = part("Seed and run of the random numbers.")


class ExportedFolder(NamedTuple):
    """What was exported, and the files."""

    exported: ExportedBlock
    files: list[Path]


def export_c(
    scenario: Scenario,
    folder: Path,
    *,
    part: str = "autopilot",
    real: str = "double",
    steps: int = STEPS,
    seed: int = 0,
    name: str | None = None,
) -> ExportedFolder:
    """Write a scenario's autopilot, or its whole closed loop, as C99 into a folder.

    Args:
        scenario: checked whole before anything is written.
        folder: made where it is missing.
        part: "autopilot": frames in, commands out; "loop": World and Autopilot, time in, signals out.
        real: "double" or "single", the type of real numbers in the C text.
        steps: how many steps of a simulated run are put beside it as test vectors.
        seed: of that run.
        name: before every name in the text; "autopilot" or "loop" when None.

    Raises:
        InputError: a scenario that can't be flown, a primitive without C text, a folder that can't be written.
    """
    if part not in PARTS:
        raise InputError("export", f"part {part!r} is not one", choices=PARTS, fix="--part autopilot")
    if real not in REALS:
        raise InputError("export", f"{real!r} is no type of numbers", choices=REALS, fix="--float double")
    if steps < 1:
        raise InputError("export", f"{steps} steps are too few", fix=f"--steps {STEPS}")
    scenario.check()
    make = _export_autopilot if part == "autopilot" else _export_loop
    made, vectors, period = make(scenario, name or part, REALS[real], steps, seed)
    about = {
        "scenario": scenario.name,
        "part": part,
        "seed": seed,
        "period_s": to_seconds(period),
        "version": __version__,
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = write_folder(folder, made, vectors, about, REALS[real])
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError("--out", problem, fix="--out with a folder of yours, e.g. --out autopilot") from None
    return ExportedFolder(made, files)


class AutopilotBlock(NamedTuple):
    """An exported autopilot: its text, and the paths of its inputs and outputs as the log names them."""

    exported: ExportedBlock
    inputs: list[str]
    outputs: list[str]


def autopilot_step(scenario: Scenario, name: str, real: str, seed: int, run: int = 0) -> AutopilotBlock:
    """The text of a checked scenario's autopilot. real: "f64" or "f32"; seed, run: of its first state."""
    world, autopilot, x = to_arrays(scenario.world), to_arrays(scenario.autopilot), to_arrays(scenario.initial)
    key = Key(np.uint32(seed), np.uint32(run))
    state = jax.eval_shape(lambda: start(world, autopilot, x, key)[0])
    frame = Frame(t=jax.ShapeDtypeStruct((), np.int64), samples=state.received)
    zero = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), frame)
    always = frozenset([autopilot.period])

    def init(p: Any) -> Any:
        return p.drop_derived_outputs(p.init(key.at("autopilot"), zero), always)

    def step(p: Any, s: Any, given: Frame) -> Any:
        after, command = p.step(given.t, s, given)
        return p.drop_derived_outputs(after, always), AutopilotOutput(
            command, after.estimate, after.output, after.supervised
        )

    doc = f"Autopilot of {scenario.name}: one step every {to_seconds(autopilot.period) * 1e3:g} ms."
    made = export_step(name, doc, autopilot, init, step, frame, real)
    return AutopilotBlock(made, leaf_paths(frame), leaf_paths(_output_structure(init, step, autopilot, frame)))


def _export_autopilot(
    scenario: Scenario, name: str, real: str, steps: int, seed: int
) -> tuple[ExportedBlock, SampleVectors, int]:
    made, inputs, outputs = autopilot_step(scenario, name, real, seed)
    period = scenario.autopilot.period
    log = simulate(
        scenario,
        seed=seed,
        duration=min(scenario.duration, steps * period),
        log_period=period,
        signals=("downlink", "command", "estimate", "law", *(["supervisor"] if scenario.autopilot.supervisor else [])),
        backend="jax",
    )
    vectors = SampleVectors(
        _stack_columns([_frame_column(p, log) for p in inputs]), _stack_columns([log[p] for p in outputs])
    )
    return made, vectors, period


def _output_structure(init: Any, step: Any, params: Any, given: Any) -> Any:
    return jax.eval_shape(lambda p, g: step(p, init(p), g)[1], params, given)


def _frame_column(path: str, log: Log) -> Any:
    return log.ticks if path == "t" else log["downlink" + path.removeprefix("samples")]


def _export_loop(
    scenario: Scenario, name: str, real: str, steps: int, seed: int
) -> tuple[ExportedBlock, SampleVectors, int]:
    world, autopilot, x = to_arrays(scenario.world), to_arrays(scenario.autopilot), to_arrays(scenario.initial)
    whole = LoopParameters(world=world, autopilot=autopilot, initial=x, key=Key(np.uint32(seed), np.uint32(0)))
    table = timetable([*world.periods(), autopilot.period], scenario.duration, world.max_step)
    always = table.always

    def lean(p: Any, s: Any, a: Any) -> Any:
        return p.world.drop_derived_outputs(s, always), p.autopilot.drop_derived_outputs(a, always)

    def init(p: Any) -> Any:
        return lean(p, *start(p.world, p.autopilot, p.initial, p.key))

    def step(p: Any, state: Any, given: LoopInput) -> Any:
        s, a, seen = instant(p.world, p.autopilot, Clock(given.t, always), given.h, *state)
        after = jax.tree.map(lambda new, old: jax.numpy.asarray(new, old.dtype), lean(p, s, a), state)
        return after, seen

    doc = f"Closed loop of {scenario.name}: world and autopilot, one step an instant."
    given = LoopInput(t=np.int64(0), h=np.int64(0))
    made = export_step(name, doc, whole, init, step, given, real)
    count = min(steps, len(table.t))
    duration = int(table.t[count - 1] + table.h[count - 1])
    log = simulate(scenario, seed=seed, duration=duration, log_period=1, backend="jax")
    if not np.array_equal(log.ticks, table.t[:count]):
        raise InputError("export", "its instants differ when it is cut short", fix=f"--steps {len(table.t)}")
    columns = [log[path] for path in leaf_paths(_output_structure(init, step, whole, given))]
    return (
        made,
        SampleVectors(_stack_columns([table.t[:count], table.h[:count]]), _stack_columns(columns)),
        int(table.h[0]),
    )


def leaf_paths(tree: Any) -> list[str]:
    """Dotted paths of the leaves, in the order of JAX, as the log names them."""
    found = []
    for keys, _ in jax.tree_util.tree_flatten_with_path(tree)[0]:
        found.append(".".join(str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", "")))) for k in keys))
    return found


def _stack_columns(columns: list[Any]) -> Any:
    """Arrays (n, …) side by side as float64 (n, numbers)."""
    return np.concatenate([np.asarray(c, np.float64).reshape(len(c), -1) for c in columns], axis=1)

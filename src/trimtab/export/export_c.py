"""export_c: the autopilot of a scenario, or its whole closed loop, as C for a microcontroller, with its own test.

The samples that the folder is tested with are steps of a simulated run.
"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import __version__
from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.compiler.folder import ExportedFolder, SampleVectors, write_folder
from trimtab.core.errors import InputError
from trimtab.core.time import timetable, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import autopilot_block, loop_block
from trimtab.run.simulate import simulate

PARTS = ("autopilot", "loop")
REALS = {"double": "f64", "single": "f32"}
STEPS = 2000


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
    definition, log, column, period = make(scenario, steps, seed)
    block = block_text(definition._replace(name=name or part), REALS[real])
    vectors = SampleVectors(
        inputs=_stack_columns([column(m.name) for m in block.inputs]),
        outputs=_stack_columns([log[m.name] for m in block.outputs]),
    )
    about = {
        "scenario": scenario.name,
        "part": part,
        "seed": seed,
        "period_s": to_seconds(period),
        "version": __version__,
    }
    return ExportedFolder(block, write_folder(folder, block, vectors, about, REALS[real]))


def _export_autopilot(scenario: Scenario, steps: int, seed: int) -> tuple[BlockDefinition, Log, Any, int]:
    """The block, a log of what it gave, the columns of its inputs by path, and its period."""
    period = scenario.autopilot.period
    log = simulate(
        scenario,
        seed=seed,
        duration=min(scenario.duration, steps * period),
        log_period=period,
        signals=("downlink", "command", "estimate", "law", *(["supervisor"] if scenario.autopilot.supervisor else [])),
        backend="jax",
    )

    def column(path: str) -> Any:
        return log.ticks if path == "t" else log["downlink" + path.removeprefix("samples")]

    return autopilot_block(scenario, seed=seed), log, column, period


def _export_loop(scenario: Scenario, steps: int, seed: int) -> tuple[BlockDefinition, Log, Any, int]:
    """The same of the closed loop."""
    table = timetable(
        [*scenario.world.periods(), scenario.autopilot.period], scenario.duration, scenario.world.max_step
    )
    count = min(steps, len(table.t))
    duration = int(table.t[count - 1] + table.h[count - 1])
    log = simulate(scenario, seed=seed, duration=duration, log_period=1, backend="jax")
    if not np.array_equal(log.ticks, table.t[:count]):
        raise InputError("export", "its instants differ when it is cut short", fix=f"--steps {len(table.t)}")
    columns = {"t": table.t[:count], "h": table.h[:count]}
    return loop_block(scenario, table.always, seed=seed), log, columns.__getitem__, int(table.h[0])


def _stack_columns(columns: list[Any]) -> Any:
    """Arrays (n, …) side by side as float64 (n, numbers)."""
    return np.concatenate([np.asarray(c, np.float64).reshape(len(c), -1) for c in columns], axis=1)

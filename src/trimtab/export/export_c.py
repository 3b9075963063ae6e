"""Export of a scenario's autopilot, or of the complete closed loop, as C code for a microcontroller, with a test of
this code.

The test data are inputs and outputs of a simulated run.
"""

from pathlib import Path
from typing import Any

import numpy as np

from trimtab import __version__
from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.compiler.folder import ExportedFolder, SampleVectors, exact_numbers, write_folder
from trimtab.core.errors import InputError, argument
from trimtab.core.explain_call import explain_call
from trimtab.core.time import timetable, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.loop.walk import logged_signals
from trimtab.run.blocks import autopilot_block, loop_block
from trimtab.run.inputs import leaf_paths, run_inputs
from trimtab.run.simulate import simulate
from trimtab.run.walk_structure import signal_structure
from trimtab.scenarios.build import find_scenario

PARTS = ("autopilot", "loop")
REALS = {"double": "f64", "single": "f32"}
STEPS = 2000
OPTIONAL = ("supervisor", "predictor", "monitor")
"""Names of the optional parts of an autopilot whose outputs are logged."""


@explain_call()
def export_c(
    scenario: Scenario | str,
    folder: str | Path,
    *,
    part: str = "autopilot",
    real: str = "double",
    steps: int = STEPS,
    seed: int = 0,
    name: str | None = None,
) -> ExportedFolder:
    """Write a scenario's autopilot, or the complete closed loop, as C99 code into a folder.

    >>> import tempfile
    >>> from trimtab import export_c
    >>> exported = export_c("hovercraft/spin", tempfile.mkdtemp(), steps=10)
    >>> "autopilot.c" in {file.name for file in exported.files}
    True

    Args:
        scenario: a scenario, or the name of a scenario. It is checked completely before any file is written.
        folder: folder for the files. It is created if it does not exist.
        part: "autopilot" or "loop". The input of the autopilot's code is a frame of samples, and the output is a
            command. The loop contains world and autopilot. The input of the loop's code is the time, and the outputs
            are all signals.
        real: type of real numbers in the C code, "double" or "single".
        steps: number of steps of a simulated run to write as test vectors.
        seed: seed of that run.
        name: prefix of every name in the C code, or None to use the name of the part.

    Raises:
        InputError: the scenario cannot be flown, a primitive cannot be written as C, or the folder cannot be written.
    """
    if part not in PARTS:
        raise InputError("export", f"unknown part {part!r}", choices=PARTS, fix=argument("part", "autopilot"))
    if real not in REALS:
        raise InputError(
            "export", f"unknown type of real numbers {real!r}", choices=REALS, fix=argument("float", "double")
        )
    if steps < 1:
        raise InputError("export", f"steps must be at least 1, got {steps}", fix=argument("steps", STEPS))
    scenario, folder = find_scenario(scenario), Path(folder)
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
    """Return the autopilot's block, a log of its inputs and outputs, a function from the path of an input to its
    values, and the control period."""
    optional = [name for name in OPTIONAL if getattr(scenario.autopilot, name) is not None]
    period, block = scenario.autopilot.period, autopilot_block(scenario, seed=seed)
    logged = {path for path, _, _ in logged_signals(signal_structure(run_inputs(scenario)))}
    unknown = [p for p in leaf_paths(block.input) if p != "t" and "downlink" + p.removeprefix("samples") not in logged]
    if unknown:
        problem = f"the autopilot reads {unknown[0]!r}, which is not logged, so the exported folder could not be tested"
        fix = "export the autopilot of one craft:  trimtab export FILE.py:function  (docs page, Swarms)"
        raise InputError(f"export {scenario.name!r}", problem, fix=fix)
    log = simulate(
        scenario,
        seed=seed,
        duration=min(scenario.duration, steps * period),
        log_period=period,
        signals=("downlink", "command", "estimate", "law", *optional),
        backend="jax",
    )

    def column(path: str) -> Any:
        return log.ticks if path == "t" else log["downlink" + path.removeprefix("samples")]

    return block, log, column, period


def _export_loop(scenario: Scenario, steps: int, seed: int) -> tuple[BlockDefinition, Log, Any, int]:
    """Return the block of the closed loop, a log of its outputs, a function from the path of an input to its values,
    and the period."""
    table = timetable(
        [*scenario.world.periods(), scenario.autopilot.period], scenario.duration, scenario.world.max_step
    )
    count = min(steps, len(table.t))
    duration = int(table.t[count - 1] + table.h[count - 1])
    log = simulate(scenario, seed=seed, duration=duration, log_period=1, backend="jax")
    if not np.array_equal(log.ticks, table.t[:count]):
        raise InputError(
            "export",
            "the integration steps of a shortened run differ from those of the complete run",
            fix=argument("steps", len(table.t)),
        )
    columns = {"t": table.t[:count], "h": table.h[:count]}
    return loop_block(scenario, table.always, seed=seed), log, columns.__getitem__, int(table.h[0])


def _stack_columns(columns: list[Any]) -> Any:
    """Return one array of shape (n, number of columns) that contains the given arrays of shape (n, …) side by side."""
    return np.concatenate([exact_numbers(c).reshape(len(c), -1) for c in columns], axis=1)

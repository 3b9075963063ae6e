"""export_c: the autopilot of a scenario, or its whole closed loop, as C for a microcontroller, with its own test.

The folder that `trimtab export` writes: C, a test that anybody can run, and the samples that it is tested with.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trimtab import __version__
from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.structs import Member, row_declarations, row_functions
from trimtab.core.errors import InputError
from trimtab.core.time import timetable, to_seconds
from trimtab.logs.log import Log
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import autopilot_block, loop_block
from trimtab.run.simulate import simulate

TOLERANCE = {"f64": 1e-9, "f32": 2e-4}
"""Of each output, as a part of its largest size in the vectors; the least that is told apart is TOLERANCE too."""


class SampleVectors(NamedTuple):
    """Steps of a simulated run: inputs (n, VECTORS_IN) and outputs (n, VECTORS_OUT), every number as float64."""

    inputs: Any
    outputs: Any


def write_folder(
    folder: Path, block: BlockText, vectors: SampleVectors, about: dict[str, Any], real: str
) -> list[Path]:
    """Write all files; gives their paths. The folder is there and can be written."""
    names = [f"in.{n}" for n in column_names(block.inputs)] + [f"out.{n}" for n in column_names(block.outputs)]
    rows = np.concatenate([vectors.inputs, vectors.outputs], axis=1)
    lines = [",".join(names), *(",".join(_format_number(x) for x in row) for row in rows)]
    tolerance = tolerances(block.outputs, vectors.outputs, real)
    manifest = about | {
        "name": block.name,
        "real": "single" if real == "f32" else "double",
        "steps": len(rows),
        "inputs": column_names(block.inputs),
        "outputs": column_names(block.outputs),
        "tolerance": dict(zip(column_names(block.outputs), tolerance, strict=True)),
    }
    texts = {
        f"{block.name}.h": block.header,
        f"{block.name}.c": block.source,
        "vectors.h": _vectors_header(block),
        "vectors.c": "\n".join(
            [LICENCE_NOTE, '#include "vectors.h"\n', row_functions(block.name, block.inputs, block.outputs)]
        ),
        "vectors.csv": "\n".join(lines) + "\n",
        "replay.c": _replay_source(block),
        "CMakeLists.txt": CMAKE.replace("NAME", block.name),
        "export.json": json.dumps(manifest, indent=1) + "\n",
        "README.md": _readme_text(block, manifest),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def column_names(members: list[Member]) -> list[str]:
    """One name for each number: a path, with the index of an element of an array."""
    return [m.path if not m.shape else f"{m.path}[{k}]" for m in members for k in range(m.size)]


def tolerances(members: list[Member], outputs: Any, real: str) -> list[float]:
    """How far each output may be from the simulated one; whole numbers and truth values not at all."""
    found, k = [], 0
    for m in members:
        for _ in range(m.size):
            size = float(np.nanmax(np.abs(outputs[:, k]), initial=0.0))
            found.append(TOLERANCE[real] * max(size, 1e-3) if m.dtype[0] == "f" else 0.0)
            k += 1
    return found


def _format_number(x: float) -> str:
    return f"{x:.17g}"


def _vectors_header(block: BlockText) -> str:
    return "\n".join(
        [
            LICENCE_NOTE,
            "/* Rows of vectors.csv as structs: the inputs, then the outputs; every number as double. */",
            "#ifndef VECTORS_H\n#define VECTORS_H\n",
            f'#include "{block.name}.h"\n',
            row_declarations(block.name, block.inputs, block.outputs),
            "#endif\n",
        ]
    )


def _replay_source(block: BlockText) -> str:
    n = block.name
    return f"""{LICENCE_NOTE}
/* Flies the inputs of vectors.csv, as a program of yours would fly what its sensors say, and prints the outputs.
 *
 *     ./replay vectors.csv > outputs.csv
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{n}.h"
#include "vectors.h"

static char line[{32 * (len(column_names(block.inputs)) + len(column_names(block.outputs))) + 4096}];

int main(int count, char **arguments)
{{
    static {n}_params params;
    static {n}_state state;
    static {n}_in in;
    static {n}_out out;
    double inputs[VECTORS_IN], outputs[VECTORS_OUT];
    FILE *file = fopen(count > 1 ? arguments[1] : "vectors.csv", "r");
    if (!file || !fgets(line, sizeof line, file)) {{
        fprintf(stderr, "cannot read vectors.csv: give its path\\n");
        return 2;
    }}
    {n}_defaults(&params);
    {n}_init(&params, &state);
    memset(&in, 0, sizeof in);
    while (fgets(line, sizeof line, file)) {{
        char *at = line;
        for (int i = 0; i < VECTORS_IN; i++, at++)
            inputs[i] = strtod(at, &at);
        vectors_set_in(inputs, &in);
        {n}_step(&params, &state, &in, &out);
        vectors_get_out(&out, outputs);
        for (int i = 0; i < VECTORS_OUT; i++)
            printf("%.17g%c", outputs[i], i + 1 < VECTORS_OUT ? ',' : '\\n');
    }}
    fclose(file);
    return 0;
}}
"""


CMAKE = """cmake_minimum_required(VERSION 3.13)
project(NAME C)
set(CMAKE_C_STANDARD 99)
# Exact results need these: no fused multiply-adds of the compiler's own, integers that wrap.
add_compile_options(-ffp-contract=off -fwrapv -fno-math-errno)
add_library(NAME STATIC NAME.c)
target_include_directories(NAME PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
add_executable(replay replay.c vectors.c)
target_link_libraries(replay NAME m)
enable_testing()
add_test(NAME replay COMMAND replay ${CMAKE_CURRENT_SOURCE_DIR}/vectors.csv)
"""


def _readme_text(block: BlockText, about: dict[str, Any]) -> str:
    n, real = block.name, about["real"]
    return f"""# {about["scenario"]}: {about["part"]} as C

`{n}.h` and `{n}.c` are all that a vehicle needs: C99, {real} precision, no memory allocation, no variables outside
the structs that you hand over, no recursion. This text may be used under any licence, or none.

```c
{n}_params p; {n}_state s; {n}_in in; {n}_out out;
{n}_defaults(&p);              /* the scenario's parameters; change p.… as you like */
{n}_init(&p, &s);
for (;;) {{                     /* every {about["period_s"] * 1e3:g} ms */
    /* fill in.…: see the comments in {n}.h */
    {n}_step(&p, &s, &in, &out);
}}
```

Compile with `-ffp-contract=off -fwrapv`, so that it computes what the simulation computed.

| file | what it is |
|---|---|
| `vectors.csv` | {about["steps"]} steps of a simulated run: inputs, then the outputs that belong to them |
| `vectors.h`, `vectors.c` | its rows as structs |
| `replay.c` | an example: flies the inputs, prints the outputs |
| `CMakeLists.txt` | builds the library and the example |
| `export.json` | scenario, names, and how far each output may be from the simulated one |

Check it:   `trimtab export --verify .`
By hand:    `cc -std=c99 -ffp-contract=off -fwrapv {n}.c vectors.c replay.c -o replay -lm && ./replay vectors.csv`
"""


PARTS = ("autopilot", "loop")
REALS = {"double": "f64", "single": "f32"}
STEPS = 2000


class ExportedFolder(NamedTuple):
    """What was exported, and the files."""

    block: BlockText
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = write_folder(folder, block, vectors, about, REALS[real])
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError("--out", problem, fix="--out with a folder of yours, e.g. --out autopilot") from None
    return ExportedFolder(block, files)


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

"""Export folder of a block: its C text, a test program, and the data of the test."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab import __version__
from trimtab.compiler.block import BlockDefinition, BlockText, block_text
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.ir import TYPES
from trimtab.compiler.structs import Member, row_declarations, row_functions
from trimtab.core.errors import InputError, argument, argument_name

TOLERANCE = {"f64": 1e-9, "f32": 2e-4}
"""Tolerance of each output, relative to the output's largest magnitude in the test vectors, or to 1e-3 if that is
larger."""

ROUNDINGS = 8
"""Tolerance of a signal, in rounding steps (ulp) of the largest signal in the same unit. For example, an altitude error
of 0.01 ft at 85 000 ft is no more exact than the altitude. The largest difference in the hypersonic climb was 5 steps,
in 100 runs of one second and 6 complete runs."""


class SampleVectors(NamedTuple):
    """Steps of a simulated run: inputs (n, VECTORS_IN) and outputs (n, VECTORS_OUT).

    The arrays are of float64, or of Python numbers, which store 64-bit integers exactly (`exact_numbers`).
    """

    inputs: Any
    outputs: Any


class ExportedFolder(NamedTuple):
    """Exported block, and the paths of the files written."""

    block: BlockText
    files: list[Path]


def write_folder(
    folder: Path, block: BlockText, vectors: SampleVectors, about: dict[str, Any], real: str
) -> list[Path]:
    """Write all files of an export and return their paths. The folder is created if it is missing.

    Raises InputError if the folder cannot be written.
    """
    names = [f"in.{n}" for n in column_names(block.inputs)] + [f"out.{n}" for n in column_names(block.outputs)]
    rows = np.concatenate([vectors.inputs, vectors.outputs], axis=1)
    lines = [",".join(names), *(",".join(_format_number(x) for x in row) for row in rows)]
    tolerance = tolerances(block.outputs, vectors.outputs)
    manifest = about | {
        "name": block.name,
        "real": "single" if real == "f32" else "double",
        "steps": len(rows),
        **({"workspace_bytes": block.workspace} if block.workspace else {}),
        **({"frame_bytes": block.frame} if block.frame else {}),
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        out = argument_name("out")
        fix = f"{out} with a folder that you can write to, e.g. {argument('out', 'autopilot')}"
        raise InputError(out, problem, fix=fix) from None
    return [folder / name for name in texts]


def column_names(members: list[Member]) -> list[str]:
    """Return a column name for each number: its path, with the index if it is an element of an array."""
    return [m.path if not m.shape else f"{m.path}[{k}]" for m in members for k in range(m.size)]


def exact_numbers(array: Any) -> Any:
    """Return the array with Python numbers, as they are written to vectors.csv."""
    return np.asarray(array).astype(object)


def tolerances(members: list[Member], outputs: Any) -> list[float]:
    """Return the tolerance of each output compared with the simulated output. Integers and truth values must be equal.

    The elements of an array are one signal and have the same tolerance. A signal may differ by ROUNDINGS rounding steps
    of the largest signal in the same unit, as in the comparison of logs (`run.replay`).
    """
    sizes, k = [], 0
    for m in members:
        column = np.abs(np.asarray(outputs[:, k : k + m.size], np.float64))
        sizes.append(float(column[np.isfinite(column)].max(initial=0.0)))
        k += m.size
    units = [m.declaration.unit if m.declaration is not None else "" for m in members]
    each = []
    for m, size, unit in zip(members, sizes, units, strict=True):
        if m.dtype not in TOLERANCE:
            each += [0.0] * m.size
            continue
        largest = max(s for s, u in zip(sizes, units, strict=True) if u == unit)
        off = max(TOLERANCE[m.dtype] * max(size, 1e-3), ROUNDINGS * float(np.spacing(TYPES[m.dtype](largest))))
        each += [off] * m.size
    return each


def _format_number(x: Any) -> str:
    return str(int(x)) if isinstance(x, int) else f"{x:.17g}"


def _vectors_header(block: BlockText) -> str:
    return "\n".join(
        [
            LICENCE_NOTE,
            "/* Conversion of rows of vectors.csv, with every number as double, to and from structs. */",
            "#ifndef VECTORS_H\n#define VECTORS_H\n",
            f'#include "{block.name}.h"\n',
            row_declarations(block.name, block.inputs, block.outputs),
            "#endif\n",
        ]
    )


def _replay_source(block: BlockText) -> str:
    n = block.name
    kinds = ("in", "out") if block.is_function else ("params", "state", "in", "out")
    lines = [f"    static {n}_{kind} {kind};" for kind in kinds]
    more = ""
    if block.workspace:
        lines.append(f"    static char memory[{block.workspace} + 64];")
        lines.append("    void *workspace = memory + (64 - (uintptr_t)memory % 64) % 64;")
        more = ", workspace"
    declarations = "\n".join(lines)
    begin = "" if block.is_function else f"    {n}_defaults(&params);\n    {n}_init(&params, &state{more});\n"
    step = block.call("&params", "&state", "&in", "&out", "workspace")
    return f"""{LICENCE_NOTE}
/* Runs the block with the inputs of vectors.csv and prints the outputs. Your program does the same with sensor data.
 *
 *     ./replay vectors.csv > outputs.csv
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{n}.h"
#include "vectors.h"

static char line[{32 * (len(column_names(block.inputs)) + len(column_names(block.outputs))) + 4096}];
static char *cells[VECTORS_IN + 1];
static double inputs[VECTORS_IN + 1], outputs[VECTORS_OUT + 1];
{_row_texts(block)}
int main(int count, char **arguments)
{{
{declarations}
    FILE *file = fopen(count > 1 ? arguments[1] : "vectors.csv", "r");
    if (!file || !fgets(line, sizeof line, file)) {{
        fprintf(stderr, "cannot read vectors.csv: give its path\\n");
        return 2;
    }}
{begin}    memset(&in, 0, sizeof in);
    while (fgets(line, sizeof line, file)) {{
        char *at = line;
        for (int32_t i = 0; i < VECTORS_IN; i++, at++) {{
            cells[i] = at;
            inputs[i] = strtod(at, &at);
        }}
        set_inputs(&in);
        {step}
        vectors_get_out(&out, outputs);
        print_outputs(&out);
    }}
    fclose(file);
    return 0;
}}
"""


WIDE = {"i64": ("(int64_t)strtoll", "PRId64"), "u64": ("(uint64_t)strtoull", "PRIu64")}
"""Integer types too wide for a double -> C function that reads such a number from text, C format that prints it."""


def _row_texts(block: BlockText) -> str:
    """Return C functions that set the inputs from a row of text, and print the outputs as a row of text.

    64-bit integers are read and printed exactly."""
    clear, read, k = [], [], 0
    for m in block.inputs:
        if m.dtype in WIDE:
            parse = WIDE[m.dtype][0]
            loop = f"    for (int32_t i = 0; i < {m.size}; i++) "
            at = m.at("in->", "i")
            clear.append(f"{loop}inputs[{k} + i] = 0.0;")
            read.append(f"{loop}{at} = {parse}(cells[{k} + i], NULL, 10);")
        k += m.size
    lines, start, k = list[str](), 0, 0
    for m in block.outputs:
        if m.dtype in WIDE:
            lines.append(f"    print_numbers({start}, {k});")
            text = f'printf("%s%" {WIDE[m.dtype][1]}, {k} + i ? "," : "", {m.at("out->", "i")});'
            lines.append(f"    for (int32_t i = 0; i < {m.size}; i++) {text}")
            start = k + m.size
        k += m.size
    lines.append(f"    print_numbers({start}, {k});")
    n, set_in = block.name, ["    vectors_set_in(inputs, in);"]
    return "\n".join(
        [
            f"\nstatic void set_inputs({n}_in *in)\n{{",
            *[*clear, *set_in, *read],
            "}\n\nstatic void print_numbers(int32_t from, int32_t to)\n{",
            "    for (int32_t i = from; i < to; i++)",
            '        printf("%s%.17g", i ? "," : "", outputs[i]);',
            f"}}\n\nstatic void print_outputs(const {n}_out *out)\n{{",
            "    (void)out;",
            *lines,
            "    putchar('\\n');\n}\n",
        ]
    )


CMAKE = """cmake_minimum_required(VERSION 3.13)
project(NAME C)
set(CMAKE_C_STANDARD 99)
# Exact results need these flags: the compiler must not fuse products and sums, also in vectorised code; integers wrap.
add_compile_options(-ffp-contract=off -fno-tree-slp-vectorize -fwrapv -fno-math-errno)
add_library(NAME STATIC NAME.c)
target_include_directories(NAME PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
add_executable(replay replay.c vectors.c)
target_link_libraries(replay NAME m)
enable_testing()
add_test(NAME replay COMMAND replay ${CMAKE_CURRENT_SOURCE_DIR}/vectors.csv)
"""


def _readme_text(block: BlockText, about: dict[str, Any]) -> str:
    n, real = block.name, about["real"]
    more = ", workspace" if block.workspace else ""
    space = (
        f"static char workspace[{n.upper()}_WORKSPACE];  /* aligned to 64; not kept between calls */\n" if more else ""
    )
    if block.is_function:
        title, samples = f"{n} as C", f"{about['steps']} rows: the arguments, then the results of JAX"
        use = f"{n}_in in; {n}_out out;\n{space}/* fill in.…: see the comments in {n}.h */\n{n}(&in, &out{more});\n"
        flags, listed = "what JAX computes", "names, and the tolerance of each output against that of JAX"
    else:
        title = f"{about['scenario']}: {about['part']} as C"
        samples = f"{about['steps']} steps of a simulated run: the inputs of each step, then its outputs"
        use = f"""{n}_params p; {n}_state s; {n}_in in; {n}_out out;
{space}{n}_defaults(&p);              /* the scenario's parameters; change p.… as you like */
{n}_init(&p, &s{more});
for (;;) {{                     /* every {about["period_s"] * 1e3:g} ms */
    /* fill in.…: see the comments in {n}.h */
    {n}_step(&p, &s, &in, &out{more});
}}
"""
        flags = "what the simulation computed"
        listed = "scenario, names, and the tolerance of each output against the simulated one"
    return f"""# {title}

A vehicle needs only `{n}.h` and `{n}.c`: C99, {real} precision, no memory allocation, no variables outside the structs
that you pass, no recursion. This text may be used under any licence, or none.

```c
{use}```

Compile with `-ffp-contract=off -fno-tree-slp-vectorize -fwrapv`, so that it computes {flags}.

| file | content |
|---|---|
| `vectors.csv` | {samples} |
| `vectors.h`, `vectors.c` | conversion of its rows to and from structs |
| `replay.c` | an example: reads the inputs, prints the outputs |
| `CMakeLists.txt` | builds the library and the example |
| `export.json` | {listed} |

Check it:   `trimtab export --verify .`
By hand:    `cc -std=c99 -ffp-contract=off -fno-tree-slp-vectorize -fwrapv {n}.c vectors.c replay.c -o replay -lm`,
            then `./replay vectors.csv`
"""


SAMPLES = 8
"""Number of rows in the test of an exported function."""


def export_function(
    folder: Path, block: BlockDefinition, function: Callable[..., Any], example: tuple[Any, ...]
) -> ExportedFolder:
    """Write a function as C, with a test that uses the example's arguments and others near them.

    Args:
        folder: folder of the files; created if it is missing.
        block: the function as a block.
        function: the function in JAX.
        example: example arguments of the function.

    Raises:
        InputError: if a JAX primitive cannot be written as C, or the folder cannot be written.
    """
    text = block_text(block)
    rng = np.random.default_rng(1)

    def near(value: Any) -> Any:
        value = np.asarray(value)
        return value * rng.uniform(0.9, 1.1, value.shape).astype(value.dtype) if value.dtype.kind == "f" else value

    compiled = jax.jit(function)
    inputs, outputs = [], []
    names = list(block.input)
    for k in range(SAMPLES):
        arguments = example if k == 0 else jax.tree.map(near, example)
        inputs.append(_row(dict(zip(names, arguments, strict=True))))
        with jax.enable_x64(True):
            outputs.append(_row(compiled(*arguments)))
    files = write_folder(
        folder, text, SampleVectors(np.array(inputs), np.array(outputs)), {"version": __version__}, "f64"
    )
    return ExportedFolder(text, files)


def _row(tree: Any) -> Any:
    """Return all numbers of a tree in one flat array."""
    return np.concatenate([np.zeros(0, object), *(exact_numbers(v).ravel() for v in jax.tree.leaves(tree))])

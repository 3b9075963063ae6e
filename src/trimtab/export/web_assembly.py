"""Export of a closed loop as WebAssembly: the exported C, compiled for a browser, and a page with parameter sliders.

The WebAssembly program needs no other module and has one set of parameters. One call simulates a complete run and
stores all outputs at all instants in memory, as double. The program contains the elementary functions of the exported
C, so the results have the same bits as on every other machine (docs page, Run a simulation in the browser).
"""

import base64
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from trimtab.compiler.block import BlockText, block_text
from trimtab.compiler.elementary import LICENCE_NOTE
from trimtab.compiler.folder import column_names
from trimtab.compiler.structs import Member, row_functions
from trimtab.compiler.text import C_TYPES
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.record import replace
from trimtab.core.suggestions import closest
from trimtab.core.time import Timetable, timetable, to_seconds
from trimtab.export.verify import EXACT
from trimtab.links.fifo import required_slots
from trimtab.links.latency import MeasuredLatency
from trimtab.logs.metrics import full_path
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import loop_block
from trimtab.run.simulate import simulate

WEB = Path(__file__).parent / "web"
TOOLS = ("clang", "wasm-ld")
FLAGS = ("--target=wasm32", "-std=c99", "-nostdlib", "-nostdlibinc", "-mbulk-memory", "-w")
EXPORTED = ("defaults", "get", "set", "fly", "memory")
MEMORY = 64 * 2**20
"""Maximum size (bytes) of the stored outputs of a simulated flight."""
REFERENCE_ROWS = 300


class Slider(NamedTuple):
    """Slider of the page, which changes one or more parameters of the loop.

    name, unit: name and unit shown on the page.
    low, high: lowest and highest value of the slider.
    paths: paths of the scenario's parameters that the slider changes.
    adds: True if the slider's value is added to the scenario's values. It then starts at 0. False if the slider's value
        replaces the scenario's values. It then starts at the first of these values.
    """

    name: str
    unit: str
    low: float
    high: float
    paths: tuple[str, ...]
    adds: bool = False


class WebFlight(NamedTuple):
    """Closed loop for a browser. program: bytes of the WebAssembly program.  about: data for the page, which can be
    written as JSON."""

    program: bytes
    about: dict[str, Any]


def delay_slider(scenario: Scenario, high: float, link: str = "uplink") -> tuple[Scenario, Slider]:
    """Return the scenario with a sufficiently large buffer in a link, and a slider that adds up to `high` (s) to the
    latency of this link.

    Raises:
        InputError: the link has no table of latencies.
    """
    channel = getattr(scenario.world, link)
    if not isinstance(channel, MeasuredLatency):
        problem = f"the {link} is a {type(channel).__name__}, whose delay a slider cannot change"
        linked = argument("settings", "measured", "links")
        fix = f"use a link of the class MeasuredLatency; in a scenario of the hovercraft: {linked}"
        raise InputError("delay slider", problem, fix=fix)
    longest = float(np.asarray(channel.latency)[-1]) + high
    slots = max(channel.capacity, required_slots(longest, channel.send_period, channel.period))
    world = replace(scenario.world, **{link: replace(channel, capacity=slots)})
    slider = Slider(f"more {link} delay", "s", 0.0, high, (f"world.{link}.latency",), adds=True)
    return replace(scenario, world=world), slider


def missing_web_tools() -> list[str]:
    """Return the names of the tools for WebAssembly that are not installed."""
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def export_web(
    scenario: Scenario, sliders: tuple[Slider, ...] = (), signals: tuple[str, ...] = (), *, seed: int = 0
) -> WebFlight:
    """Compile a scenario's closed loop to WebAssembly.

    Args:
        scenario: scenario, checked completely before compilation.
        sliders: sliders that the page shows.
        signals: paths of the signals to plot, one plot for each signal. By default, the signals that have targets in
            the scenario are plotted.
        seed: seed of the random numbers in the flight that the page shows first.

    Raises:
        InputError: a tool is missing, a signal or quantity is unknown, or the outputs of the flight need too much
            memory.
    """
    if missing := missing_web_tools():
        problem = f"this machine has no {' and no '.join(missing)}"
        raise InputError("export --wasm", problem, fix="apt-get install clang lld")
    scenario.check()
    periods = [*scenario.world.periods(), scenario.autopilot.period]
    table = timetable(periods, scenario.duration, scenario.world.max_step)
    definition = loop_block(scenario, table.always, seed=seed)
    block = block_text(definition)
    names = ["t", *column_names(block.outputs)]
    signals = signals or tuple(dict.fromkeys(full_path(target.path) for target in scenario.targets))
    _check_names(signals, names, "signal")
    values = dict(zip((m.name for m in block.parameters), jax.tree.leaves(definition.parameters), strict=True))
    for slider in sliders:
        _check_slider(slider, block, values.__getitem__)
    if (size := 8 * len(table.t) * len(names)) > MEMORY:
        problem = f"the flight is too long: {len(table.t)} instants of {len(names)} numbers take {size >> 20} MB"
        raise InputError("export --wasm", problem, fix=f"a shorter flight, e.g. {argument('settings', 10, 'duration')}")
    program = _compile_program(block, flight_text(block, table))
    about = {
        "scenario": scenario.name,
        "duration_s": to_seconds(scenario.duration),
        "instants": len(table.t),
        "names": names,
        "seed": {"which": _find(block, "key.seed"), "value": seed},
        "sliders": [_describe_slider(slider, block) for slider in sliders],
        "signals": [_describe_signal(path, block, scenario) for path in signals],
        "reference": _reference(scenario, signals, table, seed),
    }
    return WebFlight(program, about)


def web_fragment(flight: WebFlight) -> str:
    """Return the HTML code of a flight. It loads no other files, and any page may contain it, even several times."""
    about = flight.about | {"program": base64.b64encode(flight.program).decode()}
    data = json.dumps(about).replace("</", "<\\/")
    style, script = ((WEB / name).read_text(encoding="utf-8") for name in ("flight.css", "flight.js"))
    return (
        f'<div class="trimtab-flight"><style>\n{style}</style>\n<script type="application/json">{data}</script>\n'
        f"<script>\n{script}</script></div>\n"
    )


def write_web_page(flight: WebFlight, folder: Path) -> list[Path]:
    """Write the page index.html, which needs no server, and for use in other pages the WebAssembly program and its
    description."""
    head = (
        '<!doctype html>\n<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">\n'
    )
    title = f"<title>{flight.about['scenario']}, trimtab</title>\n"
    texts = {
        "index.html": f"{head}{title}<body>\n{web_fragment(flight)}</body></html>\n".encode(),
        "loop.wasm": flight.program,
        "loop.json": (json.dumps(flight.about, indent=1) + "\n").encode(),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in texts.items():
            (folder / name).write_bytes(content)
    except OSError as error:
        problem = f"cannot write in the folder {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(
            argument_name("out"),
            problem,
            fix=f"{argument_name('out')} with a folder that you can write, e.g. {argument('out', 'page')}",
        ) from None
    return [folder / name for name in texts]


def _check_names(wanted: tuple[str, ...], names: list[str], what: str) -> None:
    for name in wanted:
        if name not in names:
            near = closest(name, names, 6) or names[:6]
            raise InputError(f"{what} {name!r}", f"unknown {what}", choices=near, fix=f"write {near[0]!r}")


def _check_slider(slider: Slider, block: BlockText, own: Callable[[str], Any]) -> None:
    """Raise InputError if a slider changes an unknown parameter, or if the range of a slider does not include the
    slider's start value."""
    quantities = [m for m in block.parameters if m.dtype == "f64"]
    names = [m.name for m in quantities] if slider.adds else [n for m in quantities for n in _elements(m)]
    _check_names(slider.paths, names, "quantity")
    which, first, _ = _find_elements(block, slider.paths[0])
    begin = 0.0 if slider.adds else float(np.ravel(own(block.parameters[which].name))[first])
    if not slider.low <= begin <= slider.high or slider.low == slider.high:
        problem = f"the range {slider.low:g} to {slider.high:g} must include the start value {begin:g}"
        raise InputError(
            f"slider {slider.name!r}", problem, fix="write a range LOW:HIGH that includes the scenario's value"
        )


def _find(block: BlockText, path: str) -> int:
    return [m.name for m in block.parameters].index(path)


def _elements(m: Member) -> list[str]:
    """Return the path of each element of a parameter."""
    return [m.name] if not m.shape else [f"{m.name}[{k}]" for k in range(m.size)]


def _find_elements(block: BlockText, path: str) -> list[int]:
    """Return the index of a parameter, and the range of its elements that a path names."""
    for which, m in enumerate(block.parameters):
        if path == m.name:
            return [which, 0, m.size]
        if path in _elements(m):
            k = _elements(m).index(path)
            return [which, k, k + 1]
    raise KeyError(path)


def _describe_slider(slider: Slider, block: BlockText) -> dict[str, Any]:
    return slider._asdict() | {"which": [_find_elements(block, path) for path in slider.paths]}


def _describe_signal(path: str, block: BlockText, scenario: Scenario) -> dict[str, Any]:
    """Return the path, unit, meaning and target of a plotted signal as data for the page."""
    declared = next((m.declaration for m in block.outputs if path.startswith(m.name)), None)
    goals = [target.value for target in scenario.targets if full_path(target.path) == path]
    return {
        "path": path,
        "unit": declared.unit if declared is not None and declared.unit != "1" else "",
        "meaning": declared.doc if declared is not None else "",
        "target": float(goals[0]) if goals else None,
    }


def _reference(scenario: Scenario, signals: tuple[str, ...], table: Timetable, seed: int) -> dict[str, Any]:
    """Return the values of the plotted signals as simulated on this machine, at every `every`-th instant, as float64 in
    base64."""
    log = simulate(scenario, seed=seed, log_period=1, signals=tuple(s.partition("[")[0] for s in signals))
    every = -(-len(table.t) // REFERENCE_ROWS)
    columns = []
    for path in signals:
        name, _, index = path.partition("[")
        values = np.asarray(log[name], np.float64).reshape(len(log), -1)
        columns.append(values[:, int(index.removesuffix("]")) if index else 0])
    rows = np.ascontiguousarray(np.stack(columns, axis=1)[::every], "<f8")
    return {"every": every, "rows": base64.b64encode(rows.tobytes()).decode()}


def flight_text(block: BlockText, table: Timetable) -> str:
    """Return the C code for a page: access to the parameters by index, and the simulation of a complete flight."""
    numbers = 1 + len(column_names(block.outputs))
    starts = np.flatnonzero(np.diff(table.h, prepend=-1))
    counts = np.diff(starts, append=len(table.h))
    runs = ", ".join(f"{{{h}, {n}}}" for h, n in zip(table.h[starts], counts, strict=True))
    workspace = f"static _Alignas(64) char workspace[{block.workspace}];\n" if block.workspace else ""
    end = ", workspace" if block.workspace else ""
    step = block.call("&p", "&s", "&in", "&out", "workspace")
    return f"""{LICENCE_NOTE}
#include <math.h>
#include <string.h>
#include "loop.h"

static loop_params p;
static loop_state s;
static loop_in in;
static loop_out out;
static double rows[{len(table.t)}][{numbers}];
static const struct {{ int64_t h; int32_t count; }} runs[] = {{{runs}}};
{workspace}
{row_functions(block.name, [], block.outputs)}
void defaults(void)
{{
    loop_defaults(&p);
}}

double get(int32_t which, int32_t i)
{{
    switch (which) {{
{_cases(block.parameters, "return (double){place};")}
    default: return NAN;
    }}
}}

void set(int32_t which, int32_t i, double value)
{{
    switch (which) {{
{_cases(block.parameters, "{place} = ({type})value; return;")}
    default: return;
    }}
}}

/* Simulate the whole flight. Each row of the result has the time (100 ns) and all outputs of an instant. */
const double *fly(void)
{{
    double *row = rows[0];
    int64_t t = 0;
    loop_init(&p, &s{end});
    for (size_t k = 0; k < sizeof runs / sizeof *runs; k++)
        for (int32_t n = 0; n < runs[k].count; n++, row += {numbers}) {{
            in.t = t;
            in.h = runs[k].h;
            {step}
            row[0] = (double)t;
            vectors_get_out(&out, row + 1);
            t += runs[k].h;
        }}
    return rows[0];
}}
"""


def _cases(parameters: list[Member], text: str) -> str:
    """Return a C `case` line for each parameter. text: C statement in which {place} and {type} are replaced."""
    lines = []
    for which, m in enumerate(parameters):
        body = text.format(place=m.at("p.", "i"), type=C_TYPES[m.dtype])
        lines.append(f"    case {which}: {'(void)i; ' if not m.shape else ''}{body}")
    return "\n".join(lines)


def _compile_program(block: BlockText, glue: str) -> bytes:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "loop.h").write_text(block.header, encoding="utf-8")
        (folder / "loop.c").write_text(block.source, encoding="utf-8")
        (folder / "wasm.c").write_text(glue, encoding="utf-8")
        link = ["-Wl,--no-entry", "-Wl,--strip-all", *(f"-Wl,--export={name}" for name in EXPORTED[:-1])]
        exact = [flag for flag in EXACT if flag != "-fno-tree-slp-vectorize"]
        command = ["clang", *FLAGS, *exact, "-isystem", str(WEB), "wasm.c", "loop.c", str(WEB / "library.c"), *link]
        command += ["-o", "loop.wasm"]
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        if done.returncode:
            said = "\n".join(done.stderr.splitlines()[:20])
            raise InputError(
                "export --wasm",
                f"clang reported an error:\n{said}",
                fix="report this error, together with the name of the scenario",
            )
        return (folder / "loop.wasm").read_bytes()

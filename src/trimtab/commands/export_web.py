"""`trimtab export --wasm`: write a web page with sliders that simulates the closed loop of a scenario."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from click.core import ParameterSource

from trimtab.commands.output import check_folder, print_json
from trimtab.commands.written_files import check_new_in, note_written
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError, argument_name

if TYPE_CHECKING:
    from trimtab.export.web_assembly import Slider
    from trimtab.loop.scenario import Scenario

EXAMPLE = "--slider delay=0:0.3"
OTHERS = ("target", "real", "part", "steps", "fly", "fmu")
"""Options of `trimtab export` that cannot be combined with --wasm."""


def write_web_flight(
    scenario: str,
    out: Path | None,
    sliders: tuple[str, ...],
    as_json: bool,
    *,
    seed: int,
    settings: Mapping[str, str],
    without: tuple[str, ...],
    **_: Any,
) -> None:
    """Write the web page of a closed loop, with WebAssembly program and description, and print their file sizes."""
    from trimtab.export.web_assembly import export_web, write_web_page  # these modules import JAX
    from trimtab.scenarios.build import build

    _refuse_other_choices()
    if out is None:
        raise InputError("export --wasm", "--out DIR is missing", fix="--out page")
    check_folder("--out", out)
    check_new_in("--out", out, "index.html", "loop.wasm", "loop.json")
    built = build(scenario, settings, without)
    enable_cache()
    made = []
    for text in sliders:
        built, slider = _parse_slider(built, text)
        made.append(slider)
    flight = export_web(built, tuple(made), seed=seed)
    files = write_web_page(flight, out)
    note_written(files)
    result = {
        "scenario": scenario,
        "program_bytes": len(flight.program),
        "instants": flight.about["instants"],
        "numbers": len(flight.about["names"]),
        "sliders": [slider.name for slider in made],
        "files": [str(f) for f in files],
    }
    if as_json:
        print_json(result)
        return
    click.echo(
        f"{scenario}: closed loop as WebAssembly, {result['program_bytes']} bytes, {result['instants']} steps of "
        f"{result['numbers']} numbers"
    )
    click.echo(f"wrote {len(files)} files in {out}      open {files[0]} in a browser")


def _refuse_other_choices() -> None:
    context = click.get_current_context()
    for name in OTHERS:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE and context.params[name] != "loop":
            option = next(p.opts[0] for p in context.command.params if p.name == name)
            problem = f"a page simulates the closed loop in double precision; {option} applies to other exports"
            raise InputError("export --wasm", problem, fix=f"leave {option} out")


def _parse_slider(scenario: "Scenario", text: str) -> "tuple[Scenario, Slider]":
    """Parse a slider `name=low:high`; return the scenario prepared for the slider, and the slider."""
    from trimtab.core.record import leaves
    from trimtab.export.web_assembly import Slider, delay_slider

    name, equals, span = text.partition("=")
    try:
        low, high = (float(end) for end in span.split(":"))
    except ValueError:
        low = high = np.nan
    if equals and low >= high:
        problem = f"the lower end must be below the upper end, got {low:g} and {high:g}"
        raise InputError(argument_name("slider", name), problem, fix=f"--slider {name}=LOW:HIGH")
    if not equals or not -np.inf < low < high < np.inf:
        fix = f"--slider {name or 'delay'}=LOW:HIGH, with two numbers, e.g. {EXAMPLE}"
        raise InputError("--slider", f"{text!r} is not of the form NAME=LOW:HIGH", fix=fix)
    link, _, kind = name.rpartition("-")
    if kind == "delay" and link in ("", "uplink", "downlink"):
        if low != 0:
            raise InputError(
                "--slider", f"the delay is added to the link's own and must start at 0, got {low:g}", fix=EXAMPLE
            )
        return delay_slider(scenario, high, link or "uplink")
    path = f"world.{link or 'uplink'}.loss" if kind == "loss" and link in ("", "uplink", "downlink") else name
    declared = next((d for where, _, d in leaves(scenario) if where == path.partition("[")[0]), None)
    unit = getattr(declared, "unit", "")
    return scenario, Slider(name, "" if unit == "1" else unit, low, high, (path,))

"""`trimtab export`: export a scenario as C, check the exported code, and run it on an emulated microcontroller."""

import inspect
import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.core import ParameterSource

from trimtab.commands.export_web import write_web_flight
from trimtab.commands.options import FILE, JSON, NAVIGATION, OUT, SET, WITHOUT
from trimtab.commands.output import check_folder, check_out, print_json, quote
from trimtab.commands.written_files import note_written, place_files
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.export.verify import compare_samples, verify_folder
from trimtab.flight.boards.microcontrollers import TARGETS, emulate, require_tools
from trimtab.scenarios.catalogue import load_function

BOARDS = ("cortex-m4", "cortex-m7")


@click.command()
@click.argument("scenario", metavar="[SCENARIO|FILE.py:FUNCTION]", required=False)
@click.option("--target", type=click.Choice(("c", *BOARDS)), default="c", show_default=True, help="Target platform.")
@click.option(
    "--float",
    "real",
    type=click.Choice(("double", "single")),
    help="Floating-point precision.  [default: single on cortex-m4, else double]",
)
@click.option(
    "--part",
    type=click.Choice(("autopilot", "loop", "vehicle")),
    default="autopilot",
    show_default=True,
    help="Part to write: autopilot, loop (autopilot, vehicle, sensors and links), or vehicle (only as an FMU).",
)
@click.option("--fmu", type=click.Choice(("2", "3")), help="Write an FMU for co-simulation by FMI 2.0 or 3.0.")
@OUT("DIR", "Write C code, a test program and test vectors to this folder, or an FMU to this file.")
@click.option("--steps", type=click.IntRange(1), default=2000, show_default=True, help="Number of test vectors.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the test vectors.")
@click.option("--fly", is_flag=True, help="Run the newly written code on the emulated board of --target.")
@click.option("--wasm", "web", is_flag=True, help="Write a self-contained web page that simulates the loop.")
@click.option(
    "--slider",
    "sliders",
    multiple=True,
    metavar="NAME=LOW:HIGH",
    help="Slider for a parameter on the page of --wasm. May be repeated.",
)
@click.option(
    "--verify",
    "check",
    type=FILE,
    metavar="DIR",
    help="Compile this exported folder, and compare its results with the simulation (with --target: on the board too).",
)
@SET
@NAVIGATION
@WITHOUT
@JSON
def command(
    scenario: str | None,
    target: str,
    fmu: str | None,
    out: Path | None,
    fly: bool,
    web: bool,
    sliders: tuple[str, ...],
    check: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Write a scenario's autopilot as C for a microcontroller. --verify compares the C code with the simulation.

    \b
    trimtab export hovercraft/zero-velocity --out autopilot
    trimtab export --verify autopilot
    trimtab export --verify flash --target cortex-m7      and run its vectors on the emulated board
    trimtab export hovercraft/heading-bang-bang --float single --out flash/
    trimtab export hovercraft/zero-velocity --target cortex-m7 --fly
    trimtab export hovercraft/spin --part loop --out whole-loop
    trimtab export hovercraft/spin --wasm --slider autopilot.law.spinning.k1=0.5:4 --out page
    trimtab export control.py:wrapped_error --out wrapped-error
    trimtab export hovercraft/spin --fmu 3 --out autopilot.fmu         an FMU; also --part vehicle, --part loop

    --wasm writes a page with the closed loop. A slider changes delay, downlink-delay, loss, downlink-loss, or the
    quantity at a PATH.

    FILE.py:FUNCTION may also be any pure JAX function instead of one that returns a Scenario. The shapes and types of
    its arguments are taken from the defaults of its parameters, or from a tuple `example` in the same file:

    
    example = (np.zeros(3), np.float32(1.0))      or, by function name,
    example = {"wrapped_error": (0.1, 6.2)}
    """
    if check is not None:
        _refuse_choices_of_verify()
        sys.exit(0 if _check_export(check, target, as_json) else 1)
    if scenario is None:
        fix = "trimtab export hovercraft/zero-velocity --out DIR"
        raise InputError("export", "the argument SCENARIO is missing", fix=fix)
    if web or sliders:
        write_web_flight(scenario, out, sliders, as_json, **options)
        return
    if fmu is not None:
        _write_fmu(scenario, int(fmu), out, as_json, target, fly, **options)
        return
    if options["part"] == "vehicle":
        problem = "a vehicle can only be written as an FMU; as C, only autopilot or loop can be written"
        raise InputError("export --part vehicle", problem, fix="--fmu 3 --out vehicle.fmu")
    if fly and target not in BOARDS:
        problem = f"--fly needs a microcontroller board as target, got {target!r}"
        raise InputError("export", problem, choices=BOARDS, fix="--target cortex-m7 --fly")
    if fly:
        require_tools(target)
    if out is None and not fly:
        raise InputError("export", "--out DIR is missing", fix="--out autopilot")
    if (function := find_function(scenario)) is not None:
        _export_function(scenario, *function, out, as_json, fly)
        return
    if out is not None:
        check_folder("--out", out)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        result, files = _write_export(scenario, folder, target, **options)
        if out is not None:
            result["files"] = [str(f) for f in place_files("--out", folder, files, out)]
            folder = out
        good = True
        if fly:
            flight, good = _fly_on_board(folder, target)
            result |= flight
    if as_json:
        print_json(result)
    else:
        _print_export(result, out)
    sys.exit(0 if good else 1)


def _write_fmu(
    scenario: str,
    version: int,
    out: Path | None,
    as_json: bool,
    target: str,
    fly: bool,
    *,
    real: str | None,
    part: str,
    seed: int,
    settings: Mapping[str, str],
    without: tuple[str, ...],
    **rest: Any,
) -> None:
    """Write an FMU, and print the number of its parameters, inputs and outputs."""
    from trimtab.export.fmu import export_fmu  # these modules import JAX, which --verify does not need
    from trimtab.scenarios.build import build

    if target != "c" or fly:
        raise InputError(
            "export --fmu", "an FMU is built for this machine, not for a board", fix="leave --target and --fly out"
        )
    if out is None:
        raise InputError("export --fmu", "--out FILE.fmu is missing", fix=f"--out {part}.fmu")
    if find_function(scenario) is not None:
        fix = "trimtab export hovercraft/spin --fmu 3 --out autopilot.fmu"
        raise InputError("export --fmu", "an FMU is a part of a scenario, not a function", fix=fix)
    if out.suffix != ".fmu":
        raise InputError("--out", f"the name of an FMU must end in .fmu, got {str(out)!r}", fix=f"--out {out}.fmu")
    check_out("--out", out, f"{part}.fmu")
    built = build(scenario, settings, without)
    enable_cache()
    written = export_fmu(built, out, version=version, part=part, real=real or "double", seed=seed)
    note_written([out])
    kinds = [v.role for v in written.variables]
    result = {
        "scenario": scenario,
        "part": part,
        "fmi": version,
        "file": str(out),
        "bytes": out.stat().st_size,
        "platform": written.platform,
        "parameters": kinds.count("tunable") + kinds.count("fixed"),
        "inputs": kinds.count("input"),
        "outputs": kinds.count("output"),
    }
    if as_json:
        print_json(result)
        return
    click.echo(
        f"{scenario}: {part} as an FMU by FMI {version}.0, {result['parameters']} parameters, "
        f"{result['inputs']} inputs, {result['outputs']} outputs"
    )
    binary, source = f"with a binary for {written.platform}", "as source code, because no C compiler was found"
    kept = binary if written.platform else source
    click.echo(f"wrote {out}, {result['bytes']} bytes, {kept}")


def _refuse_choices_of_verify() -> None:
    """Raise InputError if --verify is combined with an option that is only for writing."""
    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        is_typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if is_typed and name not in ("check", "target", "as_json"):
            typed = "a scenario" if name == "scenario" else parameter.opts[0]
            problem = f"{typed} is only for writing, but --verify checks an existing folder"
            fix = "--verify DIR; add --target cortex-m7 to run the code there too"
            raise InputError("export --verify", problem, fix=fix)


def _write_export(
    scenario: str,
    folder: Path,
    target: str,
    *,
    real: str | None,
    part: str,
    steps: int,
    seed: int,
    settings: Mapping[str, str],
    without: tuple[str, ...],
) -> tuple[dict[str, Any], list[Path]]:
    """Export a scenario as C. Return code sizes and the files written."""
    from trimtab.export.export_c import export_c  # these modules import JAX, which --verify does not need
    from trimtab.scenarios.build import build

    built = build(scenario, settings, without)
    enable_cache()
    real = real or (TARGETS[target].real if target in BOARDS else "double")
    # the main program for a board calls the C functions by the name "autopilot"
    name = "autopilot" if target in BOARDS else None
    written = export_c(built, folder, part=part, real=real, steps=steps, seed=seed, name=name)
    exported = written.block
    result = {
        "scenario": scenario,
        "part": part,
        "real": real,
        "lines": exported.source.count("\n"),
        "inputs": sum(m.size for m in exported.inputs),
        "outputs": sum(m.size for m in exported.outputs),
    }
    if exported.workspace:
        result["workspace_bytes"] = exported.workspace
    if exported.frame:
        result["frame_bytes"] = exported.frame
    return result, list(written.files)


def _export_function(
    name: str, function: Callable[..., Any], example: tuple[Any, ...], out: Path | None, as_json: bool, fly: bool
) -> None:
    """Write a JAX function as C, and print the size of the code."""
    from trimtab.compiler.compiled_function import export_callable

    if fly or out is None:
        raise InputError(
            f"export {name!r}", "a function can only be written to a folder", fix="--out DIR, without --fly"
        )
    check_folder("--out", out)
    with tempfile.TemporaryDirectory() as scratch:
        exported = export_callable(function, example, Path(scratch))
        files = place_files("--out", Path(scratch), exported.files, out)
    block = exported.block
    result = {
        "function": name,
        "lines": block.source.count("\n"),
        "inputs": sum(m.size for m in block.inputs),
        "outputs": sum(m.size for m in block.outputs),
        "workspace_bytes": block.workspace,
        "frame_bytes": block.frame,
        "files": [str(f) for f in files],
    }
    if as_json:
        print_json(result)
        return
    space = f", {block.workspace} bytes of workspace" if block.workspace else ""
    space += f", {block.frame} bytes of stack shared by the C functions" if block.frame else ""
    click.echo(f"{name} as C, {result['lines']} lines, {result['inputs']} inputs, {result['outputs']} outputs{space}")
    _print_files(files, out)


def _print_files(files: Sequence[Any], out: Path) -> None:
    click.echo(f"wrote {len(files)} files in {out}      check the files: trimtab export --verify {quote(out)}")


def _fly_on_board(folder: Path, target: str) -> tuple[dict[str, Any], bool]:
    """Run the test vectors on an emulated board. Return instructions, memory, and True if the outputs agree."""
    flight = emulate(folder, target)
    about = json.loads((folder / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    worst, first = compare_samples(flight.outputs, flight.expected_outputs, about["outputs"], tolerance)
    least, median, most = flight.instructions_per_step
    name = max(worst, key=lambda n: worst[n][0] / (worst[n][1] or 1.0))
    result = {
        "target": target,
        "steps": len(flight.outputs),
        "instructions_per_step": {"least": least, "median": median, "most": most},
        "flash_bytes": flight.flash_bytes,
        "library_bytes": flight.library_bytes,
        "ram_bytes": flight.ram_bytes,
        "stack_bytes": flight.stack_bytes,
        "worst": {"output": name, "difference": worst[name][0], "tolerance": worst[name][1]},
        "first_difference": None if first is None else list(first),
    }
    return result, first is None


def _print_export(result: Mapping[str, Any], out: Path | None) -> None:
    click.echo(
        f"{result['scenario']}: {result['part']} as C in {result['real']} precision, {result['lines']} lines, "
        f"{result['inputs']} inputs, {result['outputs']} outputs"
    )
    if "workspace_bytes" in result:
        click.echo(f"  workspace              {result['workspace_bytes']} bytes, provided by the caller")
    if "frame_bytes" in result:
        click.echo(f"  frame                  {result['frame_bytes']} bytes of stack shared by the C functions")
    if "target" in result:
        _print_board_flight(result)
    if out is not None:
        _print_files(result["files"], out)


def _print_board_flight(result: Mapping[str, Any]) -> None:
    cost, worst = result["instructions_per_step"], result["worst"]
    click.echo(f"on {result['target']}, emulated, {result['steps']} steps:")
    click.echo(f"  instructions per step  {cost['least']} … {cost['most']}, median {cost['median']}")
    click.echo(f"  flash                  {result['flash_bytes']} bytes, libraries {result['library_bytes']} bytes")
    click.echo(f"  RAM                    {result['ram_bytes']} bytes of structs, stack {result['stack_bytes']} bytes")
    _print_worst(worst, result["first_difference"])


def _print_worst(worst: Mapping[str, Any], first: Any) -> None:
    if first is not None:
        step, name, got, expected = first
        click.echo(f"  DIFFERS first at step {step}, {name}: got {got!r}, expected {expected!r}")
    else:
        text = f"{worst['difference']:.2g}, allowed {worst['tolerance']:.2g}"
        click.echo(f"  same outputs           largest difference: {worst['output']}, {text}")


def _check_export(folder: Path, target: str, as_json: bool) -> bool:
    """Compile and replay an exported folder, also on a target board; return True if the outputs agree."""
    if target in BOARDS and not (folder / "autopilot.c").is_file():
        fix = f"trimtab export SCENARIO --target {target} --out DIR"
        raise InputError(f"--target {target}", f"{str(folder)!r} was not exported for a board", fix=fix)
    verdict = verify_folder(folder)
    name = max(verdict.worst, key=lambda n: verdict.worst[n][0] / (verdict.worst[n][1] or 1e-300))
    difference, tolerance = verdict.worst[name]
    worst = {"output": name, "difference": difference, "tolerance": tolerance}
    flight, is_good_there = _fly_on_board(folder, target) if target in BOARDS else ({}, True)
    if as_json:
        board = {"board": flight} if flight else {}
        print_json(verdict._asdict() | {"folder": str(folder), "worst": worst, "all": verdict.worst} | board)
        return verdict.good and is_good_there
    sanitized = (
        "no errors from address and undefined-behaviour sanitizers" if verdict.sanitized else "sanitizers not available"
    )
    click.echo(f"{folder}: compiled without a warning, {sanitized}")
    click.echo(f"  steps                  {verdict.steps}, stack of a step {verdict.stack_bytes} bytes")
    _print_worst(worst, verdict.first)
    if flight:
        _print_board_flight(flight)
    return verdict.good and is_good_there


def find_function(name: str) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
    """Return the function ``file.py:function`` and example arguments, or None if the function returns a scenario.

    The example arguments are the tuple `example` in the file, or the element for this function in a dict `example`. If
    the file has no `example`, they are the defaults of the parameters. A function without example and defaults is taken
    as a function that returns a scenario.

    Raises:
        InputError: an `example` that is neither a tuple nor a dict of tuples.
    """
    if ":" not in name:
        return None
    function = load_function(name)
    example = getattr(function, "__globals__", {}).get("example")
    if isinstance(example, dict):
        example = example.get(function.__name__)
    if example is None:
        parameters = inspect.signature(function).parameters.values()
        defaults = tuple(p.default for p in parameters)
        if not defaults or any(d is inspect.Parameter.empty or d is None or isinstance(d, str) for d in defaults):
            return None
        hint = inspect.signature(function).return_annotation
        return None if "Scenario" in str(hint) else (function, defaults)
    if not isinstance(example, tuple):
        problem = f"`example` is a {type(example).__name__}, not a tuple of arguments"
        raise InputError(f"export {name!r}", problem, fix="example = (0.1, 6.2)")
    return function, example

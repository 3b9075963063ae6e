"""`trimtab export`: a scenario as C, the check of an exported folder, and its flight on an emulated microcontroller."""

import inspect
import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.kept_programs import enable_cache
from trimtab.commands.options import FILE, JSON, SET, WITHOUT
from trimtab.commands.output import print_json
from trimtab.core.errors import InputError
from trimtab.export.boards import TARGETS, emulate, require_tools
from trimtab.export.verify import compare_samples, verify_folder
from trimtab.scenarios.catalogue import load_function

BOARDS = ("cortex-m4", "cortex-m7")


@click.command()
@click.argument("scenario", metavar="[SCENARIO|FILE.py:FUNCTION]", required=False)
@click.option("--target", type=click.Choice(("c", *BOARDS)), default="c", show_default=True)
@click.option(
    "--float",
    "real",
    type=click.Choice(("double", "single")),
    help="Precision.  [default: single on cortex-m4]",
)
@click.option("--part", type=click.Choice(("autopilot", "loop")), default="autopilot", show_default=True)
@click.option("--out", type=FILE, metavar="DIR", help="Folder for the C, its test and its vectors.")
@click.option("--steps", type=click.IntRange(1), default=2000, show_default=True, help="Simulated steps to test with.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the simulated steps.")
@click.option("--run", "fly", is_flag=True, help="Fly it on the emulated board of --target.")
@click.option("--verify", "check", type=FILE, metavar="DIR", help="Check an exported folder.")
@SET
@WITHOUT
@JSON
def command(
    scenario: str | None, target: str, out: Path | None, fly: bool, check: Path | None, as_json: bool, **options: Any
) -> None:
    """Write a scenario's autopilot as C for a microcontroller, and prove that it computes the same.

    \b
    trimtab export hovercraft/zero-velocity --out autopilot
    trimtab export --verify autopilot
    trimtab export hovercraft/heading-bang-bang --float single --out flash/
    trimtab export hovercraft/zero-velocity --target cortex-m7 --run
    trimtab export hovercraft/spin --part loop --out whole-loop
    trimtab export control.py:wrapped_error --out wrapped-error

    FILE.py:FUNCTION may be any pure function of JAX instead of one that gives a Scenario. Its arguments' shapes and
    types are those of the defaults of its parameters, or of a tuple of arguments named `example` beside it:

    
    example = (np.zeros(3), np.float32(1.0))      or, by function,
    example = {"wrapped_error": (0.1, 6.2)}
    """
    if check is not None:
        sys.exit(0 if _check_export(check, as_json) else 1)
    if scenario is None:
        raise InputError("export", "no scenario is named", fix="trimtab export hovercraft/zero-velocity --out DIR")
    if fly and target not in BOARDS:
        problem = f"--run flies on a board, the target is {target!r}"
        raise InputError("export", problem, choices=BOARDS, fix="--target cortex-m7 --run")
    if fly:
        require_tools(target)
    if out is None and not fly:
        raise InputError("export", "no folder is named", fix="--out autopilot")
    if (function := find_function(scenario)) is not None:
        _export_function(scenario, *function, out, as_json, fly)
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if out is None else out
        result, files = _write_export(scenario, folder, target, **options)
        if out is not None:
            result["files"] = [str(f) for f in files]
        good = True
        if fly:
            flight, good = _fly_on_board(folder, target)
            result |= flight
    if as_json:
        print_json(result)
    else:
        _print_export(result, out)
    sys.exit(0 if good else 1)


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
    """What was exported, in numbers, and the files."""
    from trimtab.export.export_c import export_c  # these import JAX, which --verify does without
    from trimtab.scenarios.build import build

    built = build(scenario, settings, without)
    enable_cache()
    real = real or (TARGETS[target].real if target in BOARDS else "double")
    # a board has one entry point: the autopilot's
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
    """Write any function as C, and say what was written."""
    from trimtab.compiler.compiled_function import export_callable

    if fly or out is None:
        raise InputError(f"export {name!r}", "a function is written to a folder", fix="--out DIR, without --run")
    exported = export_callable(function, example, out)
    block = exported.block
    result = {
        "function": name,
        "lines": block.source.count("\n"),
        "inputs": sum(m.size for m in block.inputs),
        "outputs": sum(m.size for m in block.outputs),
        "workspace_bytes": block.workspace,
        "frame_bytes": block.frame,
        "files": [str(f) for f in exported.files],
    }
    if as_json:
        print_json(result)
        return
    space = f", {block.workspace} bytes of workspace" if block.workspace else ""
    space += f", {block.frame} bytes of stack between its pieces" if block.frame else ""
    click.echo(f"{name} as C, {result['lines']} lines, {result['inputs']} numbers in, {result['outputs']} out{space}")
    _print_files(exported.files, out)


def _print_files(files: Sequence[Any], out: Path) -> None:
    click.echo(f"wrote {len(files)} files in {out}      check them: trimtab export --verify {out}")


def _fly_on_board(folder: Path, target: str) -> tuple[dict[str, Any], bool]:
    """Fly the vectors on the emulated board: what it cost, and whether it computes what was simulated."""
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
        f"{result['inputs']} numbers in, {result['outputs']} out"
    )
    if "workspace_bytes" in result:
        click.echo(f"  workspace              {result['workspace_bytes']} bytes, which the caller gives")
    if "frame_bytes" in result:
        click.echo(f"  frame                  {result['frame_bytes']} bytes of stack for what its pieces share")
    if "target" in result:
        cost, worst = result["instructions_per_step"], result["worst"]
        click.echo(f"on {result['target']}, emulated, {result['steps']} steps:")
        click.echo(f"  instructions per step  {cost['least']} … {cost['most']}, median {cost['median']}")
        click.echo(
            f"  flash                  {result['flash_bytes']} bytes, and {result['library_bytes']} of libraries"
        )
        click.echo(f"  RAM                    {result['ram_bytes']} bytes of structs, {result['stack_bytes']} of stack")
        _print_worst(worst, result["first_difference"])
    if out is not None:
        _print_files(result["files"], out)


def _print_worst(worst: Mapping[str, Any], first: Any) -> None:
    if first is not None:
        step, name, got, expected = first
        click.echo(f"  DIFFERS first at step {step}, {name}: {got!r}, wanted {expected!r}")
    else:
        text = f"within {worst['difference']:.2g}, allowed {worst['tolerance']:.2g}"
        click.echo(f"  same outputs           the worst, {worst['output']}, {text}")


def _check_export(folder: Path, as_json: bool) -> bool:
    """Compile and replay an exported folder; whether it computes what was simulated."""
    verdict = verify_folder(folder)
    name = max(verdict.worst, key=lambda n: verdict.worst[n][0] / (verdict.worst[n][1] or 1e-300))
    difference, tolerance = verdict.worst[name]
    worst = {"output": name, "difference": difference, "tolerance": tolerance}
    if as_json:
        print_json(verdict._asdict() | {"folder": str(folder), "worst": worst, "all": verdict.worst})
        return verdict.good
    sanitized = "clean under address and undefined-behaviour sanitizers" if verdict.sanitized else "no sanitizers here"
    click.echo(f"{folder}: compiled without a warning, {sanitized}")
    click.echo(f"  steps                  {verdict.steps}, stack of a step {verdict.stack_bytes} bytes")
    _print_worst(worst, verdict.first)
    return verdict.good


def find_function(name: str) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
    """The function ``file.py:function`` and its example arguments, or None where it is a scenario.

    The example is a tuple `example` of the file, or a dict of such tuples by function; else the parameters' defaults. A
    function of a file without either is one that gives a scenario.

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
        if not defaults or any(d is inspect.Parameter.empty or isinstance(d, str) for d in defaults):
            return None
        hint = inspect.signature(function).return_annotation
        return None if "Scenario" in str(hint) else (function, defaults)
    if not isinstance(example, tuple):
        problem = f"`example` is a {type(example).__name__}, not a tuple of arguments"
        raise InputError(f"export {name!r}", problem, fix="example = (0.1, 6.2)")
    return function, example

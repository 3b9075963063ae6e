"""`trimtab export`: a scenario as C, the check of an exported folder, and its flight on an emulated microcontroller."""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from trimtab.core.errors import InputError

BOARDS = ("cortex-m4", "cortex-m7")


class ExportRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str | None
    target: str = "c"
    real: str | None = None
    part: str = "autopilot"
    out: Path | None = None
    steps: int = 2000
    seed: int = 0
    check: Path | None = None
    fly: bool = False
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    as_json: bool = False


def export(request: ExportRequest) -> bool:
    """Do what was asked for; whether all of it is good."""
    if request.check is not None:
        return check_export(request.check, request.as_json)
    if request.scenario is None:
        raise InputError("export", "no scenario is named", fix="trimtab export hovercraft/zero-velocity --out DIR")
    if request.fly and request.target not in BOARDS:
        problem = f"--run flies on a board, the target is {request.target!r}"
        raise InputError("export", problem, choices=BOARDS, fix="--target cortex-m7 --run")
    if request.fly:
        from trimtab.export.boards import require_tools

        require_tools(request.target)
    if request.out is None and not request.fly:
        raise InputError("export", "no folder is named", fix="--out autopilot")
    if request.out is not None:
        return _write_export(request, request.out)
    with tempfile.TemporaryDirectory() as scratch:
        return _write_export(request, Path(scratch))


def _write_export(request: ExportRequest, folder: Path) -> bool:
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import RunRequest as Flight
    from trimtab.commands.fly_scenario import build_from_request
    from trimtab.export.export_c import export_c

    assert request.scenario is not None
    scenario = build_from_request(Flight(request.scenario, request.settings, request.without))
    enable_cache()
    real = request.real or _float_type(request.target)
    # a board has one entry point: the autopilot's
    name = "autopilot" if request.target in BOARDS else None
    written = export_c(
        scenario, folder, part=request.part, real=real, steps=request.steps, seed=request.seed, name=name
    )
    made = written.block
    result: dict[str, Any] = {
        "scenario": request.scenario,
        "part": request.part,
        "real": real,
        "lines": made.source.count("\n"),
        "inputs": sum(m.size for m in made.inputs),
        "outputs": sum(m.size for m in made.outputs),
    }
    if request.out is not None:
        result["files"] = [str(f) for f in written.files]
    good = True
    if request.fly:
        flown, good = _fly_on_board(folder, request.target)
        result |= flown
    if request.as_json:
        click.echo(json.dumps(result))
    else:
        _print_export(result, request.out)
    return good


def _float_type(target: str) -> str:
    if target not in BOARDS:
        return "double"
    from trimtab.export.boards import TARGETS

    return TARGETS[target].real


def _fly_on_board(folder: Path, target: str) -> tuple[dict[str, Any], bool]:
    """Fly the vectors on the emulated board: what it cost, and whether it computes what was simulated."""
    import numpy as np

    from trimtab.export.boards import emulate
    from trimtab.export.verify import compare_samples

    flown = emulate(folder, target)
    about = json.loads((folder / "export.json").read_text())
    tolerance = np.array([about["tolerance"][n] for n in about["outputs"]])
    worst, first = compare_samples(flown.outputs, flown.expected_outputs, about["outputs"], tolerance)
    least, median, most = flown.instructions_per_step
    name = max(worst, key=lambda n: worst[n][0] / (worst[n][1] or 1.0))
    found = {
        "target": target,
        "steps": len(flown.outputs),
        "instructions_per_step": {"least": least, "median": median, "most": most},
        "flash_bytes": flown.flash_bytes,
        "library_bytes": flown.library_bytes,
        "ram_bytes": flown.ram_bytes,
        "stack_bytes": flown.stack_bytes,
        "worst": {"output": name, "difference": worst[name][0], "tolerance": worst[name][1]},
        "first_difference": None if first is None else list(first),
    }
    return found, first is None


def _print_export(result: Mapping[str, Any], out: Path | None) -> None:
    click.echo(
        f"{result['scenario']}: {result['part']} as C in {result['real']} precision, {result['lines']} lines, "
        f"{result['inputs']} numbers in, {result['outputs']} out"
    )
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
        click.echo(f"wrote {len(result['files'])} files in {out}      check them: trimtab export --verify {out}")


def _print_worst(worst: Mapping[str, Any], first: Any) -> None:
    if first is not None:
        step, name, got, wanted = first
        click.echo(f"  DIFFERS first at step {step}, {name}: {got!r}, wanted {wanted!r}")
    else:
        text = f"within {worst['difference']:.2g}, allowed {worst['tolerance']:.2g}"
        click.echo(f"  same outputs           the worst, {worst['output']}, {text}")


def check_export(folder: Path, as_json: bool) -> bool:
    """Compile and replay an exported folder; whether it computes what was simulated."""
    from trimtab.export.verify import verify_folder

    verdict = verify_folder(folder)
    name = max(verdict.worst, key=lambda n: verdict.worst[n][0] / (verdict.worst[n][1] or 1e-300))
    difference, tolerance = verdict.worst[name]
    worst = {"output": name, "difference": difference, "tolerance": tolerance}
    if as_json:
        result = verdict._asdict() | {"folder": str(folder), "worst": worst, "all": verdict.worst}
        click.echo(json.dumps(result))
        return verdict.good
    sanitized = "clean under address and undefined-behaviour sanitizers" if verdict.sanitized else "no sanitizers here"
    click.echo(f"{folder}: compiled without a warning, {sanitized}")
    click.echo(f"  steps                  {verdict.steps}, stack of a step {verdict.stack_bytes} bytes")
    _print_worst(worst, verdict.first)
    return verdict.good

"""`trimtab run` and `trimtab demo`: fly a scenario, ideal beside real, and show what came of it.

A run that was flown before is found again with its compiled programs; only then JAX is not imported.
"""

import contextlib
import json
import tempfile
import time
from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from trimtab.commands.warm import RunPrograms, load_programs, program_key, store_programs
from trimtab.core.errors import InputError
from trimtab.core.time import ms
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target, full_path, metrics, mode_switches
from trimtab.run.program import check_seed

if TYPE_CHECKING:
    from trimtab.logs.navigation import Navigation
    from trimtab.loop.scenario import Scenario


class RunRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    seed: int = 0
    ideal: bool = True
    plot: Path | None = None
    out: Path | None = None
    as_json: bool = False
    backend: str = "auto"
    faults: tuple[str, ...] = ()
    log_period: int = ms(1)
    run: int = 0

    @property
    def key(self) -> dict[str, Any]:
        """What decides the programs."""
        spoilt = [f"fault {text}" for text in self.faults]
        return program_key(self.scenario, self.settings, [*self.without, *spoilt], self.ideal)


class RunReport(NamedTuple):
    """The runs, and what is shown of them."""

    name: str
    real: Log
    ideal: Log | None
    targets: tuple[Target, ...]
    wall_s: float


def fly_scenario(request: RunRequest) -> None:
    """Everything is checked before anything runs; files appear whole or not at all."""
    check_seed(request.seed)
    check_seed(request.run)
    flown = _fly_stored(request) or _compile_and_fly(request)
    picture, log_file = _check_outputs(request)
    real, ideal = flown.real, flown.ideal
    result = {
        "scenario": request.scenario,
        "seed": request.seed,
        "run": request.run,
        "backend": real.metadata["backend"],
        "duration_s": real.metadata["duration_s"],
        "wall_s": round(flown.wall_s, 4),
        "real": summarise_run(real, flown.targets),
        "ideal": None if ideal is None else summarise_run(ideal, flown.targets),
    }
    navigated = _summarise_navigation(real)
    if navigated is not None:
        result["navigation"] = navigated.plain()
    written = [*_write_log(real, ideal, log_file), *_draw_run(flown, picture)]
    if request.as_json:
        click.echo(json.dumps(result | ({"files": [str(f) for f in written]} if written else {})))
        return
    from trimtab.commands.tables import print_navigation, print_result

    print_result(result, _metric_units(real, result["real"]["metrics"]))
    if navigated is not None:
        print_navigation(navigated, {name: real.unit(f"{navigated.where}.{name}") for name in navigated.learned})
    for file in written:
        click.echo(f"wrote {file}")


def _fly_stored(request: RunRequest) -> RunReport | None:
    """The runs from programs that were kept, or None."""
    if request.backend == "jax":
        return None
    ready = load_programs(request.key)
    if ready is None:
        return None
    _check_outputs(request)
    return _fly_programs(ready, request, time.perf_counter())


def _fly_programs(ready: RunPrograms, request: RunRequest, started: float) -> RunReport:
    how = request.seed, request.run, request.log_period
    real = ready.real.fly(*how)
    ideal = None if ready.ideal is None else ready.ideal.fly(*how)
    return RunReport(ready.name, real, ideal, ready.targets, time.perf_counter() - started)


def _compile_and_fly(request: RunRequest) -> RunReport:
    """The runs from the scenario itself; its programs are kept for the next time."""
    from concurrent.futures import ThreadPoolExecutor

    from trimtab.commands.cache import enable_cache
    from trimtab.commands.progress import show_spinner
    from trimtab.commands.sources import list_loaded_files, record_read_files
    from trimtab.run.runner import choose_c
    from trimtab.run.simulate import compile_scenario, simulate

    with record_read_files() as read:
        scenario = build_from_request(request)
    _check_outputs(request)
    enable_cache()
    targets = tuple(scenario.targets)
    started = time.perf_counter()
    programs: list[RunPrograms] = []

    def compiled() -> None:
        with ThreadPoolExecutor(1) as other:  # one is traced while the compiler works on the other
            real = other.submit(compile_scenario, scenario)
            twin = compile_scenario(scenario.ideal()) if request.ideal else None
            programs.append(RunPrograms(scenario.name, real.result(), twin, targets))

    with show_spinner(f"compiling {scenario.name}; the next run starts at once"):
        flies_c = choose_c(request.backend, compiled)
    if flies_c:
        files = [*list_loaded_files(), *read]
        store_programs(request.key, programs[0], files)
        return _fly_programs(programs[0], request, started)
    how: dict[str, Any] = {"seed": request.seed, "run": request.run, "log_period": request.log_period}
    real = simulate(scenario, **how, backend="jax")
    twin = scenario.ideal() if request.ideal else None
    ideal = simulate(twin, **how, backend="jax") if twin else None
    return RunReport(scenario.name, real, ideal, targets, time.perf_counter() - started)


def build_from_request(request: RunRequest) -> "Scenario":
    """The scenario with its settings, checked."""
    from trimtab.scenarios.build import build as build_scenario

    return build_scenario(request.scenario, request.settings, request.without, request.faults)


def summarise_run(log: Log, targets: Iterable[Target]) -> dict[str, Any]:
    """Metrics, last state and mode switches of one run; signals that have a target come with their path."""
    targets = tuple(targets)
    signals = [p.removeprefix("truth.") for p in log.paths if p.startswith("truth.")]
    preferred = ["surge_velocity", "sway_velocity", "yaw_rate", "heading"]
    wanted = [full_path(t.path) for t in targets if not full_path(t.path).startswith("truth.")]
    shown = [f"truth.{s}" for s in preferred if s in signals] or [f"truth.{s}" for s in signals]
    final = {path.removeprefix("truth."): float(value) for path, value in log.final.items()}
    final |= {path: float(log[path][-1]) for path in wanted if len(log)}
    found = metrics(log, targets, [*wanted, *shown])
    named = {path.removeprefix("truth."): numbers for path, numbers in found.items()}
    final = {name: value if isfinite(value) else None for name, value in final.items()}
    lost = divergence_time(log)
    return {
        "metrics": named,
        "final": final,
        "mode_switches": mode_switches(log),
        "flags": flag_times(log),
        "lost_s": lost,
    }


def flag_times(log: Log) -> dict[str, dict[str, float]]:
    """Flags of law and actuators that were up: for how long, and when first, in s."""
    found: dict[str, dict[str, float]] = {}
    raised = [p for p in log.paths if p.startswith(("law.", "actuators.")) and p in log.declarations]
    for path in [p for p in raised if log.declarations[p].kind == "flag" and log[p].ndim == 1]:
        up = log[path].astype(bool)
        if up.any():
            share = float(up.mean()) * float(log.t[-1] - log.t[0] if len(log) > 1 else 0.0)
            found[path] = {"for_s": round(share, 4), "first_s": float(log.t[up.argmax()])}
    return found


def divergence_time(log: Log) -> float | None:
    """When the truth stopped being finite (s), or None."""
    truth = [log[p] for p in log.paths if p.startswith("truth.")]
    if not truth or not len(log):
        return None
    broken = ~np.isfinite(np.stack([x if x.ndim == 1 else x.sum(axis=1) for x in truth])).all(axis=0)
    return float(log.t[broken.argmax()]) if broken.any() else None


def _metric_units(log: Log, names: Iterable[str]) -> dict[str, str]:
    return {name: log.unit(name if name in log else f"truth.{name}") for name in names}


def _summarise_navigation(log: Log) -> "Navigation | None":
    """What a run with an aided INS says about it; what judges it is imported only then."""
    if not any(p.startswith("estimate.") and p.endswith("_fix.nis") for p in log.paths):
        return None
    from trimtab.logs.navigation import assess_navigation

    return assess_navigation(log)


def _check_outputs(request: RunRequest) -> tuple[Path | None, Path | None]:
    """Picture and log file; refuses before the run what could not be written after it."""
    out = request.out
    picture = request.plot or (None if out is None else out / "run.png")
    check_picture(picture, out)
    return picture, None if out is None else out / "run.mcap"


def check_picture(picture: Path | None, out: Path | None) -> None:
    """Refuse a folder or a picture that could not be written."""
    if out is not None:
        check_folder("--out", out)
    if picture is not None:
        if picture.suffix.lower() not in (".png", ".pdf", ".svg"):
            problem = f"{picture.name!r} has no picture's ending"
            raise InputError("--plot", problem, choices=(".png", ".pdf", ".svg"), fix=f"--plot {picture.stem}.png")
        if out is None or picture.parent != out:
            check_folder("--plot", picture.parent)
        if picture.is_dir():
            raise InputError("--plot", f"{str(picture)!r} is a folder", fix=f"--plot {picture / 'run.png'}")


def check_folder(part: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, by trying; leaves nothing behind."""
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(part, problem, fix=f"{part} with a folder of yours, e.g. {part} flight") from None
    finally:
        for made in missing:
            with contextlib.suppress(OSError):
                made.rmdir()


def _write_log(real: Log, ideal: Log | None, file: Path | None) -> list[Path]:
    if file is None:
        return []
    from trimtab.logs.mcap import write_mcap

    file.parent.mkdir(parents=True, exist_ok=True)
    write_mcap(real, file)
    if ideal is None:
        return [file]
    twin = file.with_name("ideal.mcap")
    write_mcap(ideal, twin)
    return [file, twin]


def _draw_run(flown: RunReport, file: Path | None) -> list[Path]:
    if file is None:
        return []
    from trimtab.plots.run import plot_run

    file.parent.mkdir(parents=True, exist_ok=True)
    plot_run(flown.real, flown.ideal, file, title=flown.name, targets=flown.targets)
    drawn = [file]
    if any(p.startswith("law.") and p.endswith("_wanted") for p in flown.real.paths):
        from trimtab.plots.tracking import plot_tracking

        drawn.append(file.with_stem(f"{file.stem}-tracking"))
        plot_tracking(flown.real, drawn[-1], title=f"{flown.name}: tracking")
    if _summarise_navigation(flown.real) is not None:
        from trimtab.plots.navigation import plot_navigation

        drawn.append(file.with_stem(f"{file.stem}-navigation"))
        plot_navigation(flown.real, drawn[-1], title=f"{flown.name}: navigation")
    return drawn

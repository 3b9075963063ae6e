"""`trimtab tune`: better gains, and what they are worth in runs that the tuning did not see."""

import json
import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

if TYPE_CHECKING:
    from trimtab.campaign.search.tune import TuningResult
    from trimtab.campaign.statistics.comparison import Comparison


class TuneRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    gains: Mapping[str, str] = {}
    cost: str = "error_rms:yaw_rate"
    method: str = "search"
    runs: int = 64
    held_out: int = 256
    iterations: int = 30
    width: float = 0.05
    spread: Mapping[str, str] = {}
    seed: int = 0
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    backend: str = "auto"
    threads: int | None = None
    out: Path | None = None
    plot: Path | None = None
    as_json: bool = False


def tune(request: TuneRequest) -> bool:
    """Tune; True where it helps in the held-out runs (exit code 0), False where that can't be said (exit code 1).

    The file is written only where it helps.
    """
    from trimtab.campaign.search import tune as tuning
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import check_folder, check_picture
    from trimtab.commands.progress import show_progress

    check_picture(request.plot, None)
    if request.out is not None:
        from trimtab.campaign.search.scenario_file import check_file

        check_file("--out", request.out)
        check_folder("--out", request.out.parent)
    enable_cache()
    asked = request._asdict()
    for name in ("scenario", "out", "plot", "as_json"):
        del asked[name]
    each = len(request.gains) if request.method == "gradient" else 8
    with show_progress(request.runs * request.iterations * each + 2 * (request.runs + request.held_out)) as tell:
        found = tuning.tune(request.scenario, **asked, progress=lambda n: tell("tuning", n))
    written = _write_files(request, found)
    if request.as_json:
        click.echo(json.dumps(tuning_json(request, found) | ({"files": written} if written else {}), allow_nan=False))
    else:
        _print_tuning(request, found, written)
    return found.is_improvement


def _write_files(request: TuneRequest, found: "TuningResult") -> list[str]:
    written = []
    if request.out is not None and found.is_improvement:
        from trimtab.campaign.search.scenario_file import write_scenario

        c = found.held_out_comparison
        gains = "\n".join(f"    {n} = {v!r}, was {found.before[n]!r}" for n, v in found.after.items())
        worth = f"{c.before:.6g} before, {c.after:.6g} after, mean of {c.runs} runs that the tuning did not see"
        about = (
            f"{request.scenario}, tuned.\n\nCost: {request.cost}: {worth}.\nGains:\n\n{gains}\n\n"
            f"To fly it:\n\n    {replay_command(request)}"
        )
        write_scenario(request.out, found.plan, found.values, about)
        written.append(str(request.out))
    if request.plot is not None:
        from trimtab.plots.search import plot_tune

        request.plot.parent.mkdir(parents=True, exist_ok=True)
        plot_tune(found, request.plot, title=f"{request.scenario}, {request.cost}")
        written.append(str(request.plot))
    return written


def replay_command(request: TuneRequest) -> str:
    """The command that flies the tuned scenario."""
    return shlex.join(["trimtab", "run", f"{request.out}:scenario"])


def tuning_json(request: TuneRequest, found: "TuningResult") -> dict[str, Any]:
    """What was found, as JSON has it; a number that is none is null."""

    def numbers(c: "Comparison") -> dict[str, Any]:
        return {n: None if isinstance(v, float) and not math.isfinite(v) else v for n, v in c._asdict().items()}

    return {
        "scenario": request.scenario,
        "method": request.method,
        "cost": request.cost,
        "helps": found.is_improvement,
        "before": found.before,
        "after": found.after,
        "seen": numbers(found.seen_comparison),
        "held_out": numbers(found.held_out_comparison),
        "flown": found.flown_runs,
        "wall_s": round(found.wall_s, 3),
    }


def _print_tuning(request: TuneRequest, found: "TuningResult", written: list[str]) -> None:
    said = "helps" if found.is_improvement else "does NOT help, as far as the held-out runs can tell"
    click.echo(f"{request.scenario}, {request.cost}, {found.method}: {said}")
    width = max(map(len, found.before))
    for name, value in found.before.items():
        click.echo(f"  {name:<{width}}  {value:.6g} -> {found.after[name]:.6g}")
    for name, c in (("seen", found.seen_comparison), ("held out", found.held_out_comparison)):
        click.echo(f"{name}, {c.runs} runs: {_format_comparison(c)}")
    click.echo(f"{found.flown_runs} runs flown in {found.wall_s:.1f} s")
    for file in written:
        click.echo(f"wrote {file}")
    if request.out is not None:
        click.echo(f"fly it:  {replay_command(request)}" if found.is_improvement else f"not written: {request.out}")


def _format_comparison(c: "Comparison") -> str:
    counts = f"better in {c.better}, worse in {c.worse}"
    if not math.isfinite(c.difference):
        return f"cost infinite in some; {counts}"
    interval = f"{100 * c.level:.0f} %: {c.low:.4g} … {c.high:.4g}"
    return f"{c.before:.5g} -> {c.after:.5g}, change {c.difference:.4g} ({interval}); {counts}"

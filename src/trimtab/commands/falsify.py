"""`trimtab falsify`: the worst case inside given bounds, and a file that flies it again."""

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from trimtab.core.errors import InputError

if TYPE_CHECKING:
    from trimtab.campaign.search.falsify import FalsificationResult


class FalsifyRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    spread: Mapping[str, str] = {}
    success: tuple[str, ...] = ()
    runs: int = 5000
    words: int = 4
    over: str = "worst"
    until_first: bool = False
    seed: int = 0
    settings: Mapping[str, str] = {}
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    backend: str = "auto"
    threads: int | None = None
    out: Path | None = None
    plot: Path | None = None
    as_json: bool = False


def falsify(request: FalsifyRequest) -> bool:
    """Search; True where no failure was found (exit code 0), False where one was (exit code 1).

    The file is written either way: it holds the worst run that was found, failed or not.
    """
    from trimtab.campaign.search import falsify as search
    from trimtab.commands.cache import enable_cache
    from trimtab.commands.fly_scenario import check_folder, check_picture
    from trimtab.commands.progress import show_progress

    check_picture(request.plot, None)
    if request.out is not None:
        from trimtab.campaign.search.scenario_file import check_file

        check_file("--out", request.out)
        check_folder("--out", request.out.parent)
    if request.runs < 1:
        raise InputError("--runs", f"{request.runs} is no number of runs", fix="--runs 5000")
    enable_cache()
    asked = request._asdict()
    for name in ("scenario", "out", "plot", "as_json"):
        del asked[name]
    with show_progress(request.runs) as tell:
        found = search.falsify(request.scenario, **asked, progress=lambda n: tell("searching", n))
    written = _write_files(request, found)
    if request.as_json:
        click.echo(
            json.dumps(falsification_json(request, found) | ({"files": written} if written else {}), allow_nan=False)
        )
    else:
        _print_falsification(request, found, written)
    return not found.fails


def replay_command(request: FalsifyRequest, found: "FalsificationResult") -> str:
    """The command that flies the worst run again."""
    of = ["trimtab", "run", f"{request.out}:scenario", "--seed", str(request.seed), "--run", str(found.word)]
    return shlex.join(of)


def _write_files(request: FalsifyRequest, found: "FalsificationResult") -> list[str]:
    written = []
    if request.out is not None:
        from trimtab.campaign.search.scenario_file import write_scenario

        kept = "; ".join(request.success) or "each target reached for good"
        about = (
            f"The worst run of {request.scenario} that a search found: margin {found.margin:.6g}.\n\n"
            f"Wanted: {kept}.\n{found.flown_runs} runs were flown. To fly it again:\n\n"
            f"    {replay_command(request, found)}"
        )
        write_scenario(request.out, found.plan, found.values, about)
        written.append(str(request.out))
    if request.plot is not None:
        from trimtab.plots.search import plot_falsify

        request.plot.parent.mkdir(parents=True, exist_ok=True)
        plot_falsify(found, request.plot, title=request.scenario)
        written.append(str(request.plot))
    return written


def falsification_json(request: FalsifyRequest, found: "FalsificationResult") -> dict[str, Any]:
    """What was found, as JSON has it; a number that is none is null."""
    import numpy as np

    def number(value: Any) -> Any:
        return bool(value) if isinstance(value, bool | np.bool_) else float(value) if np.isfinite(value) else None

    return {
        "scenario": request.scenario,
        "failed": found.fails,
        "margin": found.margin,
        "values": {path: np.asarray(v).tolist() for path, v in found.values.items()},
        "seed": request.seed,
        "run": found.word,
        "metrics": {name: number(v) for name, v in found.columns.items()},
        "flown": found.flown_runs,
        "first_failure_after": found.first,
        "over": request.over,
        "words": request.words,
        "wall_s": round(found.wall_s, 3),
    } | ({"replay": replay_command(request, found)} if request.out is not None else {})


def _print_falsification(request: FalsifyRequest, found: "FalsificationResult", written: list[str]) -> None:
    import numpy as np

    said = f"FAILS, the first after {found.first} runs" if found.fails else "no failure found, which is no proof"
    click.echo(f"{request.scenario}: {said}")
    click.echo(f"margin of the worst run {found.margin:.6g}; {found.flown_runs} runs flown in {found.wall_s:.1f} s")
    width = max(map(len, found.values))
    for path, value in found.values.items():
        click.echo(f"  {path:<{width}}  {np.array2string(np.asarray(value), precision=8)}")
    for name, value in found.columns.items():
        if name not in ("margin", "success", "lost"):
            click.echo(f"  {name:<{width}}  {float(value):.6g}")
    for file in written:
        click.echo(f"wrote {file}")
    if request.out is not None:
        click.echo(f"fly it again:  {replay_command(request, found)}")

"""`trimtab link-test`: one-way delays of a link under load; and with --echo the other end of it."""

import contextlib
import json
import math
import re
import secrets
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.links.open_link import open_link
from trimtab.live.link_test import Delays, LinkTestPlan, fit_delay_model, latency_rows, link_traces

LOADS = ("2.9/41.0", "2.9/22.0", "2.9/16.2")
"""Up and down in kb/s, those of the source's table 5.1."""
MOST_KBPS = 1000.0
FEWEST = 10


class LinkTestRequest(NamedTuple):
    """What was asked for on the command line."""

    uri: str
    echo: bool = False
    listen: bool | None = None
    """Be the end that is called; None: the echoing end is."""
    loads: tuple[str, ...] = ()
    requests: int = 300
    rate: float = 10.0
    seed: int = 0
    plot: Path | None = None
    out: Path | None = None
    as_json: bool = False


def link_test(request: LinkTestRequest, stop: Callable[[], bool] = lambda: False) -> bool:
    """Measure, or echo until `stop` or an interrupt. Returns whether somebody answered."""
    if request.echo:
        return _echo_packets(request, stop)
    from trimtab.commands.fly_scenario import check_picture

    plans = _load_plans(request)
    picture = request.plot or (request.out / "link-test.png" if request.out else None)
    check_picture(picture, request.out)
    link = open_link(request.uri, listen=bool(request.listen))
    try:
        measured = _measure_delays(link, request.uri, plans)
    finally:
        link.close()
    if not measured:
        return False
    found: dict[str, Any] = {"link": request.uri, "loads": [_delays_json(delays) for delays in measured]}
    files = _write_files(request, found, measured, picture)
    if request.as_json:
        click.echo(json.dumps(found | ({"files": [str(f) for f in files]} if files else {})))
    else:
        _print_delays(request, measured, files)
    return True


def _echo_packets(request: LinkTestRequest, stop: Callable[[], bool]) -> bool:
    from trimtab.live.link_test import echo_requests

    link = open_link(request.uri, listen=request.listen is not False)
    click.echo(f"echoing on {request.uri}; the other end: trimtab link-test {request.uri}", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        echo_requests(link, stop=stop)
    link.close()
    return True


def _load_plans(request: LinkTestRequest) -> list[LinkTestPlan]:
    """What is to be measured; refuses what is no load, too few requests, and too many of them."""
    if request.requests < FEWEST:
        problem = f"{request.requests} requests make no table"
        raise InputError(
            "--requests", problem, fix=f"--requests {FEWEST} or more; 300 take half a minute for each load"
        )
    if not 0 < request.rate <= 200:
        raise InputError("--rate", f"{request.rate:g} requests per second", fix="--rate 10, from above 0 to 200")
    found = []
    for text in request.loads or LOADS:
        match = re.fullmatch(r"(\d+(?:\.\d+)?)/(\d+(?:\.\d+)?)", text)
        up, down = (float(match[1]), float(match[2])) if match else (math.inf, math.inf)
        if max(up, down) > MOST_KBPS:
            problem = f"{text!r} is not UP/DOWN in kb/s, each up to {MOST_KBPS:g}"
            raise InputError("--load", problem, choices=LOADS, fix=f"--load {LOADS[1]}")
        found.append(LinkTestPlan(up, down, request.requests, request.rate, seed=request.seed))
    return found


def _measure_delays(link: Link, uri: str, plans: list[LinkTestPlan]) -> list[Delays]:
    """One after the other; empty where nobody answers, which is told."""
    from trimtab.commands.progress import show_spinner
    from trimtab.live.clock_time import ClockTimeExchange
    from trimtab.live.link_test import measure_delays

    measured = []
    for plan in plans:
        with show_spinner(f"{plan.requests} requests at {plan.up:g}/{plan.down:g} kb/s up/down"):
            delays = measure_delays(link, ClockTimeExchange(secrets.randbits(32)), plan)
        if delays is None or delays.has_reply.sum() < 2:
            click.echo(f"error: link {uri!r}: nobody answers.", err=True)
            click.echo(f"Fix: start the other end first: trimtab link-test {uri} --echo", err=True)
            return []
        measured.append(delays)
    return measured


def _delays_json(delays: Delays) -> dict[str, Any]:
    """As numbers and lists, for JSON; delays in ms as in the source's table."""
    plan = delays.plan
    found: dict[str, Any] = {"load_up_kbps": plan.up, "load_down_kbps": plan.down}
    found |= {"sent_kbps": delays.data_rates[0], "received_kbps": delays.data_rates[1]}
    found |= {
        "requests": len(delays.send_times),
        "answered": int(delays.has_reply.sum()),
        "shared_clock": delays.has_one_clock,
    }
    for path, row in latency_rows(delays).items():
        found[path.replace(" ", "_")] = row._asdict()
    for path, trace in link_traces(delays).items():
        fitted = fit_delay_model(trace)
        found[path] |= {"lost": float(trace.lost.mean()), "model": fitted._asdict(), "set": fitted.settings(path)}
    return found


def _load_name(delays: Delays) -> str:
    return f"{delays.plan.up:g}-{delays.plan.down:g}"


def _write_files(
    request: LinkTestRequest, found: dict[str, Any], measured: list[Delays], picture: Path | None
) -> list[Path]:
    """Figures, recordings, settings and picture; each file appears whole or not at all."""
    written = []
    if request.out is not None:
        from trimtab.links.latency_trace import write_trace
        from trimtab.logs.mcap import replace_file

        request.out.mkdir(parents=True, exist_ok=True)
        for delays in measured:
            for path, trace in link_traces(delays).items():
                file = request.out / f"{path}link-{_load_name(delays)}.csv"
                write_trace(file, trace)
                written.append(file)
            written.append(file := request.out / f"settings-{_load_name(delays)}.txt")
            with replace_file(file) as stream:
                stream.write((" ".join(_scenario_settings(delays)) + "\n").encode())
        written.append(file := request.out / "link-test.json")
        with replace_file(file) as stream:
            stream.write(json.dumps(found, indent=1).encode())
    if picture is not None:
        from trimtab.plots.link_delays import plot_link_delays

        picture.parent.mkdir(parents=True, exist_ok=True)
        plot_link_delays(measured, picture, title=f"Delays of {request.uri}")
        written.append(picture)
    return written


def _scenario_settings(delays: Delays) -> list[str]:
    """What to type after `trimtab run SCENARIO` to fly over a link like this one."""
    both = [text for path, trace in link_traces(delays).items() for text in fit_delay_model(trace).settings(path)]
    return [word for text in ("links=measured", *both) for word in ("--set", text)]


def _print_delays(request: LinkTestRequest, measured: list[Delays], files: list[Path]) -> None:
    from rich import box
    from rich.table import Table

    from trimtab.commands.tables import console

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    for name in ("up/down (kb/s)", "path"):
        table.add_column(name, no_wrap=True)
    for name in ("mean (ms)", "sd", "min", "max", "lost", "model: mean, sd, shift (ms)"):
        table.add_column(name, justify="right")
    for delays in measured:
        recorded = link_traces(delays)
        for path, row in latency_rows(delays).items():
            load = f"{delays.plan.up:g}/{delays.plan.down:g}" if path == "up" else ""
            lost, fitted = f"{1 - delays.has_reply.mean():.1%}", ""
            if path in recorded:
                m = fit_delay_model(recorded[path])
                lost, fitted = f"{m.loss:.1%}", f"{1e3 * m.mean:.2f}, {1e3 * m.sd:.2f}, {1e3 * m.shift:.2f}"
            table.add_row(load, path, *(f"{v:.2f}" for v in row), lost, fitted)
    console().print(table)
    if not all(delays.has_one_clock for delays in measured):
        click.echo("two clocks: their offset is that of the quickest round trips; only the round trip is certain")
    for file in files:
        click.echo(f"wrote {file}")
    if request.out is not None:
        file = request.out / f"settings-{_load_name(measured[0])}.txt"
        click.echo(f"fly over a link like this: trimtab run hovercraft/zero-velocity $(cat {file})")
        words = [f"{p}link={request.out / f'{p}link-{_load_name(measured[0])}.csv'}" for p in ("up", "down")]
        again = shlex.join(word for text in words for word in ("--set", text))
        click.echo(f"over these very delays: trimtab run hovercraft/zero-velocity {again}")
    else:
        words = " ".join(f"'{w}'" if "[" in w else w for w in _scenario_settings(measured[0]))
        click.echo(f"fly over a link like this: trimtab run hovercraft/zero-velocity {words}")

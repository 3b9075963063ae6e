"""`trimtab link-test`: measure one-way delays of a link under load, or with --echo, act as the far end."""

import contextlib
import json
import math
import re
import secrets
import shlex
import socket
import sys
from pathlib import Path
from typing import Any

import click

from trimtab.commands.options import JSON, OUT, PLOT, SEED, FiniteRange
from trimtab.commands.output import (
    check_picture,
    draw_plot,
    new_table,
    print_files,
    print_json,
    print_table,
    write_text,
)
from trimtab.commands.progress import format_wait, show_spinner
from trimtab.commands.written_files import check_new_in
from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.flight.clock_time import ClockTimeExchange
from trimtab.flight.line_delays import (
    Delays,
    LinkTestPlan,
    echo_requests,
    fit_delay_model,
    latency_rows,
    link_traces,
    measure_delays,
)
from trimtab.flight.transports.open_link import open_link
from trimtab.links.latency_trace import write_trace
from trimtab.plots.link_delays import plot_link_delays

LOADS = ("2.9/41.0", "2.9/22.0", "2.9/16.2")
"""Default data rates up/down in kb/s, from table 5.1 of the thesis."""
MOST_KBPS = 1000.0
REQUESTS_MIN = 10


@click.command()
@click.argument("uri", metavar="URI")
@click.option(
    "--echo",
    is_flag=True,
    help="Act as the far end: echo every packet until Ctrl-C. With port 0, a free port is chosen and printed.",
)
@click.option(
    "--load",
    "loads",
    multiple=True,
    metavar="UP/DOWN",
    help="Load during the measurement: data rates up/down in kb/s. May be repeated.",
)
@click.option("--requests", type=int, default=300, show_default=True, help="Number of requests for each load.")
@click.option("--rate", type=FiniteRange(), default=10.0, show_default=True, help="Requests per second.")
@SEED
@PLOT("Draw histograms of the delays to this picture.")
@OUT("DIR", "Write delay table, histograms, recordings and simulation settings to this folder.")
@JSON
def command(
    uri: str,
    echo: bool,
    loads: tuple[str, ...],
    requests: int,
    rate: float,
    seed: int,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure a link's one-way delays, up and down, under load.

    One end of the link echoes packets, the other end measures. The results are a table, histograms, recordings that
    `trimtab run` can replay, and a model of the link as settings for `trimtab run`. On one machine both ends share a
    clock. Otherwise the split of the round trip into up and down is estimated.

    \b
    trimtab link-test 'serial:///dev/ttyUSB0?baud=115200' --echo          on one end
    trimtab link-test 'serial:///dev/ttyUSB1?baud=115200' --out radio     on the other
    trimtab link-test udp://127.0.0.1:14555 --load 2.9/22.0 --plot delays.png
    """
    if echo:
        _echo_packets(uri)
        return
    plans = _plan_loads(loads, requests, rate, seed)
    picture = plot or (out / "link-test.png" if out else None)
    check_picture(picture, out)
    check_new_in("--out", out, "?*link-*.csv", "settings-*.txt", "link-test.json")
    link = open_link(uri, listen=False)
    try:
        measured = _measure_delays(link, uri, plans)
    finally:
        link.close()
    if not measured:
        sys.exit(1)
    result: dict[str, Any] = {"link": uri, "loads": [_delays_json(delays) for delays in measured]}
    files = [] if out is None else _write_recordings(result, measured, out)
    files += draw_plot(picture, plot_link_delays, measured, title=f"Delays of {uri}")
    if as_json:
        print_json(result, files)
        return
    _print_delays(measured)
    print_files(files)
    _print_settings(measured[0], out)


def _echo_packets(uri: str) -> None:
    uri = _choose_port(uri)
    link = open_link(uri, listen=True)
    other = shlex.join(["trimtab", "link-test", _address_from_elsewhere(uri)])
    click.echo(f"echoing on {uri}; the other end: {other}", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        echo_requests(link)
    link.close()


def _choose_port(uri: str) -> str:
    """Return the URI with port 0 replaced by a free port."""
    before, _, port = uri.rpartition(":")
    kind = {"udp": socket.SOCK_DGRAM, "tcp": socket.SOCK_STREAM}.get(uri.partition("://")[0])
    if port != "0" or kind is None:
        return uri
    with socket.socket(socket.AF_INET, kind) as asking:
        asking.bind(("", 0))
        return f"{before}:{asking.getsockname()[1]}"


def _address_from_elsewhere(uri: str) -> str:
    """Return the address at which another program reaches a listener at `uri`.

    A URI without a host means this machine.
    """
    scheme, separator, rest = uri.partition("://")
    host, colon, port = rest.rpartition(":")
    if host == "" and colon:
        return f"{scheme}{separator}127.0.0.1:{port}"
    if host != "0.0.0.0":
        return uri
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(
                ("192.0.2.1", 9)
            )  # an address reserved for documentation: nothing is sent, but a network interface is chosen
            own = asking.getsockname()[0]
        except OSError:
            own = socket.gethostname()
    return f"{scheme}{separator}{own}:{port}"


def _plan_loads(loads: tuple[str, ...], requests: int, rate: float, seed: int) -> list[LinkTestPlan]:
    """Return the planned measurements. Raise InputError for an invalid load, or too few or too frequent requests."""
    if requests < REQUESTS_MIN:
        problem = f"must be at least 10, got {requests}"
        raise InputError(
            "--requests", problem, fix=f"--requests {REQUESTS_MIN} or more; 300 take half a minute for each load"
        )
    if not 0 < rate <= 200:
        raise InputError("--rate", f"must be above 0 and at most 200, got {rate:g}", fix="--rate 10")
    plans = []
    for text in loads or LOADS:
        match = re.fullmatch(r"(\d+(?:\.\d+)?)/(\d+(?:\.\d+)?)", text)
        up, down = (float(match[1]), float(match[2])) if match else (math.inf, math.inf)
        if max(up, down) > MOST_KBPS:
            problem = f"{text!r} is not UP/DOWN in kb/s, each up to {MOST_KBPS:g}"
            raise InputError("--load", problem, choices=LOADS, fix=f"--load {LOADS[1]}")
        plans.append(LinkTestPlan(up, down, requests, rate, seed=seed))
    return plans


def _measure_delays(link: Link, uri: str, plans: list[LinkTestPlan]) -> list[Delays]:
    """Measure one load after the other. If the far end does not answer, print an error and return an empty list."""
    seconds = sum(plan.requests / plan.rate for plan in plans)
    first = format_wait(plans[0].first_patience)
    click.echo(f"the test takes about {format_wait(seconds)}; the other end must answer within {first}", err=True)
    measured = []
    for plan in plans:
        with show_spinner(f"{plan.requests} requests at {plan.up:g}/{plan.down:g} kb/s up/down"):
            delays = measure_delays(link, ClockTimeExchange(secrets.randbits(32)), plan)
        if delays is None or delays.has_reply.sum() < 2:
            click.echo(f"error: link {uri!r}: no answer.", err=True)
            click.echo(f"Fix: start the other end first: trimtab link-test {uri} --echo", err=True)
            return []
        measured.append(delays)
    return measured


def _delays_json(delays: Delays) -> dict[str, Any]:
    """Return the delays as data for JSON, in ms as in the table of the thesis."""
    plan = delays.plan
    numbers: dict[str, Any] = {"load_up_kbps": plan.up, "load_down_kbps": plan.down}
    numbers |= {"sent_kbps": delays.data_rates[0], "received_kbps": delays.data_rates[1]}
    numbers |= {
        "requests": len(delays.send_times),
        "answered": int(delays.has_reply.sum()),
        "shared_clock": delays.has_one_clock,
    }
    for path, row in latency_rows(delays).items():
        numbers[path.replace(" ", "_")] = row._asdict()
    for path, trace in link_traces(delays).items():
        fitted = fit_delay_model(trace)
        numbers[path] |= {"lost": float(trace.lost.mean()), "model": fitted._asdict(), "set": fitted.settings(path)}
    return numbers


def _load_name(delays: Delays) -> str:
    return f"{delays.plan.up:g}-{delays.plan.down:g}"


def _write_recordings(result: dict[str, Any], measured: list[Delays], out: Path) -> list[Path]:
    """Write results, recordings and settings of a link test, each file atomically."""
    files = []
    out.mkdir(parents=True, exist_ok=True)
    for delays in measured:
        for path, trace in link_traces(delays).items():
            files.append(file := out / f"{path}link-{_load_name(delays)}.csv")
            write_trace(file, trace)
        settings = " ".join(_scenario_settings(delays)) + "\n"
        files.append(write_text(out / f"settings-{_load_name(delays)}.txt", settings))
    files.append(write_text(out / "link-test.json", json.dumps(result, indent=1)))
    return files


def _scenario_settings(delays: Delays) -> list[str]:
    """Return the options for `trimtab run SCENARIO` that simulate the measured link."""
    both = [text for path, trace in link_traces(delays).items() for text in fit_delay_model(trace).settings(path)]
    return [word for text in ("links=measured", *both) for word in ("--set", text)]


def _print_delays(measured: list[Delays]) -> None:
    numbers = (">mean (ms)", ">sd", ">min", ">max", ">lost", ">model: mean, sd, shift (ms)")
    table = new_table("up/down (kb/s)", "path", *numbers, unwrapped=("up/down (kb/s)", "path"))
    for delays in measured:
        recorded = link_traces(delays)
        for path, row in latency_rows(delays).items():
            load = f"{delays.plan.up:g}/{delays.plan.down:g}" if path == "up" else ""
            lost, fitted = f"{1 - delays.has_reply.mean():.1%}", ""
            if path in recorded:
                m = fit_delay_model(recorded[path])
                lost, fitted = f"{m.loss:.1%}", f"{1e3 * m.mean:.2f}, {1e3 * m.sd:.2f}, {1e3 * m.shift:.2f}"
            table.add_row(load, path, *(f"{v:.2f}" for v in row), lost, fitted)
    print_table(table)
    if not all(delays.has_one_clock for delays in measured):
        click.echo("the two ends have different clocks with an estimated offset; only round-trip times are certain")


def _print_settings(delays: Delays, out: Path | None) -> None:
    """Print the commands that simulate the measured link."""
    fly = "trimtab run hovercraft/zero-velocity"
    if out is None:
        words = " ".join(f"'{w}'" if "[" in w else w for w in _scenario_settings(delays))
        click.echo(f"simulate a link like this: {fly} {words}")
        return
    click.echo(f"simulate a link like this: {fly} $(cat {out / f'settings-{_load_name(delays)}.txt'})")
    words = [f"{p}link={out / f'{p}link-{_load_name(delays)}.csv'}" for p in ("up", "down")]
    again = shlex.join(word for text in words for word in ("--set", text))
    click.echo(f"replay the recorded delays: {fly} {again}")

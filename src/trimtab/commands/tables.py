"""Tables in the terminal."""

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:  # rich is imported when a table is printed, not for --json
    from rich.console import Console
    from rich.table import Table

    from trimtab.commands.calibrate import SensorAxis
    from trimtab.design.certificate_check import CertificateProof
    from trimtab.identify.allan import Coefficient
    from trimtab.logs.navigation import Navigation
    from trimtab.run.error_budget import ErrorBudget
    from trimtab.study import Row

METRICS = {
    "first_reach_s": ("first in band", "s"),
    "settling_s": ("settled", "s"),
    "overshoot": ("overshoot", ""),
    "tail_mean": ("tail mean", ""),
    "tail_rms": ("tail rms", ""),
}


def console() -> "Console":
    """Standard output; wide enough for a table when it is not a terminal."""
    from rich.console import Console

    found = Console(highlight=False, soft_wrap=False)
    return found if found.is_terminal else Console(highlight=False, width=140)


def new_table(**options: Any) -> "Table":
    """An empty table in our style."""
    from rich import box
    from rich.table import Table

    return Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold", **options)


def print_scenarios(names: Mapping[str, str], as_json: bool) -> None:
    """Every scenario with its first line."""
    if as_json:
        click.echo(json.dumps({"scenarios": names}))
        return
    table = new_table()
    table.add_column("scenario", no_wrap=True)
    table.add_column("what it shows")
    for name, doc in names.items():
        table.add_row(name, doc)
    console().print(table)
    click.echo(f"fly one: trimtab run {next(iter(names))}      its settings: trimtab list {next(iter(names))}")


def print_settings(name: str, scenario: Any, arguments: Mapping[str, tuple[str, ...]], as_json: bool) -> None:
    """Every setting of a scenario: path, value, unit, meaning; and what can be switched off."""
    from trimtab.core.record import leaves  # brings numpy along, which a list of names does not need

    faults = sorted(scenario.imperfections())
    rows = [(path, _format_value(value, d), _format_unit(d), d.doc) for path, value, d in leaves(scenario)]
    if as_json:
        settings = {path: {"value": value, "unit": unit, "doc": doc} for path, value, unit, doc in rows}
        click.echo(json.dumps({"scenario": name, "choices": arguments, "settings": settings, "imperfections": faults}))
        return
    table = new_table()
    table.add_column("--set", no_wrap=True)
    table.add_column("value", justify="right")
    table.add_column("unit")
    table.add_column("meaning")
    for argument, choices in arguments.items():
        table.add_row(argument, " | ".join(choices), "", "Choice of this scenario; the first is the default.")
    for row in rows:
        table.add_row(*row)
    console().print(table)
    click.echo(f"--without {' | '.join(faults)}")


def _format_value(value: Any, declared: Any) -> str:
    from trimtab.core.record import Option
    from trimtab.core.time import format_time

    if isinstance(declared, Option):
        return format_time(value) if declared.kind == "period" else str(value)
    from numpy import shape, size

    numbers = shape(value)
    if not numbers:
        return f"{float(value):.6g}"
    few = len(numbers) == 1 and size(value) <= 4
    return "[" + ",".join(f"{v:.4g}" for v in value) + "]" if few else f"{'x'.join(map(str, numbers))} numbers"


def _format_unit(declared: Any) -> str:
    from trimtab.core.record import Option

    if isinstance(declared, Option):
        return "" if declared.kind == "period" else "|".join(map(str, declared.choices))
    return "" if declared.unit == "1" else declared.unit


def print_result(result: Mapping[str, Any], units: Mapping[str, str]) -> None:
    """Metrics of a run, ideal beside real."""
    flown = {side: result[side] for side in ("ideal", "real") if result[side] is not None}
    title = f"{result['scenario']}, {result['duration_s']:g} s, seed {result['seed']}"
    table = new_table(title=title, title_justify="left")
    table.add_column("signal", no_wrap=True)
    table.add_column("")
    table.add_column("final", justify="right")
    for heading, unit in METRICS.values():
        table.add_column(f"{heading} ({unit})" if unit else heading, justify="right")
    signals = list(next(iter(flown.values()))["metrics"])
    for signal in signals:
        for i, (side, found) in enumerate(flown.items()):
            name = f"{signal} ({units[signal]})" if i == 0 else ""
            cells = [_format_number(found["metrics"][signal][metric]) for metric in METRICS]
            table.add_row(
                name, side, _format_number(found["final"].get(signal)), *cells, end_section=side == list(flown)[-1]
            )
    console().print(table)
    switches = ", ".join(f"{side} {found['mode_switches']}" for side, found in flown.items())
    click.echo(f"mode switches: {switches}      what the columns mean: docs, Metrics")
    for side, found in flown.items():
        for path, flag in found["flags"].items():
            click.echo(f"{path} ({side}): up for {flag['for_s']:.4g} s, first at {flag['first_s']:.4g} s")
        if found["lost_s"] is not None:
            click.echo(f"LOST ({side}): the state is not finite from {found['lost_s']:.4g} s on")


def print_deadlines(found: Mapping[str, Any], granted: str) -> None:
    """How a flight's deadlines were kept."""
    n = found["work"]["n"]
    table = new_table(title=f"{n} periods of {found['period']}, {granted}", title_justify="left")
    table.add_column("time (us)", no_wrap=True)
    for heading in ("median", "99 %", "99.9 %", "longest"):
        table.add_column(heading, justify="right")
    names = {"late": "deadline to wake-up", "step": "compiled step", "work": "work of a period"}
    for key, name in names.items():
        cells = [f"{found[key][q] * 1e6:.1f}" for q in ("p50", "p99", "p999", "longest")]
        table.add_row(name, *cells)
    console().print(table)
    over = found["overruns"]
    click.echo(
        f"overruns: {over['own_work']} by own work, {over['scheduler']} by the scheduler; skipped {found['skipped']}"
    )


def print_navigation(found: "Navigation", units: Mapping[str, str]) -> None:
    """Whether a run's navigation knew how wrong it was, and what it learned."""
    screen = console()
    table = new_table(title="Navigation: errors against the filter's own sigmas", title_justify="left")
    for heading in ("what", "of", "draws", "mean", "bounds", "error / sigma", "white", "verdict"):
        table.add_column(heading, justify="left" if heading in ("what", "white", "verdict") else "right")
    rows: list[tuple[str, str, Any, str]] = []
    for name, aid in found.aiding.items():
        refused = f", {aid.refused} refused" if aid.refused else ""
        white = "-" if aid.white is None else f"{'yes' if aid.white else 'no'}, p {aid.p:.2g}"
        rows.append((f"{name} innovations", f"{aid.updates}{refused}", aid.nis, white))
    rows += [(f"{name} error", "truth", judged, "") for name, judged in found.errors.items()]
    for name, of, j, white in rows:
        bounds = f"{j.low:.3g} … {j.high:.3g}"
        factor = f"{j.factor:.2f}  ({_format_short(j.factor_low)} … {_format_short(j.factor_high)})"
        table.add_row(name, of, f"{j.draws:.0f}", f"{j.mean:.3g}", bounds, factor, white, j.verdict)
    screen.print(table)
    table = new_table()
    for heading in ("state", "sigma at first", "at the end", "settled (s)", "seen"):
        table.add_column(heading, justify="left" if heading in ("state", "seen") else "right")
    for name, state in found.learned.items():
        cells = (f"{state.first:.3g}", f"{state.last:.3g}", f"{state.settled_s:.2f}", state.trend)
        table.add_row(f"{name} ({units[name]})", *cells)
    screen.print(table)
    sure = f"{100 * found.probability:g} % of a consistent filter's runs keep within all bounds"
    click.echo(f"navigation: {found.verdict}; judged from {found.since_s:.2f} s on; {sure} (docs, Navigation of a run)")


def _format_short(value: float) -> str:
    return f"{value:.2f}" if value < 100 else "∞"


def print_noise(name: str, axes: Mapping[str, "SensorAxis"]) -> None:
    """Noise coefficients of each axis with their intervals, and what a filter takes."""
    any_axis = next(iter(axes.values()))
    shown, dt = console(), any_axis.fit.sampling_period
    table = new_table(title=f"{name}: {any_axis.duration:.4g} s, a sample each {1e3 * dt:.6g} ms", title_justify="left")
    for heading in ("axis", "U", "white N (U/√Hz)", "flicker B (U)", "walk K (U/√s)", "misfit"):
        table.add_column(heading, justify="left" if heading in ("axis", "U") else "right")
    for axis, a in axes.items():
        cells = (_format_coefficient(c) for c in (a.fit.white, a.fit.flicker, a.fit.walk))
        table.add_row(axis.replace("[", r"\["), a.unit, *cells, f"{a.fit.misfit:.2f}")
    shown.print(table)
    table = new_table(title="For a filter that steps with the sensor, or with --tick", title_justify="left")
    for heading in ("axis", "R of a sample (U²)", "Q of the integral (U² s²)", "Q of the bias (U²)"):
        table.add_column(heading, justify="left" if heading == "axis" else "right")
    for axis, a in axes.items():
        n = a.noise
        cells = (f"{v:.4g}" for v in (n.sample_variance, n.integral_variance, n.bias_variance))
        table.add_row(axis.replace("[", r"\["), *cells)
    shown.print(table)
    click.echo("intervals: 95 %; '<': the log shows none, up to that (docs, Noise from a still log)")


def _format_coefficient(c: "Coefficient") -> str:
    return f"{c.value:.4g}  ({c.low:.4g} … {c.high:.4g})" if c.low > 0 else f"< {c.high:.4g}"


def print_budget(title: str, found: "ErrorBudget") -> None:
    """What each imperfection costs: its share of each mean square, and each rms with it alone."""
    from trimtab.run.error_budget import cost_share

    screen, measures = console(), list(found.units)
    heads = [f"{m.replace('_', ' ')} ({found.units[m]})" for m in measures]
    table = new_table(title=f"{title}: rms over the second half", title_justify="left")
    table.add_column("imperfection", no_wrap=True)
    for head in heads:
        table.add_column(head, justify="right")
    for name, row in (("all", found.whole), ("none", found.least)):
        table.add_row(name, *(_format_rms(*row[m]) for m in measures), end_section=name == "none")
    for cost in found.costs:
        table.add_row(f"{cost.name} alone", *(_format_rms(*cost.alone[m]) for m in measures))
    screen.print(table)
    table = new_table(title="Share of the mean square that goes when it is switched off", title_justify="left")
    table.add_column("imperfection", no_wrap=True)
    for head in measures:
        table.add_column(head.replace("_", " "), justify="right")
    for cost in found.costs:
        table.add_row(cost.name, *(f"{100 * cost_share(found, cost, m):.1f} %" for m in measures))
    screen.print(table)
    click.echo("± one standard error; shares need not add up to 100 % (docs, Error budget)")


def _format_rms(value: float, error: float) -> str:
    return f"{value:.4f} ± {error:.4f}"


def print_rows(title: str, rows: Iterable["Row"]) -> None:
    """Rows of a study: printed beside computed, and of each that does not hold the reason."""
    from trimtab.study import format_value

    rows, screen = list(rows), console()
    table = new_table(title=title.replace("[", r"\["), title_justify="left")
    for heading in ("figure", "printed", "computed", "accepted", "unit", "verdict", "where"):
        justify = "right" if heading in ("printed", "computed") else "left"
        table.add_column(heading, justify=justify, no_wrap=heading == "verdict")
    styles = {"differs": "bold red", "not reproduced": "yellow"}
    for row in rows:
        printed = format_value(row.printed) + ("" if row.basis in ("printed", "text") else " *")
        unit = "" if row.unit == "1" else row.unit
        cells = (row.what, printed, format_value(row.computed), row.tolerance, unit, row.verdict, row.citation)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style=styles.get(row.verdict))
    screen.print(table)
    for row in rows:
        if row.verdict != "holds":
            screen.print(f"  {row.verdict}: {row.what}. {row.note}".rstrip().replace("[", r"\["))


def print_conditions(title: str, found: "CertificateProof") -> None:
    """Each condition of a certificate with its number and verdict."""
    table = new_table(title=title, title_justify="left")
    for heading in ("condition", "verdict", "number", "of", "by"):
        table.add_column(heading, justify="right" if heading == "number" else "left")
    for c in found.conditions:
        number = f"{c.number:.4g}" if c.number == c.number else "-"
        cells = (c.name, "holds" if c.holds else "FAILS", number, c.meaning, c.how)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style="" if c.holds else "bold red")
    console().print(table)
    for c in found.conditions:
        if c.why:
            click.echo(f"{'' if c.holds else 'FAILS  '}{c.name}: {c.why}")


def _format_number(value: float | None) -> str:
    if value is None:
        return "-"
    small = value != 0 and abs(value) < 0.01
    return f"{value:.2e}" if small and abs(value) < 1e-4 else f"{value:.5f}" if small else f"{value:.3f}"

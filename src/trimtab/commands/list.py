"""`trimtab list`: the scenarios, or every setting of one."""

from collections.abc import Mapping
from typing import Any

import click

from trimtab.commands.options import JSON
from trimtab.commands.output import console, new_table, print_json
from trimtab.scenarios import catalogue


@click.command()
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@JSON
def command(scenario: str | None, as_json: bool) -> None:
    """List the scenarios, or every setting of one.

    \b
    trimtab list
    trimtab list hovercraft/zero-velocity
    """
    if scenario is None:
        print_scenarios(catalogue.scenario_names(), as_json)
    else:
        built, _ = catalogue.load_scenario(scenario)
        print_settings(scenario, built, catalogue.scenario_choices(scenario), as_json)


def print_scenarios(names: Mapping[str, str], as_json: bool) -> None:
    """Every scenario with its first line."""
    if as_json:
        print_json({"scenarios": names})
        return
    table = new_table("scenario", "what it shows", unwrapped=("scenario",))
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
        print_json({"scenario": name, "choices": arguments, "settings": settings, "imperfections": faults})
        return
    table = new_table("--set", ">value", "unit", "meaning", unwrapped=("--set",))
    for argument, choices in arguments.items():
        table.add_row(argument, " | ".join(choices), "", "Choice of this scenario; the first is the default.")
    for row in rows:
        table.add_row(*row)
    console().print(table)
    click.echo(f"--without {' | '.join(faults)}")


def _format_value(value: Any, declaration: Any) -> str:
    from numpy import shape, size

    from trimtab.core.record import Option
    from trimtab.core.time import format_time

    if isinstance(declaration, Option):
        return format_time(value) if declaration.kind == "period" else str(value)
    numbers = shape(value)
    if not numbers:
        return f"{float(value):.6g}"
    few = len(numbers) == 1 and size(value) <= 4
    return "[" + ",".join(f"{v:.4g}" for v in value) + "]" if few else f"{'x'.join(map(str, numbers))} numbers"


def _format_unit(declaration: Any) -> str:
    from trimtab.core.record import Option

    if isinstance(declaration, Option):
        return "" if declaration.kind == "period" else "|".join(map(str, declaration.choices))
    return "" if declaration.unit == "1" else declaration.unit

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
        print_settings(scenario, built, catalogue.scenario_choices(scenario), catalogue.choice_lines(scenario), as_json)


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


def print_settings(
    name: str,
    scenario: Any,
    arguments: Mapping[str, tuple[str, ...]],
    lines: Mapping[str, Mapping[str, str]],
    as_json: bool,
) -> None:
    """Every setting of a scenario: path, value, unit, meaning; and what can be switched off.

    arguments: choices of each argument.  lines: of those that have them, what each choice is.
    """
    from trimtab.core.record import absent_parts, leaves  # numpy, which a list of names does not need
    from trimtab.loop.beliefs import belief_mismatches, describe_mismatches

    faults = sorted(scenario.imperfections())
    mismatch = [m._asdict() for m in belief_mismatches(scenario.autopilot, scenario.world.vehicle)]
    rows = [(path, _format_value(value, d), _format_unit(d), d.doc) for path, value, d in leaves(scenario)]
    if as_json:
        settings = {path: {"value": value, "unit": unit, "doc": doc} for path, value, unit, doc in rows}
        optional = {path: [p for p, _, _ in leaves(declared.optional)] for path, declared in absent_parts(scenario)}
        about = {"scenario": name, "choices": arguments, "choice_lines": lines, "settings": settings}
        print_json(about | {"optional": optional, "imperfections": faults, "mismatch": mismatch})
        return
    table = new_table("--set", ">value", "unit", "meaning", unwrapped=("--set",))
    for argument, choices in arguments.items():
        if argument in lines:
            for i, choice in enumerate(choices):
                default = "Default: " if i == 0 else ""
                table.add_row("" if i else argument, choice, "", f"{default}{lines[argument][choice]}.")
            continue
        table.add_row(argument, " | ".join(choices), "", "Choice of this scenario; the first is the default.")
    for row in rows:
        table.add_row(*row)
    for path, declared in absent_parts(scenario):
        fields = ", ".join(p for p, _, _ in leaves(declared.optional))
        table.add_row(f"{path}.…", "none", "", f"{declared.doc} One setting puts it there: {fields}.")
    console().print(table)
    click.echo(f"--without {' | '.join(faults)}")
    if mismatch:
        click.echo(describe_mismatches(mismatch))


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

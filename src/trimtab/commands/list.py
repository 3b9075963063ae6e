"""`trimtab list`: list the scenarios, or all settings of one scenario."""

import json
from collections.abc import Mapping
from typing import Any

import click

from trimtab.commands.options import JSON
from trimtab.commands.output import ANSWERS, new_table, print_json, print_schema, print_table
from trimtab.commands.typed_names import keep_paths
from trimtab.core.errors import InputError
from trimtab.scenarios import catalogue


@click.command()
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@click.option("--toml", "as_toml", is_flag=True, help="Print the scenario in the format of a scenario file (TOML).")
@click.option("--schema", "as_schema", is_flag=True, help="Print the JSON schema of scenario files.")
@click.option(
    "--answers", "as_answers", is_flag=True, help="Print the JSON schema of the --json output of all subcommands."
)
@JSON
def command(scenario: str | None, as_toml: bool, as_schema: bool, as_answers: bool, as_json: bool) -> None:
    """List the scenarios, or all settings of one scenario.

    \b
    trimtab list
    trimtab list hovercraft/zero-velocity
    trimtab list hovercraft/spin --toml > my.toml      a scenario file to be changed and flown
    """
    if as_schema:
        from trimtab.scenarios.toml_text import scenario_schema  # imports all parts of the package

        print_schema(scenario_schema())
    elif as_answers:
        print_schema(json.loads(ANSWERS.read_text("utf-8")))
    elif as_toml:
        _print_file(scenario)
    elif scenario is None:
        print_scenarios(catalogue.scenario_names(), as_json)
    else:
        from trimtab.loop.settings import setting_paths
        from trimtab.scenarios.build import (
            PREDICTOR,
            SWITCH,
        )  # imports the whole loop, which a list of names does not need

        built, _ = catalogue.load_scenario(scenario)
        choices = {**catalogue.scenario_choices(scenario), PREDICTOR: tuple(SWITCH)}
        lines = {**catalogue.choice_lines(scenario), PREDICTOR: SWITCH}
        keep_paths(scenario, setting_paths(built))
        print_settings(scenario, built, choices, lines, as_json)


def _print_file(scenario: str | None) -> None:
    if scenario is None:
        raise InputError("--toml", "needs a scenario", fix="trimtab list hovercraft/spin --toml > my.toml")
    from trimtab.scenarios.toml_text import format_scenario

    built, _ = catalogue.load_scenario(scenario)
    click.echo(format_scenario(scenario, built, catalogue.scenario_choices(scenario)), nl=False)


def print_scenarios(names: Mapping[str, str], as_json: bool) -> None:
    """Print every scenario with the first line of the description."""
    if as_json:
        print_json({"scenarios": names})
        return
    table = new_table("scenario", "description", unwrapped=("scenario",))
    for name, doc in names.items():
        table.add_row(name, doc)
    print_table(table)
    click.echo(f"run one: trimtab run {next(iter(names))}      list its settings: trimtab list {next(iter(names))}")


def print_settings(
    name: str,
    scenario: Any,
    arguments: Mapping[str, tuple[str, ...]],
    lines: Mapping[str, Mapping[str, str]],
    as_json: bool,
) -> None:
    """Print every setting of a scenario (path, value, unit, meaning), and its imperfections.

    arguments: for each argument of the scenario, the valid choices.  lines: argument -> choice -> description, if
    known.
    """
    from trimtab.core.record import absent_parts, leaves  # imports numpy, which a list of names does not need
    from trimtab.loop.model_mismatch import describe_mismatches, model_mismatches

    faults = sorted(scenario.imperfections())
    mismatch = [m._asdict() for m in model_mismatches(scenario.autopilot, scenario.world.vehicle)]
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
        table.add_row(argument, " | ".join(choices), "", "Option of this scenario. The first value is the default.")
    for row in rows:
        table.add_row(*row)
    for path, declared in absent_parts(scenario):
        fields = ", ".join(p for p, _, _ in leaves(declared.optional))
        table.add_row(f"{path}.…", "none", "", f"{declared.doc} Setting one of these adds this part: {fields}.")
    print_table(table)
    if faults:
        click.echo(f"imperfections that can be switched off: --without {' | '.join(faults)}")
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

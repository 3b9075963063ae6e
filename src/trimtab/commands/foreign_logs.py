"""Reading of other systems' logs with a mapping, list of a log's topics, and choice of the estimator for a replay."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import jax

from trimtab.commands.output import new_table, print_table, quote
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity, leaves
from trimtab.core.signals import no_motion
from trimtab.core.units import UNITS
from trimtab.logs.foreign import detect_format, is_own_log, list_topics, read_foreign
from trimtab.logs.foreign.tables import TopicSummary
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.samples import RECEIVED
from trimtab.scenarios.build import build

FIELDS_SHOWN = 8
"""Maximum number of fields of a topic that the table shows."""


def read_own_log(file: Path) -> Log:
    """Read a log of trimtab, and print a warning if the end of the file is missing, and for each gap in the log."""
    log = read_mcap(file)
    if log.metadata.get("truncated"):
        end = f", the last at {log.t[-1]:.3f} s" if len(log) else ""
        click.echo(show_controls(f"warning: {file.name}: the file is cut; {len(log)} rows were read{end}"), err=True)
    for gap in log.metadata.get("gaps", ()):
        click.echo(show_controls(f"warning: {file.name}: {gap['text']}"), err=True)
    return log


def read_mapped_log(file: Path, mapping: Path) -> Log:
    """Read a log of another system with a mapping, and print a warning for each sensor whose rows are left out."""
    log = read_foreign(file, mapping)
    for name, text in log.metadata.get("left_out", {}).items():
        click.echo(show_controls(f"warning: {file.name}, {name}: {text}"), err=True)
    return log


def read_any_log(file: Path, mapping: Path | None, *, quiet: bool = False) -> Log:
    """Read a log of trimtab, or a log of another system with a mapping.

    Args:
        file: log file.
        mapping: mapping file of a foreign log. None for a log of trimtab, or to print the topics of a foreign log.
        quiet: True to print nothing.

    Raises:
        InputError: a foreign log without a mapping, or an unreadable log.
    """
    if mapping is not None:
        return read_mapped_log(file, mapping)
    if is_own_log(file):
        return read_own_log(file)
    kind, topics = detect_format(file).name, list_topics(file)
    if not quiet:
        _print_topics(f"{file.name}: {kind}", topics)
    fix = f"write a mapping (docs, Foreign logs), then  trimtab replay {quote(file)} --map MAP.toml --scenario SCENARIO"
    names = [topic.name for topic in topics]
    raise InputError(
        f"log file '{file}'", f"is a log of another system: {kind}", choices=names if quiet else (), fix=fix
    )


def _print_topics(title: str, topics: list[TopicSummary]) -> None:
    table = new_table("topic", ">rows", ">Hz", "fields", title=title, unwrapped=("topic",))
    for topic in topics:
        more = len(topic.fields) - FIELDS_SHOWN
        fields = " ".join(topic.fields[:FIELDS_SHOWN]) + (f" and {more} more" if more > 0 else "")
        cells = topic.name, str(topic.rows), f"{topic.rate:.4g}", fields
        table.add_row(*(cell.replace("[", r"\[") for cell in cells))
    print_table(table)


def scenario_estimator(name: str, settings: Mapping[str, str], log: Log) -> Any:
    """Return the estimator of a scenario. settings: settings of the scenario.  log: log whose samples it will read.

    Raises:
        InputError: a sample in the log has another unit than that of the scenario's sensor.
    """
    scenario = build(name, settings)
    for sensor in scenario.autopilot.estimator.listens:
        for field, declared in _declared_fields(scenario.world.sensors.get(sensor)).items():
            path = f"{RECEIVED}.{sensor}.value.{field}"
            unit = log.unit(path) if path in log else declared.unit
            if unit not in ("", declared.unit) and declared.kind in ("real", "angle"):
                problem = f"{field!r} of sensor {sensor!r} must be in {declared.unit}, got the unit {unit!r}"
                fix = (
                    f'correct the unit or the column in the mapping: {field} = {{ from = …, unit = "{declared.unit}" }}'
                )
                raise InputError("replay", problem, choices=UNITS.get(declared.unit, ()), fix=fix)
    return scenario.autopilot.estimator


def _declared_fields(sensor: Any) -> dict[str, Quantity]:
    """Return the declarations of a sensor's fields by name; empty for a sensor that measures no motion."""
    try:
        measured = jax.eval_shape(sensor.measure, no_motion())
    except AttributeError:  # without `measure`, or with another input
        return {}
    return {path: declared for path, _, declared in leaves(measured) if isinstance(declared, Quantity)}


def check_choice(mapping: Path | None, scenario: str | None, estimator: str | None, settings: Any, parts: Any) -> None:
    """Check that the options of `trimtab replay` do not conflict.

    Raises:
        InputError: conflicting or missing options, with the fix.
    """
    if mapping is None:
        if settings:
            fix = "use --with PATH=VALUE, which changes the recorded autopilot"
            raise InputError("--set", "needs --map, because --set changes the scenario of a foreign log", fix=fix)
        return
    if (scenario is None) == (estimator is None):
        problem = "exclude each other" if scenario else "a foreign log contains no estimator, so one must be given"
        fix = "give --scenario SCENARIO, to use the scenario's estimator, or --estimator module:factory"
        raise InputError("--scenario, --estimator", problem, fix=fix)
    if parts:
        raise InputError(
            "--with",
            "cannot be combined with --map, because --with changes the autopilot of a trimtab log",
            fix="change the scenario: --set PATH=VALUE",
        )
    if settings and scenario is None:
        raise InputError("--set", "needs a scenario", fix="add --scenario SCENARIO, or set the value in the factory")

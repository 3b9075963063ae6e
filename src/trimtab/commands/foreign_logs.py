"""Logs of other systems in a verb: read by a mapping, listed without one, and the estimator that goes over them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.commands.output import new_table, print_table
from trimtab.core.errors import InputError
from trimtab.logs.foreign import detect_format, is_own_log, list_topics, read_foreign
from trimtab.logs.foreign.tables import TopicSummary
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.scenarios.build import build

FIELDS_SHOWN = 8
"""Fields of a topic that the table has room for."""


def read_any_log(file: Path, mapping: Path | None, *, quiet: bool = False) -> Log:
    """A log of ours, or a foreign one by its mapping.

    Args:
        file: to read.
        mapping: None for a log of ours; for a foreign one its topics are then printed.
        quiet: print nothing.

    Raises:
        InputError: a foreign log without a mapping, and whatever reading refuses.
    """
    if mapping is not None:
        return read_foreign(file, mapping)
    if is_own_log(file):
        return read_mcap(file)
    kind, topics = detect_format(file).name, list_topics(file)
    if not quiet:
        _print_topics(f"{file.name}: {kind}", topics)
    fix = f"write a mapping, docs page Foreign logs, then  trimtab replay {file} --map MAP.toml --scenario SCENARIO"
    names = [topic.name for topic in topics]
    raise InputError(f"log file '{file}'", f"is of another system: {kind}", choices=names if quiet else (), fix=fix)


def _print_topics(title: str, topics: list[TopicSummary]) -> None:
    table = new_table("topic", ">rows", ">Hz", "fields", title=title.replace("[", r"\["), unwrapped=("topic",))
    for topic in topics:
        more = len(topic.fields) - FIELDS_SHOWN
        fields = " ".join(topic.fields[:FIELDS_SHOWN]) + (f" and {more} more" if more > 0 else "")
        cells = topic.name, str(topic.rows), f"{topic.rate:.4g}", fields
        table.add_row(*(cell.replace("[", r"\[") for cell in cells))
    print_table(table)


def scenario_estimator(name: str, settings: Mapping[str, str]) -> Any:
    """The estimator that a scenario flies, with its settings."""
    return build(name, settings).autopilot.estimator


def check_choice(mapping: Path | None, scenario: str | None, estimator: str | None, settings: Any, parts: Any) -> None:
    """Refuse options of `trimtab replay` that do not go together.

    Raises:
        InputError: says which to leave out, or what to add.
    """
    if mapping is None:
        if settings:
            fix = "say --with PATH=VALUE, which changes the recorded autopilot"
            raise InputError("--set", "is for the scenario of a foreign log, with --map", fix=fix)
        return
    if (scenario is None) == (estimator is None):
        problem = "both are named" if scenario else "a foreign log says nothing of an estimator, and none is named"
        fix = "add one of them: --scenario SCENARIO, whose estimator is taken, or --estimator module:factory"
        raise InputError("--scenario, --estimator", problem, fix=fix)
    if parts:
        raise InputError("--with", "is for recorded autopilots", fix="change the scenario's: --set PATH=VALUE")
    if settings and scenario is None:
        raise InputError("--set", "is for a scenario", fix="name one with --scenario, or set it in the factory")

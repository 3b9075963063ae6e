"""Command line options: each has one meaning in all verbs, and applicable options are in every verb."""

from collections import defaultdict

import click
import pytest
from click.testing import CliRunner

from trimtab.cli import main

VIRTUAL = ("run", "budget", "campaign", "falsify", "rare", "map", "tune")
"""Verbs that fly in virtual time."""
LOOPS = (*VIRTUAL, "export", "firmware", "fly", "vehicle", "console", "linearise", "identify", "inject")
"""Verbs that build a scenario's loop."""
TALKS = ("console", "calibrate measure", "completion")
"""Verbs whose standard output is a conversation, or a script, and no result."""


def iter_verbs(group, context, path=()):
    """Words of each verb, and its command."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from iter_verbs(command, click.Context(command, parent=context), (*path, name))
        else:
            yield " ".join((*path, name)), command


def read_verbs():
    return dict(iter_verbs(main, click.Context(main)))


def read_options(command):
    """Name -> option, each long name of it."""
    options = [p for p in command.params if isinstance(p, click.Option)]
    return {name: option for option in options for name in option.opts if name.startswith("--")}


def meaning(option):
    """What an option is, so far that two of one meaning agree: how its help begins, and whether it takes a value."""
    head = (option.help or "").split(" ", 1)[0].rstrip(":.,;")
    return head, option.is_flag, option.multiple


def group_meanings(verbs):
    """Option -> meaning -> verbs."""
    meanings = defaultdict(lambda: defaultdict(list))
    for verb, command in verbs.items():
        for name, option in read_options(command).items():
            meanings[name][meaning(option)].append(verb)
    return meanings


def test_option_has_one_meaning_in_all_verbs():
    several = {name: dict(of) for name, of in group_meanings(read_verbs()).items() if len(of) > 1}
    assert several == {}


@pytest.mark.parametrize("group", ["", "calibrate"])
def test_list_of_commands_cuts_no_summary_at_80_columns(group):
    done = CliRunner().invoke(main, [*group.split(), "--help"], terminal_width=80)
    cut = [line for line in done.output.partition("Commands:")[2].splitlines() if line.endswith("...")]
    assert "Commands:" in done.output
    assert cut == []


def test_every_option_has_a_help_text():
    verbs = read_verbs()
    mute = [
        f"{v} {name}" for v, c in verbs.items() for name, o in read_options(c).items() if not (o.help or "").strip()
    ]
    assert mute == []


@pytest.mark.parametrize(
    ("wanted", "verbs"),
    [
        (("--set", "--calibration", "--reference", "--navigation"), LOOPS),
        (("--duration", "--fault", "--without", "--json"), VIRTUAL),
        (("--seed",), (*VIRTUAL, "demo", "export", "firmware", "fly", "vehicle", "console")),
        (("--threads",), ("campaign", "falsify", "rare", "map", "tune")),
        (("--runs",), ("budget", "campaign", "falsify", "rare", "map", "tune")),
        (("--plot",), ("run", "budget", "falsify", "map", "tune", "linearise", "plan", "replay", "link-test")),
        (("--duration",), ("fly", "vehicle")),
    ],
    ids=lambda value: value[0],
)
def test_verbs_have_all_applicable_options(wanted, verbs):
    known = read_verbs()
    assert [f"{v} {name}" for v in verbs for name in wanted if name not in read_options(known[v])] == []


def test_every_verb_has_json_option():
    assert [v for v, c in read_verbs().items() if "--json" not in read_options(c) and v not in TALKS] == []


def test_every_writing_verb_has_overwrite_option():
    writes = {v: read_options(c) for v, c in read_verbs().items() if {"--out", "--plot"} & set(read_options(c))}
    assert [v for v, options in writes.items() if "--overwrite" not in options] == []


def test_rule_detects_different_meanings_of_one_option():
    one = click.Command("one", params=[click.Option(["--only"], help="Only this.")])
    two = click.Command("two", params=[click.Option(["--only"], is_flag=True, help="Only this.")])
    three = click.Command("three", params=[click.Option(["--only"], help="Number of them.")])
    assert len(group_meanings({"one": one, "two": two, "three": three})["--only"]) == 3

"""Group of all subcommands. Each is a file of this folder with a click command, imported when the subcommand is typed.

Exit codes: 0 success; 1 completed with a negative result; 2 invalid input; 130 stopped by Ctrl-C; 143 by SIGTERM. With
``--json`` an error is also printed as an object on standard output. Names are checked before a subcommand is imported,
so that a typo is reported at once.
"""

import importlib
import inspect
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from trimtab.commands import typed_names
from trimtab.commands.declared_options import parse_words
from trimtab.commands.end_signals import TerminatedError, end_on_signals
from trimtab.commands.jax_platform import choose_platform
from trimtab.commands.output import print_json
from trimtab.commands.standard_streams import flush_output, replace_unprintable, report_failure
from trimtab.core.errors import InputError, Spelling, spell_with
from trimtab.core.suggestions import closest

WORDS = "trimtab.words"
"""Key under which the click context stores the words typed after `trimtab`."""
BEGIN = "new vehicle my_bike"
SYNONYMS = {
    "bode": "linearise",
    "codegen": "export",
    "create": BEGIN,
    "diff": "compare",
    "draw": "plot",
    "help": "--help",
    "init": BEGIN,
    "linearize": "linearise",
    "monte-carlo": "campaign",
    "optimise": "tune",
    "optimize": "tune",
    "scenarios": "list",
    "scaffold": BEGIN,
    "sim": "run",
    "simulate": "run",
    "sweep": "map",
    "verify": "export --verify DIR",
    "version": "--version",
}
"""Synonym for a subcommand -> words to type instead."""

OPTIONS = {
    "settings": "--set",
    "gains": "--gain",
    "limits": "--limit",
    "integrals": "--integrate",
    "faults": "--fault",
    "fault_ranges": "--fault-range",
    "metrics": "--metric",
    "paths": "--fit",
    "held_out": "--judge-runs",
    "states": "--state",
    "inputs": "--input",
    "outputs": "--output",
    "folder": "--out",
    "file": "--out",
}
"""Argument of a library function -> name of the command-line option, if the two names differ."""


class Verbs(click.Group):
    """Subcommands: ``link-test`` is `command` in ``link_test.py``. Invalid input exits with code 2 and a fix."""

    def __init__(self, names: Sequence[str], **options: Any) -> None:
        super().__init__(commands={name: click.Command(name) for name in names}, **options)

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command line. If output cannot be written, print one line and end with exit code 1."""
        replace_unprintable()
        is_program = (
            not args and extra.get("args") is None
        )  # no arguments passed: the command line of this process is run
        try:
            with end_on_signals(is_program):
                return super().main(*args, **extra)
        except OSError as error:
            report_failure(error)
            sys.exit(1)
        finally:
            if not flush_output():
                sys.exit(1)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the subcommand with this name. Return None if the name is unknown."""
        if cmd_name not in self.commands:
            return None
        return importlib.import_module(f"{__package__}.{cmd_name.replace('-', '_')}").command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands.

        Help texts are read from the source files, because importing all subcommands would take seconds.
        """
        listed = click.Group(commands={name: click.Command(name, help=read_help(name)) for name in self.commands})
        listed.format_commands(ctx, formatter)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the typed words, and store the unchanged words in the context."""
        ctx.meta[WORDS] = list(args)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return a subcommand, after a check of its name, the scenario, the settings and the platform of JAX.

        The incomplete line that a shell completes is not checked.

        Raises: InputError with the nearest names, or for a platform that JAX cannot use.
        """
        if ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        if args[0] not in self.commands and not args[0].startswith("-"):
            raise _unknown_verb(args[0], tuple(self.commands))
        typed_names.check_names(args, self._parse_words(ctx, args))
        choose_platform(args)
        return super().resolve_command(ctx, args)

    def _parse_words(self, ctx: click.Context, args: list[str]) -> list[str] | None:
        """Return the words after a subcommand that are not options; None if these are not known without an import."""
        verb, *words = args
        if verb not in self.commands or not find_file(verb).is_file():
            return None
        return parse_words(find_file(verb), verb, read_help(verb), words, ctx)

    def _find_context(self, ctx: click.Context) -> click.Context:
        """Return the click context of the typed subcommand.

        Click's error about a missing option value lacks the context.
        """
        name = ctx.invoked_subcommand or ""
        verb = self.get_command(ctx, name)
        return ctx if verb is None else click.Context(verb, parent=ctx, info_name=name)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the subcommand that was typed."""
        try:
            with spell_with(spell_option):
                return super().invoke(ctx)
        except InputError as error:
            _print_refusal(ctx, error.part, error.problem, error.choices, error.fix)
            click.echo(f"error: {error}", err=True)
            if error.part.startswith("--set "):
                typed_names.learn_paths(ctx.meta[WORDS])
            ctx.exit(2)
        except click.UsageError as error:
            error.ctx = error.ctx or self._find_context(ctx)
            where, fix = _find_example(error.ctx)
            _print_refusal(ctx, where, error.format_message(), (), fix)
            error.show()
            click.echo(f"Fix: {fix}", err=True)
            ctx.exit(2)
        except TerminatedError as end:
            click.echo(f"stopped by {end}", err=True)
            ctx.exit(end.exit_code)
        except KeyboardInterrupt:
            click.echo("stopped by Ctrl-C", err=True)
            ctx.exit(130)


def spell_option(python: Spelling, name: str, value: Any, path: str | None) -> str:
    """Spell an argument of the library as an option: ``--set autopilot.period='20 ms'``."""
    if value is False:
        return f"--no-{name.replace('_', '-')}"
    if name == "settings" and path is not None and f"--{path}" in _running_options():
        name, path = path, None
    option = OPTIONS.get(name, f"--{name.replace('_', '-')}")
    if value is None:
        return option if path is None else f"{option} {path}"
    if isinstance(value, list):
        return " ".join(spell_option(python, name, one, path) for one in value)
    if value is True:
        return option
    if path is None:
        return f"{option} {_quote(str(value))}"
    is_plain = _quote(path) == path and name == "settings"
    return f"{option} {path}={_quote(str(value))}" if is_plain else f"{option} {_quote(f'{path}={value}')}"


def _running_options() -> set[str]:
    """Return the options of the running subcommand."""
    context = click.get_current_context(silent=True)
    return {word for p in context.command.params for word in p.opts} if context is not None else set()


def _quote(text: str) -> str:
    """Quote a word of a command line if a shell would split it."""
    return text if re.fullmatch(r"[\w.,:/%@+=…-]+", text) else shlex.quote(text)


def _find_example(ctx: click.Context) -> tuple[str, str]:
    """Return the command that had an error, and the first example in the command's help."""
    where = f"trimtab{ctx.command_path.removeprefix(ctx.find_root().command_path)}"
    for line in (ctx.command.help or "").splitlines():
        words = re.split(r"\s{3,}", line.strip())[0]
        if words.startswith(f"{where} "):
            return where, words
    return where, f"{where} --help"


def _print_refusal(ctx: click.Context, part: str, problem: str, choices: Sequence[str], fix: str) -> None:
    """Print the error as JSON if ``--json`` was typed."""
    if "--json" in ctx.meta[WORDS]:
        refused = {"part": part, "problem": problem, "choices": list(choices), "fix": fix}
        print_json({"error": refused}, verb="error")


def _unknown_verb(name: str, verbs: Sequence[str]) -> InputError:
    near = SYNONYMS.get(name.lower()) or next(iter(closest(name, verbs, 1)), "--help")
    return InputError(f"trimtab {name}", "no such subcommand", choices=verbs, fix=f"trimtab {near}")


def read_help(name: str) -> str:
    """Return the help text of a subcommand: the docstring of `command` in the subcommand's file."""
    docstring = re.search(r'^def command\(.*?"""(.*?)"""', read_source(name), re.DOTALL | re.MULTILINE)
    assert docstring, f"{name}: its `command` has no docstring"
    return inspect.cleandoc(docstring[1])


def read_source(name: str) -> str:
    """Return the source code of a subcommand's file."""
    return find_file(name).read_text(encoding="utf-8")


def find_file(name: str) -> Path:
    """Return the path of the file that contains a subcommand."""
    return Path(__file__).with_name(f"{name.replace('-', '_')}.py")

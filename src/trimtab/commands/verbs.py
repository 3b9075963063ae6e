"""The group of verbs: each is a file of this folder, which holds its click command and is imported when it is typed.

Exit code 0: done and good; 1: done and failed; 2: refused input.
"""

import importlib
import inspect
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from trimtab.core.errors import InputError


class Verbs(click.Group):
    """Verbs by name: ``link-test`` is `command` in ``link_test.py``. Refused input ends with the fix, exit code 2."""

    def __init__(self, names: Sequence[str], **options: Any) -> None:
        super().__init__(commands={name: click.Command(name) for name in names}, **options)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of that name, imported; None where there is none."""
        if cmd_name not in self.commands:
            return None
        return importlib.import_module(f"{__package__}.{cmd_name.replace('-', '_')}").command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what each verb does. It is read from the files: to import them all would take seconds."""
        listed = click.Group(commands={name: click.Command(name, help=read_help(name)) for name in self.commands})
        listed.format_commands(ctx, formatter)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb that was typed."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            click.echo(f"error: {error}", err=True)
            ctx.exit(2)


def read_help(name: str) -> str:
    """The help of a verb: the docstring of `command` in its file."""
    text = Path(__file__).with_name(f"{name.replace('-', '_')}.py").read_text(encoding="utf-8")
    docstring = re.search(r'^def command\(.*?"""(.*?)"""', text, re.DOTALL | re.MULTILINE)
    assert docstring, f"{name}: its `command` has no docstring"
    return inspect.cleandoc(docstring[1])

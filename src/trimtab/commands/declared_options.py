"""Arguments and options of a subcommand, read from the source file without an import, so that a typo is found fast."""

import ast
import builtins
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import click

from trimtab.commands import options


class _Names(dict[str, Any]):
    """Names that a subcommand's source file uses, with values.

    A name that is unknown without an import has the value "".
    """

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, "")


def parse_words(file: Path, verb: str, help: str, words: list[str], parent: click.Context) -> list[str] | None:
    """Return the typed words that are not options, or None if the subcommand's options are known only after an import.

    Args:
        file: source file of the subcommand, with its function `command`.
        verb: name of the subcommand.
        help: help text of the subcommand. An error shows an example from this text.
        words: words typed after the subcommand.
        parent: click context of the program.

    Raises: click.UsageError for an unknown option, an option without its value, or a value that is not a number.
    """
    read = _read_command(file, verb, help)
    if read is None:
        return None
    context = click.Context(read, parent=parent, info_name=verb)
    switches = click.Command(verb, params=[p for p in read.params if isinstance(p, click.Option)])
    try:
        values, plain, _ = switches.make_parser(context).parse_args(list(words))
        for option in switches.params:
            if option.name in values and _is_number(option.type):
                option.type_cast_value(context, values[option.name])
        return plain
    except click.UsageError as error:
        error.ctx = context
        raise


def _is_number(kind: Any) -> bool:
    """Return True if an option's type is a number whose limits are known without an import."""
    limits = getattr(kind, "min", None), getattr(kind, "max", None)
    is_known = all(limit is None or isinstance(limit, int | float) for limit in limits)
    return is_known and isinstance(kind, (type(click.INT), type(click.FLOAT)))


@cache
def _read_command(file: Path, verb: str, help: str) -> click.Command | None:
    """Return a click command that only parses the subcommand's options.

    Return None for a group or an unknown decorator.
    """
    tree = ast.parse(file.read_text(encoding="utf-8"))
    own = next((n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "command"), None)
    if own is None or ast.unparse(own.decorator_list[0]) != "click.command()":
        return None
    declare: Callable[..., Any] = lambda: None  # noqa: E731
    names = _Names({**vars(options), "click": click})
    try:
        for decorator in reversed(own.decorator_list[1:]):
            code = compile(ast.Expression(decorator), str(file), "eval")
            declare = eval(code, {}, names)(declare)
    except (TypeError, ValueError, AttributeError):  # the file needs an imported name, which is empty here
        return None
    parameters: list[click.Parameter] = getattr(declare, "__click_params__", [])
    return click.Command(verb, params=parameters[::-1], help=help)

"""Errors raised before a run. Each error names the part, the value, the valid choices and the fix.

Inside the loop, no error is raised. Staleness, rejection and saturation are reported as signals.

An error suggests a fix in the form that the user types: ``runs=1000`` in Python, ``--runs 1000`` at the command line.
Code that raises an error writes `argument("runs", 1000)`. The command line sets its own form with `spell_with`.
"""

import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.core.control_characters import KEPT, show_controls


class InputError(ValueError):
    """Error for an input that is rejected before a run starts.

    >>> from trimtab import InputError, build
    >>> try:
    ...     build("hovercraft/spin", {"world.vehicle.mass": "3 m"})
    ... except InputError as error:
    ...     print(error.problem, error.choices)
    'm' is not a unit of this quantity, whose unit is kg ('kg', 'g', 'lb')

    Args:
        part: the part that rejects the value, e.g. ``world.vehicle.mass`` or ``scenario 'hovercraft/spin'``.
        problem: what is wrong, with the value.
        choices: the valid values, if they can be listed.
        fix: what to type or write instead.
    """

    def __init__(self, part: str, problem: str, *, choices: Iterable[str] = (), fix: str = "") -> None:
        self.part, self.problem, self.choices, self.fix = part, problem, tuple(choices), fix
        text = f"{show_controls(part)}: {show_controls(problem, KEPT).rstrip('.')}."
        if self.choices:
            text += f"\nChoices: {show_controls(', '.join(self.choices))}."
        if fix:
            text += f"\nFix: {show_controls(fix, KEPT)}"
        super().__init__(text)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the data from which pickle rebuilds the error, so that a worker process can transfer the complete
        error."""
        return partial(type(self), choices=self.choices, fix=self.fix), (self.part, self.problem)


Spelling = Callable[[str, Any, str | None], str]
"""Function that returns an argument as the user types it, from its Python name, value (None: name only) and path."""


def argument(name: str, value: Any, path: str | None = None) -> str:
    """Return an argument as the user has to type it, for the fix of an error.

    >>> argument("runs", 1000), argument("settings", "20 ms", "autopilot.period")
    ('runs=1000', 'settings={"autopilot.period": "20 ms"}')

    Args:
        name: name of the parameter in Python.
        value: a number, True or False, a text, or a list of texts for an argument that may be repeated.
        path: path of the setting, for an argument that has one value for each path, such as ``settings``.
    """
    return _SPELLING.get()(name, value, path)


def argument_name(name: str, of: str | None = None) -> str:
    """Return the name of an argument as the user types it. of: path or text that selects one value of several."""
    return _SPELLING.get()(name, None, of)


def command(shell: str, python: str) -> str:
    """Return `shell` if the user works at the command line, or `python` if the user works in Python."""
    return python if argument_name("name") == "name" else shell


@contextmanager
def spell_with(spelling: Callable[[Spelling, str, Any, str | None], str]) -> Iterator[None]:
    """Return a context in which `spelling` spells the arguments in this thread's messages.

    The first argument of `spelling` is the function that spells arguments outside the context.
    """
    token = _SPELLING.set(partial(spelling, _SPELLING.get()))
    try:
        yield
    finally:
        _SPELLING.reset(token)


def spell_python(name: str, value: Any, path: str | None) -> str:
    """Return an argument as a user types it in Python, e.g. `runs=1000`, or only its name if `value` is None."""
    if value is None:
        return name if path is None else f"{name} {path}"
    values = [_quote(v) for v in value] if isinstance(value, list) else _quote(value)
    text = f"[{', '.join(values)}]" if isinstance(values, list) else values
    return f"{name}={text}" if path is None else f'{name}={{"{path}": {_quote(str(value))}}}'


def _quote(value: Any) -> str:
    return (f'"{value}"' if '"' not in value else repr(value)) if isinstance(value, str) else str(value)


_SPELLING: ContextVar[Spelling] = ContextVar("spelling", default=spell_python)
"""Spelling of arguments in messages, one for each thread, because several commands may run at once in virtual time."""


def install_command(extra: str = "", package: str = "trimtab") -> str:
    """Return the command that installs an extra for the running Python: ``python -m pip install "trimtab[logs]"``.

    extra: name of the extra; empty for the package itself.
    """
    import shutil  # imported here: only needed if a package is missing

    python, here = Path(sys.executable), Path.cwd()
    if shutil.which("python") == str(python):
        word = "python"
    else:
        word = shlex.quote(str(python.relative_to(here) if python.is_relative_to(here) else python))
    wanted = f'"{package}[{extra}]"' if extra else package
    return f"{word} -m pip install {wanted}"

"""Errors before the loop: each names the part, the value, the valid choices and the fix.

Inside the loop nothing raises; staleness, rejection and saturation are signals.

A fix is spelled in its reader's language: ``runs=1000`` in Python, ``--runs 1000`` at the command line. Who raises it
says `argument("runs", 1000)`; who has another reader than Python says so by `spell_with`.
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
    """Input refused before anything ran.

    >>> from trimtab import InputError, build
    >>> try:
    ...     build("hovercraft/spin", {"world.vehicle.mass": "3 m"})
    ... except InputError as error:
    ...     print(error.problem, error.choices)
    'm' is not a unit of this quantity, which is in kg ('kg', 'g', 'lb')

    Args:
        part: what refuses, e.g. ``world.vehicle.mass`` or ``scenario 'hovercraft/spin'``.
        problem: what is wrong, with the value.
        choices: the valid values, where they can be listed.
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
        """Rebuild from the parts, so that it passes from a worker process whole."""
        return partial(type(self), choices=self.choices, fix=self.fix), (self.part, self.problem)


Spelling = Callable[[str, Any, str | None], str]
"""Function that writes an argument. It takes the name in Python, the value (None: name only), and the path."""


def argument(name: str, value: Any, path: str | None = None) -> str:
    """Return an argument as the reader types it, for a fix.

    >>> argument("runs", 1000), argument("settings", "20 ms", "autopilot.period")
    ('runs=1000', 'settings={"autopilot.period": "20 ms"}')

    Args:
        name: of the parameter in Python.
        value: a number, True or False, a text, or a list of texts where it may be given several times.
        path: where the argument has a value for each path, that one.
    """
    return _SPELLING.get()(name, value, path)


def argument_name(name: str, of: str | None = None) -> str:
    """Return the argument itself, for the part that refuses. of: which of several, by its path or its text."""
    return _SPELLING.get()(name, None, of)


def command(shell: str, python: str) -> str:
    """Return what the reader types: a command of the shell, or a call in Python."""
    return python if argument_name("name") == "name" else shell


@contextmanager
def spell_with(spelling: Callable[[Spelling, str, Any, str | None], str]) -> Iterator[None]:
    """Within it, in this thread, arguments are written so. It is given how they are written without it, too, first."""
    token = _SPELLING.set(partial(spelling, _SPELLING.get()))
    try:
        yield
    finally:
        _SPELLING.reset(token)


def spell_python(name: str, value: Any, path: str | None) -> str:
    """Return an argument as in Python."""
    if value is None:
        return name if path is None else f"{name} {path}"
    values = [_quote(v) for v in value] if isinstance(value, list) else _quote(value)
    text = f"[{', '.join(values)}]" if isinstance(values, list) else values
    return f"{name}={text}" if path is None else f'{name}={{"{path}": {_quote(str(value))}}}'


def _quote(value: Any) -> str:
    return (f'"{value}"' if '"' not in value else repr(value)) if isinstance(value, str) else str(value)


_SPELLING: ContextVar[Spelling] = ContextVar("spelling", default=spell_python)
"""Spelling of arguments in messages. Each thread has its own: several commands run side by side in virtual time."""


def install_command(extra: str = "", package: str = "trimtab") -> str:
    """Return the command that installs an extra for the running Python: ``python -m pip install "trimtab[logs]"``.

    extra: of the package; none: the package itself.
    """
    import shutil  # only where something is missing

    python, here = Path(sys.executable), Path.cwd()
    if shutil.which("python") == str(python):
        word = "python"
    else:
        word = shlex.quote(str(python.relative_to(here) if python.is_relative_to(here) else python))
    wanted = f'"{package}[{extra}]"' if extra else package
    return f"{word} -m pip install {wanted}"

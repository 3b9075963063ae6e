"""Errors before the loop: each names the part, the value, the valid choices and the fix.

Inside the loop nothing raises; staleness, rejection and saturation are signals.
"""

from collections.abc import Iterable
from functools import partial
from typing import Any


class InputError(ValueError):
    """Input refused before anything ran.

    Args:
        part: what refuses, e.g. ``world.vehicle.mass`` or ``scenario 'hovercraft/spin'``.
        problem: what is wrong, with the value.
        choices: the valid values, where they can be listed.
        fix: what to type or write instead.
    """

    def __init__(self, part: str, problem: str, *, choices: Iterable[str] = (), fix: str = "") -> None:
        self.part, self.problem, self.choices, self.fix = part, problem, tuple(choices), fix
        text = f"{part}: {problem.rstrip('.')}."
        if self.choices:
            text += f"\nChoices: {', '.join(self.choices)}."
        if fix:
            text += f"\nFix: {fix}"
        super().__init__(text)

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild from the parts, so that it passes from a worker process whole."""
        return partial(InputError, choices=self.choices, fix=self.fix), (self.part, self.problem)


def closest(name: str, choices: Iterable[str], n: int = 3) -> list[str]:
    """Up to n choices that look like name, best first; empty when none does."""
    import difflib  # only after a mistake

    names = list(choices)
    by_tail = [c for c in names if c.rsplit(".", 1)[-1] == name.rsplit(".", 1)[-1]]
    near = difflib.get_close_matches(name, names, n=n, cutoff=0.5)
    return list(dict.fromkeys([*by_tail, *near]))[:n]

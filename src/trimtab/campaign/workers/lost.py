"""Who flies the blocks of a campaign: this process (`here`) or others (`cluster`)."""

from collections.abc import Callable, Generator
from typing import Any

from trimtab.campaign.workers.ready import Ready

Blocks = list[tuple[int, int]]
Flown = Generator[tuple[int, dict[str, Any]], None, None]
Workers = Callable[[Ready, Blocks, str], Flown]
"""Flies blocks, each (first, last + 1), on the backend "c" or "jax": first run and columns of each, in any order."""


class WorkersLost(Exception):
    """Those who fly are gone; the campaign says how many runs are kept. part, fix: as of an InputError."""

    def __init__(self, part: str, problem: str, fix: str) -> None:
        super().__init__(problem)
        self.part, self.fix = part, fix

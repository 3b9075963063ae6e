"""A campaign in this process: a block flies while the one before is being written; Ctrl-C breaks it off."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from trimtab.campaign.block import FEWEST, Ready, fly_block
from trimtab.campaign.workers import Blocks, Flown, Workers


class _BrokenOff(Exception):
    """Nobody waits for the block any more."""


def here(threads: int | None = None, progress: Callable[[int], None] | None = None) -> Workers:
    """Workers in this process.

    Args:
        threads: as many as there are cores when None.
        progress: called a few times a second with the number of rows that are done, those of before among them.
    """

    def fly(ready: Ready, blocks: Blocks, used: str) -> Flown:
        ended, before = threading.Event(), ready.plan.runs - sum(last - first for first, last in blocks)

        def check(done: int) -> None:
            if ended.is_set():
                raise _BrokenOff
            if progress is not None:
                progress(before + done)

        def block(first: int, last: int) -> dict[str, Any]:
            nonlocal before
            made = []
            for start, end in _pieces(first, last, used):
                check(0)
                made.append(fly_block(ready, start, end, backend=used, threads=threads, progress=check))
                before += end - start
            return {name: np.concatenate([columns[name] for columns in made]) for name in made[0]}

        with ThreadPoolExecutor(1) as pilot:
            try:
                coming: Any = None
                for first, last in blocks:
                    now, coming = coming, (first, pilot.submit(block, first, last))
                    if now is not None:
                        yield now[0], now[1].result()
                if coming is not None:
                    yield coming[0], coming[1].result()
            finally:
                ended.set()

    return fly


def _pieces(first: int, last: int, used: str) -> Blocks:
    """What is flown in one call: JAX can't be broken off, and a processor gains nothing by more runs at once."""
    size = FEWEST if used == "jax" and jax.default_backend() == "cpu" else last - first
    return [(start, min(start + size, last)) for start in range(first, last, size)]

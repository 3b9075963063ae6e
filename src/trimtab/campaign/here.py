"""A campaign in this process: a block flies while the one before is being written; Ctrl-C breaks it off."""

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from trimtab.campaign.block import FEWEST, Ready, fly_block
from trimtab.campaign.workers import Blocks, Flown, Workers


class _BrokenOff(Exception):
    """Nobody waits for the block any more."""


def here(threads: int | None = None) -> Workers:
    """Workers in this process; as many threads as there are cores when None."""

    def fly(ready: Ready, blocks: Blocks, used: str) -> Flown:
        ended = threading.Event()

        def check(_: int) -> None:
            if ended.is_set():
                raise _BrokenOff

        def block(first: int, last: int) -> dict[str, Any]:
            made = []
            for start, end in _pieces(first, last, used):
                check(start)
                made.append(fly_block(ready, start, end, backend=used, threads=threads, progress=check))
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

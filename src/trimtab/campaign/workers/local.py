"""A campaign in this process: blocks fly while those before are measured and written; Ctrl-C breaks it off."""

import functools
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from trimtab.campaign.workers.block import BlockResults, Blocks, Workers, fly_block
from trimtab.campaign.workers.prepare import FEWEST, PreparedCampaign

AHEAD = 2
"""Blocks under way: one's metrics are taken while the other flies on all cores."""


class _CampaignAborted(Exception):
    """Nobody waits for the block any more."""


class RowCount:
    """Tells how many rows are done, never fewer than before: those that fly count before they are kept."""

    def __init__(self, progress: Callable[[int], None] | None) -> None:
        self._progress, self._alone, self._most = progress, threading.Lock(), 0
        self._pieces: dict[int, int] = {}

    def fly(self, start: int, done: int) -> None:
        """Of the piece that starts there, so many have flown; start is -1 for what was there before."""
        with self._alone:
            self._pieces[start] = max(self._pieces.get(start, 0), done)  # runs of other choices begin at 0 again
            self._tell(sum(self._pieces.values()))

    def keep(self, done: int) -> None:
        """So many are kept."""
        with self._alone:
            self._tell(done)

    def _tell(self, done: int) -> None:
        if self._progress is not None and done >= self._most:
            self._most = done
            self._progress(done)


def local_workers(threads: int | None = None, count: RowCount | None = None) -> Workers:
    """Workers in this process.

    Args:
        threads: as many as there are cores when None.
        count: hears a few times a second how many rows have flown.
    """
    rows = count or RowCount(None)

    def fly(ready: PreparedCampaign, blocks: Blocks, backend: str) -> BlockResults:
        aborted = threading.Event()
        rows.fly(-1, ready.plan.runs - sum(last - first for first, last in blocks))

        def check(start: int, done: int) -> None:
            if aborted.is_set():
                raise _CampaignAborted
            rows.fly(start, done)

        def block(first: int, last: int) -> dict[str, Any]:
            pieces = []
            for start, end in _split_block(first, last, backend):
                tell = functools.partial(check, start)
                tell(0)
                pieces.append(fly_block(ready, start, end, backend=backend, threads=threads, progress=tell))
                tell(end - start)
            return {name: np.concatenate([columns[name] for columns in pieces]) for name in pieces[0]}

        with ThreadPoolExecutor(AHEAD) as pool:
            flying: deque[tuple[int, Future[dict[str, Any]]]] = deque()
            try:
                for first, last in blocks:
                    flying.append((first, pool.submit(block, first, last)))
                    if len(flying) > AHEAD:
                        start, columns = flying.popleft()
                        yield start, columns.result()
                for start, columns in flying:
                    yield start, columns.result()
            finally:
                aborted.set()

    return fly


def _split_block(first: int, last: int, backend: str) -> Blocks:
    """What is flown in one call: JAX can't be broken off, and a processor gains nothing by more runs at once."""
    size = FEWEST if backend == "jax" and jax.default_backend() == "cpu" else last - first
    return [(start, min(start + size, last)) for start in range(first, last, size)]

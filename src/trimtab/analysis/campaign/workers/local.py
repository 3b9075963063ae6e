"""Workers in this process. One block of runs flies while the metrics of another are computed. Ctrl-C stops both."""

import functools
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from trimtab.analysis.campaign.workers.block import BlockResults, Blocks, Workers, fly_block
from trimtab.analysis.campaign.workers.prepare import BLOCK_RUNS_MIN, PreparedCampaign

AHEAD = 2
"""Number of blocks in progress. Metrics of one block are computed while the next block flies on all cores."""


class _CampaignAborted(Exception):
    """Error raised in a worker to stop the worker's block, because the campaign has ended."""


class RowCount:
    """Progress of a campaign: number of flown rows (runs), which never decreases.

    A row counts as soon as its run is flown, before the row is stored.
    """

    def __init__(self, progress: Callable[[int], None] | None) -> None:
        self._progress, self._alone, self._most = progress, threading.Lock(), 0
        self._pieces: dict[int, int] = {}

    def fly(self, start: int, done: int) -> None:
        """Report that `done` runs, counted from run number `start`, are flown.

        start = -1 is used for the runs of earlier sessions.
        """
        with self._alone:
            self._pieces[start] = max(
                self._pieces.get(start, 0), done
            )  # runs with other choices of options begin at 0 again
            self._tell(sum(self._pieces.values()))

    def keep(self, done: int) -> None:
        """Report that `done` rows (runs) are stored."""
        with self._alone:
            self._tell(done)

    def _tell(self, done: int) -> None:
        if self._progress is not None and done >= self._most:
            self._most = done
            self._progress(done)


def local_workers(threads: int | None = None, count: RowCount | None = None) -> Workers:
    """Return a function that flies blocks of runs in this process.

    Args:
        threads: number of threads. None: one for each core.
        count: object to which the number of flown runs is reported a few times a second.
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
    """Split a block into the runs of each simulation call.

    On a CPU the calls of JAX have few runs, because a call cannot be interrupted and is not faster with more runs.
    """
    size = BLOCK_RUNS_MIN if backend == "jax" and jax.default_backend() == "cpu" else last - first
    return [(start, min(start + size, last)) for start in range(first, last, size)]

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


def local_workers(threads: int | None = None, progress: Callable[[int], None] | None = None) -> Workers:
    """Workers in this process.

    Args:
        threads: as many as there are cores when None.
        progress: called a few times a second with the number of rows that are done, those of before among them.
    """

    def fly(ready: PreparedCampaign, blocks: Blocks, used: str) -> BlockResults:
        ended, alone = threading.Event(), threading.Lock()
        flown = {-1: ready.plan.runs - sum(last - first for first, last in blocks)}

        def check(start: int, done: int) -> None:
            """Of the piece that starts there, so many are done."""
            if ended.is_set():
                raise _CampaignAborted
            if progress is not None:
                with alone:
                    flown[start] = max(flown.get(start, 0), done)  # runs of other choices begin at 0 again
                    progress(sum(flown.values()))

        def block(first: int, last: int) -> dict[str, Any]:
            made = []
            for start, end in _split_block(first, last, used):
                tell = functools.partial(check, start)
                tell(0)
                made.append(fly_block(ready, start, end, backend=used, threads=threads, progress=tell))
                tell(end - start)
            return {name: np.concatenate([columns[name] for columns in made]) for name in made[0]}

        with ThreadPoolExecutor(AHEAD) as pilots:
            coming: deque[tuple[int, Future[dict[str, Any]]]] = deque()
            try:
                for first, last in blocks:
                    coming.append((first, pilots.submit(block, first, last)))
                    if len(coming) > AHEAD:
                        now, columns = coming.popleft()
                        yield now, columns.result()
                for now, columns in coming:
                    yield now, columns.result()
            finally:
                ended.set()

    return fly


def _split_block(first: int, last: int, used: str) -> Blocks:
    """What is flown in one call: JAX can't be broken off, and a processor gains nothing by more runs at once."""
    size = FEWEST if used == "jax" and jax.default_backend() == "cpu" else last - first
    return [(start, min(start + size, last)) for start in range(first, last, size)]

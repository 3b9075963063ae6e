"""Who flies the blocks of a campaign: this process, with its threads and lanes, unless somebody else does."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from trimtab.campaign.block import Ready, fly_block

Blocks = list[tuple[int, int]]
Flown = Iterator[tuple[int, dict[str, Any]]]
Workers = Callable[[Ready, Blocks], Flown]
"""What flies blocks, each (first, last + 1): gives the first run and the columns of each, in any order."""


class _Ended(Exception):
    """The campaign is over; what flies need not land."""


def here(backend: str, threads: int | None, progress: Callable[[int], None] | None) -> Workers:
    """This process: a block flies while the one before is being written."""

    def fly(ready: Ready, blocks: Blocks) -> Flown:
        ended, kept = threading.Event(), ready.plan.runs - sum(last - first for first, last in blocks)

        def block(first: int, last: int, before: int) -> dict[str, Any]:
            def tell(done: int) -> None:
                if ended.is_set():
                    raise _Ended
                if progress is not None:
                    progress(before + done)

            return fly_block(ready, first, last, backend=backend, threads=threads, progress=tell)

        with ThreadPoolExecutor(1) as pilot:
            coming: deque[tuple[int, Any]] = deque()
            try:
                for first, last in blocks:
                    coming.append((first, pilot.submit(block, first, last, kept)))
                    kept += last - first
                    if len(coming) > 1:
                        now, columns = coming.popleft()
                        yield now, columns.result()
                for now, columns in coming:
                    yield now, columns.result()
            finally:
                ended.set()

    return fly

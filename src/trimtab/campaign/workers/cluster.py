"""A campaign on several machines: blocks flown by workers of dask.distributed, over TLS with certificates on both ends.

A worker is sent the name of a function of trimtab and plain data, the plan and two numbers; it builds the scenario
itself, and says so where its rows would not be bit-equal to those of the campaign's own machine.

Source: docs page, A campaign on several machines.
"""

import contextlib
import importlib.util
import logging
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

from trimtab.campaign.workers.fly_rows import about, fly_rows
from trimtab.campaign.workers.lost import Blocks, Flown, Workers, WorkersLost
from trimtab.campaign.workers.ready import Ready
from trimtab.campaign.workers.scheduler import REACHED, Place, greet, place_of
from trimtab.core.errors import InputError

SILENCE = 15.0
"""Seconds after which a scheduler that says nothing is asked, and in which it has to answer."""
PATIENCE = 60.0
"""Seconds that a campaign waits for a first worker, or for another when all are gone."""
AGAIN = "start the same command again: it goes on from there"


def cluster(uri: str, *, ca: str | Path = "", cert: str | Path = "", key: str | Path = "") -> Workers:
    """Workers of a cluster, to be given to `Campaign.run`.

    Args:
        uri: of its scheduler, e.g. tls://10.0.0.1:8786; tcp:// only within one machine.
        ca: PEM file of the authority that signed all certificates.
        cert, key: PEM files of this machine's certificate and of its private key.

    Raises: InputError for what can't be reached so; nothing is sent yet.
    """
    place = place_of(uri, {"--tls-ca": str(ca), "--tls-cert": str(cert), "--tls-key": str(key)})
    if importlib.util.find_spec("distributed") is None:
        raise InputError("--cluster", "needs dask.distributed", fix='pip install "trimtab[cluster]"')

    def fly(ready: Ready, blocks: Blocks, used: str) -> Flown:
        with _client(place) as client:
            yield from _flown(client, place, ready, blocks, used)

    return fly


@contextlib.contextmanager
def _client(place: Place) -> Iterator[Any]:
    """A client of the scheduler, which lets go of what it asked for in the end."""
    from dask.config import set as configured
    from distributed import Client, Security

    greet(place)
    security = Security(require_encryption=False)
    if place.files:
        ca, cert, key = place.files
        security = Security(tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True)
    timeouts = {"distributed.comm.timeouts.connect": f"{REACHED}s", "distributed.comm.timeouts.tcp": f"{SILENCE}s"}
    with configured(timeouts), _quiet():
        try:
            client = Client(place.uri, security=security, timeout=REACHED, set_as_default=False)
        except (OSError, TimeoutError) as error:
            raise InputError(
                f"--cluster {place.uri}", f"no scheduler answers: {error}", fix="dask scheduler …"
            ) from None
        try:
            yield client
        finally:
            client.close(timeout=3)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """What distributed logs of a lost line, page after page, the campaign says in one."""
    known = map(logging.getLogger, list(logging.root.manager.loggerDict))
    before = [(log, log.level) for log in known if log.name.partition(".")[0] == "distributed"]
    for log, _ in before:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in before:
            log.setLevel(level)


class _Watch:
    """Whether scheduler and workers are there. threads: of all workers, when last asked."""

    def __init__(self, client: Any, place: Place) -> None:
        self._client, self._part = client, f"--cluster {place.uri}"
        self._asked, self._seen, self.threads = 0.0, time.monotonic(), 0

    def look(self) -> None:
        """Ask now and then.

        Raises: WorkersLost.
        """
        if self._client.status != "running":
            raise WorkersLost(self._part, "the scheduler is gone", f"start it and its workers, then {AGAIN}")
        now = time.monotonic()
        if now - self._asked < (SILENCE if self.threads else 1.0):
            return
        try:
            found = self._client.sync(self._client.scheduler.ncores, callback_timeout=SILENCE)
        except Exception as error:  # whatever a line that breaks gives
            problem = f"the scheduler does not answer ({type(error).__name__})"
            raise WorkersLost(self._part, problem, f"look after it, then {AGAIN}") from None
        self._asked, self.threads = time.monotonic(), sum(found.values())
        if self.threads:
            self._seen = self._asked
        elif self._asked - self._seen > PATIENCE:
            problem = f"for {PATIENCE:g} s it had no worker"
            raise WorkersLost(self._part, problem, f"start some:  dask worker …, then {AGAIN}")


def _flown(client: Any, place: Place, ready: Ready, blocks: Blocks, used: str) -> Flown:
    """The blocks as they land; two for each thread are under way at once."""
    told, plain, waiting = about(ready, used), ready.plan.plain(), iter(blocks)
    flying: dict[Any, tuple[int, int]] = {}
    watch, landed = _Watch(client, place), threading.Event()
    try:
        while True:
            watch.look()
            for first, last in _some(waiting, max(2, 2 * watch.threads) - len(flying)):
                future = client.submit(fly_rows, plain, told, first, last, pure=False)
                future.add_done_callback(lambda _: landed.set())
                flying[future] = first, last
            if not flying:
                return
            landed.wait(1.0)
            landed.clear()
            for future in [f for f in flying if f.done()]:
                first, last = flying[future]
                columns = _columns(future, watch, (first, last))
                if columns is not None:
                    del flying[future]
                    future.release()
                    yield first, columns
    finally:
        flying.clear()  # the scheduler forgets what nobody waits for


def _some(waiting: Iterator[tuple[int, int]], count: int) -> Generator[tuple[int, int], None, None]:
    for _ in range(count):
        block = next(waiting, None)
        if block is None:
            return
        yield block


def _columns(future: Any, watch: _Watch, block: tuple[int, int]) -> Any:
    """Columns of a block; None where they got lost on the way, and are flown again."""
    from distributed import KilledWorker

    runs = f"runs {block[0]} to {block[1] - 1}"
    try:
        return future.result(timeout=SILENCE)
    except InputError:
        raise
    except TimeoutError:
        return None
    except KilledWorker as error:
        problem = f"{runs} ended one worker after the other, the last {error.last_worker}"
        raise WorkersLost("--cluster", problem, f"look into that worker's log, for memory say, then {AGAIN}") from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            raise
        watch.look()
        problem = f"{runs} did not come back: {type(error).__name__}: {error}"
        raise WorkersLost(
            "--cluster", problem, f"look into the scheduler's and the worker's logs, then {AGAIN}"
        ) from None

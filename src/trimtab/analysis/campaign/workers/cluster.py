"""Campaigns on several machines: workers of dask.distributed fly the blocks, over TLS with certificates on both ends.

A worker receives the name of a function of trimtab and plain data: the plan and two run numbers. The worker builds the
scenario itself. It reports an error if its results would not be bit-equal to those of the machine that runs the
campaign.

Source: docs page, A campaign on several machines; Rescorla, "The transport layer security (TLS) protocol version 1.3",
RFC 8446.
"""

import contextlib
import functools
import hashlib
import importlib.util
import ipaddress
import itertools
import json
import logging
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.analysis.campaign.workers.block import BlockResults, Blocks, Workers, WorkersLost, fly_block, uses_c
from trimtab.analysis.campaign.workers.prepare import PreparedCampaign, identity, plan_from_dict, prepare_campaign
from trimtab.core.errors import InputError, argument, argument_name, install_command
from trimtab.run.program import thread_count

CONNECT_TIMEOUT = 10.0
"""Time limit for a connection to the scheduler (s)."""
REPLY_TIMEOUT = 15.0
"""Interval at which the scheduler is queried, and time limit for its replies (s)."""
WORKER_TIMEOUT = 60.0
"""Longest time (s) for which a campaign waits for a worker, at the start or after all workers are lost."""
RESUME_HINT = "start the same command again, which resumes there"
ADDRESS_PATTERN = re.compile(r"(\w+)://(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):(\d{1,5})/?")
_one_prepares = threading.Lock()


def machine_identity(ready: PreparedCampaign, backend: str) -> dict[str, str]:
    """Return properties of this machine and of a campaign that must be equal on all machines that fly the campaign.

    If the properties are equal, the machines compute equal results.
    """
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
    return {**identity(ready.plan, ready.scenario, backend), "packages": packages, "code": _source_digest()}


@functools.cache
def _source_digest() -> str:
    """Return a digest of trimtab's source code. During development, one version may have different source code."""
    root, digest = Path(__file__).parents[3], hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@functools.lru_cache(maxsize=1)
def _prepare_cached(text: str, backend: str) -> tuple[PreparedCampaign, dict[str, str]]:
    """Prepare the campaign of a plan. Return the prepared campaign and this machine's identity.

    Only the last is cached.
    """
    ready = prepare_campaign(plan_from_dict(json.loads(text)))
    can = "c" if backend == "c" and uses_c(ready, "auto") else "jax"
    return ready, machine_identity(ready, can)


def fly_rows(plain: Mapping[str, Any], asker: Mapping[str, str], first: int, last: int) -> dict[str, Any]:
    """Fly runs first … last - 1 on a worker, and return the results (n,) by name.

    Args:
        plain: plan of the campaign as JSON-compatible data.
        asker: identity of the machine that runs the campaign, from `machine_identity`.
        first, last: first run, and last run + 1.

    Raises: InputError if the results computed on this machine would differ.
    """
    address, threads = _this_worker()
    try:
        with _one_prepares:
            ready, here = _prepare_cached(json.dumps(plain, sort_keys=True), asker["backend"])
    except InputError as error:
        part = f"worker {address}: {error.part}"
        raise InputError(part, error.problem, choices=error.choices, fix=error.fix) from None
    apart = [name for name in asker if here.get(name) != asker[name]]
    if apart:
        shown = "; ".join(f"{name} is {here.get(name)} there and {asker[name]} here" for name in apart)
        same = "install the same trimtab, packages and files on the worker's machine, and restart the worker"
        fix = "install a C compiler on the worker's machine" if apart == ["backend"] else same
        raise InputError(f"worker {address}", f"would compute different rows: {shown}", fix=fix)
    return fly_block(ready, first, last, backend=asker["backend"], threads=threads)


def _this_worker() -> tuple[str, int]:
    """Return this worker's address, as known to the scheduler, and the number of threads that the worker may use."""
    from distributed import get_worker

    try:
        worker = get_worker()
    except ValueError:
        return "here", thread_count(None)
    return str(worker.address), max(1, thread_count(None) // worker.state.nthreads)


class SchedulerAddress(NamedTuple):
    """Address of the scheduler. files: CA certificate, certificate and key of this machine, or None for plain TCP."""

    uri: str
    host: str
    port: int
    files: tuple[str, str, str] | None


def parse_address(uri: str, files: dict[str, str]) -> SchedulerAddress:
    """Parse the address of a scheduler. Raise InputError if the address is invalid, or is plain TCP to another machine.

    files: name of the argument -> name of this machine's TLS file.
    """
    match = ADDRESS_PATTERN.fullmatch(uri.strip())
    if not match or match[1] not in ("tls", "tcp") or not 0 < int(match[3]) < 2**16:
        raise InputError(
            argument_name("cluster"),
            f"must be tls://HOST:PORT, got {uri!r}",
            fix=argument("cluster", "tls://10.0.0.1:8786"),
        )
    host, port = match[2].strip("[]"), int(match[3])
    tls, flags = (
        f"tls://{match[2]}:{port}",
        f"{argument('tls_ca', 'ca.pem')} {argument('tls_cert', 'me.pem')} {argument('tls_key', 'me.key')}",
    )
    if match[1] == "tcp":
        if not _is_loopback(host):
            problem = (
                f"{uri}: without TLS, anyone who reaches the port can run programs on every machine of the cluster"
            )
            raise InputError(argument_name("cluster"), problem, fix=f"{argument('cluster', tls)} {flags}")
        if any(files.values()):
            raise InputError(argument_name("cluster"), f"{uri} does not use certificates", fix=argument("cluster", tls))
        return SchedulerAddress(uri, host, port, None)
    for which, name in files.items():
        flag = argument_name(which)
        if not name:
            raise InputError(flag, "tls:// needs a CA certificate, a certificate and its key", fix=flags)
        if not Path(name).is_file():
            raise InputError(flag, f"the file {name!r} does not exist", fix=f"{flag} with a PEM file")
    place = SchedulerAddress(tls, host, port, (files["tls_ca"], files["tls_cert"], files["tls_key"]))
    _tls_context(place)
    return place


def _is_loopback(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def _tls_context(place: SchedulerAddress) -> ssl.SSLContext:
    """Create the TLS context of a connection. Raise InputError if the files are unusable or do not match."""
    ca, cert, key = place.files or ("", "", "")
    try:
        context = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=ca)
        context.check_hostname = False
        context.load_cert_chain(cert, key)
    except (ssl.SSLError, OSError) as error:
        problem = f"{ca}, {cert} and {key} can't be used: {error.reason if isinstance(error, ssl.SSLError) else error}"
        raise InputError(
            f"{argument_name('tls_ca')}, {argument_name('tls_cert')}, {argument_name('tls_key')}",
            problem,
            fix="see the section on certificates in the docs page",
        ) from None
    return context


def check_scheduler(place: SchedulerAddress) -> None:
    """Raise InputError if the scheduler can't be reached, or if scheduler and client do not trust each other."""
    part = argument_name("cluster", place.uri)
    try:
        with socket.create_connection((place.host, place.port), CONNECT_TIMEOUT) as plain:
            if place.files is None:
                return
            with _tls_context(place).wrap_socket(plain) as safe:
                if not safe.recv(1):  # a scheduler that accepts the certificate sends the first message
                    raise ssl.SSLError("the connection was closed")
    except ssl.SSLCertVerificationError as error:
        ca = place.files and place.files[0]
        problem = f"the CA in {ca} did not sign the scheduler's certificate: {error.verify_message}"
        raise InputError(
            part, problem, fix=f"{argument_name('tls_ca')} with the ca.pem that the scheduler was started with"
        ) from None
    except ssl.SSLError as error:
        problem = f"the scheduler rejects the certificate: {error.reason or error}"
        both = f"{argument_name('tls_cert')} and {argument_name('tls_key')}"
        fix = f"{both} signed by the CA that the scheduler was started with"
        raise InputError(part, problem, fix=fix) from None
    except OSError as error:
        problem = f"cannot reach a scheduler at this address: {error.strerror or error}"
        scheme = "tls" if place.files else "tcp"
        fix = f"start on that machine:  dask scheduler --protocol {scheme} --port {place.port} …, and open the port"
        raise InputError(part, problem, fix=fix) from None


def cluster_workers(uri: str, *, ca: str | Path = "", cert: str | Path = "", key: str | Path = "") -> Workers:
    """Return a function that flies blocks of runs on a cluster, for the argument `workers` of `Campaign.run`.

    Args:
        uri: address of the scheduler, e.g. tls://10.0.0.1:8786. A tcp:// address is allowed only within one machine.
        ca: PEM file of the CA that signed all certificates.
        cert, key: PEM files of this machine's certificate and of its private key.

    Raises: InputError for an invalid address or unusable files. The scheduler is not contacted before the campaign
    starts.
    """
    place = parse_address(uri, {"tls_ca": str(ca), "tls_cert": str(cert), "tls_key": str(key)})
    if importlib.util.find_spec("distributed") is None:
        raise InputError(argument_name("cluster"), "needs dask.distributed", fix=install_command("cluster"))

    def fly(ready: PreparedCampaign, blocks: Blocks, used: str) -> BlockResults:
        with _open_client(place) as client:
            yield from _fly_blocks(client, place, ready, blocks, used)

    return fly


@contextlib.contextmanager
def _open_client(place: SchedulerAddress) -> Iterator[Any]:
    """Open a client of the scheduler, and close the client at the end of the `with` block."""
    from dask.config import set as configured
    from distributed import Client, Security

    check_scheduler(place)
    security = Security(require_encryption=False)
    if place.files:
        ca, cert, key = place.files
        security = Security(tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True)
    timeouts = {
        "distributed.comm.timeouts.connect": f"{CONNECT_TIMEOUT}s",
        "distributed.comm.timeouts.tcp": f"{REPLY_TIMEOUT}s",
    }
    with configured(timeouts), _mute_distributed():
        try:
            client = Client(place.uri, security=security, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, TimeoutError) as error:
            problem = f"the scheduler does not answer: {error}"
            raise InputError(argument_name("cluster", place.uri), problem, fix="dask scheduler …") from None
        try:
            yield client
        finally:
            client.close(timeout=3)


@contextlib.contextmanager
def _mute_distributed() -> Iterator[None]:
    """Suppress the long log messages of distributed about a lost connection, which the campaign reports in one line."""
    known = map(logging.getLogger, list(logging.root.manager.loggerDict))
    before = [(log, log.level) for log in known if log.name.partition(".")[0] == "distributed"]
    for log, _ in before:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in before:
            log.setLevel(level)


class _ClusterWatch:
    """Monitor of a scheduler and its workers. threads: number of threads of all workers at the last check."""

    def __init__(self, client: Any, place: SchedulerAddress) -> None:
        self._client, self._part = client, argument_name("cluster", place.uri)
        self._asked, self._seen, self.threads = 0.0, time.monotonic(), 0

    def check_workers(self) -> None:
        """Check, at intervals, that scheduler and workers are available.

        Raises: WorkersLost.
        """
        if self._client.status != "running":
            raise WorkersLost(
                self._part, "the scheduler is gone", f"start the scheduler and its workers, then {RESUME_HINT}"
            )
        now = time.monotonic()
        if now - self._asked < (REPLY_TIMEOUT if self.threads else 1.0):
            return
        try:
            cores = self._client.sync(self._client.scheduler.ncores, callback_timeout=REPLY_TIMEOUT)
        except Exception as error:  # a broken connection can raise any error
            raise self.silent_scheduler(error) from None
        self._asked, self.threads = time.monotonic(), sum(cores.values())
        if self.threads:
            self._seen = self._asked
        elif self._asked - self._seen > WORKER_TIMEOUT:
            problem = f"the scheduler has had no worker for {WORKER_TIMEOUT:g} s"
            raise WorkersLost(self._part, problem, f"start workers:  dask worker …, then {RESUME_HINT}")

    def silent_scheduler(self, error: Exception) -> WorkersLost:
        """Return the error to raise if the scheduler does not answer."""
        problem = f"the scheduler does not answer ({type(error).__name__})"
        return WorkersLost(self._part, problem, f"check the scheduler, then {RESUME_HINT}")


def _fly_blocks(
    client: Any, place: SchedulerAddress, ready: PreparedCampaign, blocks: Blocks, used: str
) -> BlockResults:
    """Fly blocks on the cluster, and yield each finished block. Two blocks per thread are in progress at a time."""
    asker, plain, waiting = machine_identity(ready, used), ready.plan.as_dict(), iter(blocks)
    flying: dict[Any, tuple[int, int]] = {}
    watch, landed = _ClusterWatch(client, place), threading.Event()
    try:
        while True:
            watch.check_workers()
            for first, last in itertools.islice(waiting, max(2, 2 * watch.threads, len(flying)) - len(flying)):
                future = client.submit(fly_rows, plain, asker, first, last, pure=False)
                future.add_done_callback(lambda _: landed.set())
                flying[future] = first, last
            if not flying:
                return
            landed.wait(1.0)
            landed.clear()
            for future in [f for f in flying if f.done()]:
                first, last = flying[future]
                columns = _block_columns(future, watch, (first, last))
                if columns is not None:
                    del flying[future]
                    future.release()
                    yield first, columns
    finally:
        flying.clear()  # the scheduler drops requests that no client waits for


def _block_columns(future: Any, watch: _ClusterWatch, block: tuple[int, int]) -> Any:
    """Return the results of a block, or None if they did not arrive in time. Raise an error if the block failed."""
    from distributed import KilledWorker

    runs = f"runs {block[0]} to {block[1] - 1}"
    try:
        return future.result(timeout=REPLY_TIMEOUT)
    except InputError:
        raise
    except TimeoutError:
        return None
    except OSError as error:  # the worker that has these results does not answer
        raise watch.silent_scheduler(error) from None
    except KilledWorker as error:
        problem = f"{runs} crashed several workers one after the other, the last at {error.last_worker}"
        fix = f"check that worker's log, for example for a lack of memory, then {RESUME_HINT}"
        raise WorkersLost(argument_name("cluster"), problem, fix) from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            raise
        watch.check_workers()
        problem = f"{runs} failed: {type(error).__name__}: {error}"
        fix = f"check the logs of the scheduler and the workers, then {RESUME_HINT}"
        raise WorkersLost(argument_name("cluster"), problem, fix) from None

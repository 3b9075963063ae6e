"""What a worker on another machine does: rows of a plan, bit-equal to those of the machine that asks, or an error."""

import functools
import hashlib
import json
import threading
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from trimtab.campaign.workers.block import flies_c, fly_block
from trimtab.campaign.workers.plan import identity, plan_of
from trimtab.campaign.workers.ready import Ready, prepare
from trimtab.core.errors import InputError
from trimtab.run.library import threads_of

_one_prepares = threading.Lock()


def about(ready: Ready, backend: str) -> dict[str, str]:
    """What must be equal on two machines for their rows to be."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
    return {**identity(ready.plan, ready.scenario, backend), "packages": packages, "code": _code()}


@functools.cache
def _code() -> str:
    """Digest of trimtab's own source: a version that is being worked on has many."""
    root, digest = Path(__file__).parents[2], hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@functools.lru_cache(maxsize=1)
def _prepared(text: str, backend: str) -> tuple[Ready, dict[str, str]]:
    """The plan's last preparation, and what this machine says of it."""
    ready = prepare(plan_of(json.loads(text)))
    can = "c" if backend == "c" and flies_c(ready, "auto") else "jax"
    return ready, about(ready, can)


def fly_rows(plain: Mapping[str, Any], told: Mapping[str, str], first: int, last: int) -> dict[str, Any]:
    """Rows first … last - 1, by name (n,).

    Args:
        plain: of the plan.
        told: what the asking machine says of itself, `about`.
        first, last: which rows.

    Raises: InputError where this machine's rows would be others.
    """
    try:
        with _one_prepares:
            ready, here = _prepared(json.dumps(plain, sort_keys=True), told["backend"])
    except InputError as error:
        part = f"worker {_address()}: {error.part}"
        raise InputError(part, error.problem, choices=error.choices, fix=error.fix) from None
    apart = [name for name in told if here.get(name) != told[name]]
    if apart:
        shown = "; ".join(f"{name}: {here.get(name)} there, {told[name]} here" for name in apart)
        same = "have the same trimtab, packages and files there, and start the worker anew"
        fix = "install a C compiler there" if apart == ["backend"] else same
        raise InputError(f"worker {_address()}", f"would not give the same rows: {shown}", fix=fix)
    return fly_block(ready, first, last, backend=told["backend"], threads=_threads())


def _address() -> str:
    """The worker's address, as the scheduler knows it."""
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return "here"


def _threads() -> int:
    """This worker's share of the machine: it may fly several blocks at once."""
    from distributed import get_worker

    try:
        return max(1, threads_of(None) // get_worker().state.nthreads)
    except ValueError:
        return threads_of(None)

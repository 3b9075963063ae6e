"""Group `timings`: how long the command line takes to start and to fly; never compared, only shown side by side."""

import os
import resource
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command import call

REPETITIONS = 5
COMMANDS = {
    "help": ("--help",),
    "list": ("list", "--json"),
    "run spin": ("run", "hovercraft/spin", "--json"),
}


def timings(folder: Path, wanted: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each command with a warm cache, and the flight with an empty one too."""
    usual = os.environ.get("TRIMTAB_CACHE")
    try:
        for name in [n for n in COMMANDS if wanted in n]:
            with tempfile.TemporaryDirectory() as cache:
                os.environ["TRIMTAB_CACHE"] = cache
                call(*COMMANDS[name], folder=folder)
                yield name, {"timings": _measured(COMMANDS[name], folder)}
        if wanted in "run spin cold":
            yield "run spin cold", {"timings": _measured(COMMANDS["run spin"], folder, cold=True)}
    finally:
        os.environ.pop("TRIMTAB_CACHE", None)
        if usual is not None:
            os.environ["TRIMTAB_CACHE"] = usual


def _measured(words: tuple[str, ...], folder: Path, *, cold: bool = False) -> dict[str, Any]:
    """Wall clock, and processor time of user and system together, of the process and its children (s)."""
    wall, busy = [], []
    for _ in range(REPETITIONS):
        cache = tempfile.mkdtemp() if cold else None
        if cache:
            os.environ["TRIMTAB_CACHE"] = cache
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        call(*words, folder=folder)
        wall.append(time.perf_counter() - began)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        busy.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        if cache:
            shutil.rmtree(cache)
    return {"wall_s": _least_and_median(wall), "busy_s": _least_and_median(busy), "load": os.getloadavg()}


def _least_and_median(found: list[float]) -> dict[str, float]:
    return {"min": round(min(found), 3), "median": round(statistics.median(found), 3)}

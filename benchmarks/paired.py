"""Paired timing: in each round, all programs run once, in random order, on one input. Ratios are taken per round."""

import os
import platform
import random
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Program(NamedTuple):
    """Program to time.

    call: function of the inputs that has computed all numbers when it returns.  runs: number of runs per call.
    result: function that converts the numbers for the comparison. It is not timed.
    """

    call: Callable[..., Any]
    runs: int = 1
    result: Callable[..., Any] = np.asarray


class Timed(NamedTuple):
    """Results of the rounds, by program.

    first: time of the first call (s), which traces and compiles.  times: per run (s), one for each later round.
    worst: largest difference from the reference in all rounds, including the first.  cpu: like `times`, CPU times of
    all threads of this process. Other programs have little influence on them.
    """

    first: dict[str, float]
    times: dict[str, list[float]]
    worst: dict[str, float]
    cpu: dict[str, list[float]] = {}


class Ratio(NamedTuple):
    """Median, least and largest of the ratios of two programs, each taken within a round."""

    median: float
    least: float
    most: float

    def __str__(self) -> str:
        digits = 2 if self.median < 100 else 0
        return f"{self.median:.{digits}f} ({self.least:.{digits}f}..{self.most:.{digits}f})"


def rounds(programs: dict[str, Program], inputs: Sequence[tuple[Any, ...]], reference: str, seed: int = 0) -> Timed:
    """Call all programs once on each input, in random order. The first input is the warm-up."""
    order, rng = list(programs), random.Random(seed)
    timed = Timed({}, {name: [] for name in order}, dict.fromkeys(order, 0.0), {name: [] for name in order})
    for i, given in enumerate(inputs):
        found = {}
        for name in rng.sample(order, len(order)):
            mine = [np.copy(a) if isinstance(a, np.ndarray) else a for a in given]
            start, cpu = time.perf_counter(), time.process_time()
            given_back = programs[name].call(*mine)
            took, cpu = time.perf_counter() - start, time.process_time() - cpu
            found[name] = programs[name].result(given_back)
            if i:
                timed.times[name].append(took / programs[name].runs)
                timed.cpu[name].append(cpu / programs[name].runs)
            else:
                timed.first[name] = took
        for name in order:
            timed.worst[name] = max(timed.worst[name], difference(found[name], found[reference]))
    return timed


def several(call: Callable[..., Any], runs: int, result: Callable[..., Any] = np.asarray) -> Program:
    """Return a program that repeats a short run, with increasing keys. Its result is that of the first run."""

    def calls(gains: Any, key: Any) -> Any:
        first = call(gains, key)
        for i in range(1, runs):
            call(gains, key + np.array([0, i], np.uint32))
        return first

    return Program(calls, runs, result)


def difference(found: Any, truth: Any) -> float:
    """Return the largest difference; infinity if a difference is not finite or the shapes differ."""
    if np.shape(found) != np.shape(truth):
        return float("inf")
    apart = np.abs(np.subtract(found, truth))
    return float(apart.max()) if np.isfinite(apart).all() else float("inf")


def ratio(timed: Timed, over: str, under: str, cpu: bool = False) -> Ratio | None:
    """Return the ratio of two programs' times, or CPU times; None if one of them was not measured."""
    times = timed.cpu if cpu else timed.times
    if not times.get(over) or not times.get(under):
        return None
    found = np.divide(times[over], times[under])
    return Ratio(float(np.median(found)), float(found.min()), float(found.max()))


def show(title: str, timed: Timed, base: str, steps: int) -> None:
    """Print times per run and ratios to the base (median, smallest, largest), and the same for CPU times."""
    heads = (
        f"{'median ms':>11}{'min':>9}{'max':>9}{'us/step':>9}{'x ' + base:>17}{'min..max':>16}{'CPU ms':>9}{'x CPU':>7}"
    )
    print(f"\n{title}\n{'':30}{heads}{'first s':>9}{'max diff':>10}")
    for name, t in timed.times.items():
        ms = 1e3 * np.array([np.median(t), min(t), max(t)])
        x = ratio(timed, name, base)
        spread = f"{x.least:.2f}..{x.most:.2f}" if x else ""
        cells = (
            f"{ms[0]:11.3f}{ms[1]:9.3f}{ms[2]:9.3f}{1e3 * ms[0] / steps:9.3f}{x.median if x else 0:17.2f}{spread:>16}"
        )
        of_cpu = ratio(timed, name, base, cpu=True)
        cells += f"{1e3 * min(timed.cpu[name]):9.3f}{of_cpu.median if of_cpu else 0:7.2f}"
        print(f"{name:30}{cells}{timed.first[name]:9.2f}{timed.worst[name]:10.0e}")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine(*packages: str) -> str:
    """Return a description of the machine's CPU, and the versions of compiler, Python and packages."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        cpu = platform.processor() or platform.machine()
    try:
        said = subprocess.run([os.environ.get("CC", "gcc"), "--version"], capture_output=True, text=True).stdout
        compiler = said.splitlines()[0] if said else "compiler unknown"
    except OSError:
        compiler = "no compiler"
    from importlib.metadata import version

    names = ", ".join(f"{p} {version(p)}" for p in ("numpy", *packages))
    return f"{cpu}, {cores()} cores, {compiler}, Python {platform.python_version()}, {names}"


def load() -> str:
    """Return a text with the machine's load over the last minute, and a warning if the load is too high."""
    now = os.getloadavg()[0]
    busy = "   busy: only ratios mean something, run again when it is quiet" if now > 0.3 * cores() else ""
    return f"load {now:.2f} on {cores()} cores{busy}"


def row(what: str, figure: object, target: str, command: str) -> str:
    """Return a row of the table on the docs page of benchmarks."""
    return f"| {what} | {figure} | {target or 'none'} | `{command}` |"

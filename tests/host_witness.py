"""Evidence of how late the host ran the programs under test.

`HostWitness` starts this file as a program: `host_witness.py PID FOLDER CPUS`. One process for each CPU sleeps for 2 ms
again and again and notes by how much each wake-up is late. One more process finds the descendants of PID and samples
how long their tasks waited for a CPU.

Time that the programs under test used themselves never counts as the host's. The CPU time of all of them, on all CPUs,
is subtracted from each gap and from each wait. The result is a lower bound: where the load is mixed, the witness rather
finds nothing. A process that was stopped by a signal does not wait for a CPU and leaves no gap.
"""

import mmap
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

NS_PER_MS = 1_000_000
INTERVAL_NS = 2 * NS_PER_MS
"""Sleep between two beats of a watcher."""
SAMPLE_NS = 50 * NS_PER_MS
"""Time between two samples of the tasks' waits."""
NOTED_NS = NS_PER_MS
"""Shortest gap or wait that is written down."""
START_TIMEOUT_S, BEAT_TIMEOUT_S = 10.0, 10.0
MOST_PIDS = 256
"""Number of processes under test whose CPU time is known to the watchers."""


class Gap(NamedTuple):
    """A CPU that ran other programs, or nothing, while its watcher should have run; `host_ns` is the host's part."""

    cpu: int
    start_ns: int
    end_ns: int
    host_ns: int


class Wait(NamedTuple):
    """A task under test that could have run between two samples but waited; `host_ns` is the host's part."""

    task: str
    start_ns: int
    end_ns: int
    host_ns: int


class Evidence(NamedTuple):
    """What the witness has seen of the host between two times."""

    gaps: tuple[Gap, ...] = ()
    waits: tuple[Wait, ...] = ()

    def blame(self, bears_ms: float) -> str:
        """Return why the host is to blame, or nothing if it was never later than bears_ms."""
        bears_ns = bears_ms * NS_PER_MS
        gap = max(self.gaps, key=lambda g: g.host_ns, default=None)
        if gap and gap.host_ns >= bears_ns:
            return (
                f"CPU {gap.cpu} ran other programs for {gap.host_ns / NS_PER_MS:.0f} ms; the test bears {bears_ms:g} ms"
            )
        task, wait_ns = longest_wait(self.waits, max(2 * bears_ns, 2 * SAMPLE_NS))
        if wait_ns >= bears_ns:
            return f"task {task} waited {wait_ns / NS_PER_MS:.0f} ms for a CPU; the test bears {bears_ms:g} ms"
        return ""


def longest_wait(waits: Iterable[Wait], span_ns: float) -> tuple[str, int]:
    """Return the task that waited longest within a span of this length, and its time in ns."""
    tasks: dict[str, list[Wait]] = defaultdict(list)
    for wait in waits:
        tasks[wait.task].append(wait)
    longest = ("", 0)
    for task, own in tasks.items():
        first, total = 0, 0
        for wait in own:
            total += wait.host_ns
            while wait.end_ns - own[first].start_ns > span_ns and own[first] is not wait:
                total -= own[first].host_ns
                first += 1
            longest = max(longest, (task, total), key=lambda found: found[1])
    return longest


class HostWitness:
    """The processes beside the tests, and what they have written."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="trimtab-witness-")
        self._path = Path(self._folder.name)
        self._cpus = sorted(os.sched_getaffinity(0))
        (self._path / "beats").write_bytes(bytes(8 * len(self._cpus)))
        command = [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(self._path)]
        self._process = subprocess.Popen(
            [*command, ",".join(map(str, self._cpus))],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._await_beats(0, START_TIMEOUT_S)

    @staticmethod
    def is_possible() -> bool:
        """Return True where the kernel tells how long tasks ran and waited."""
        return hasattr(os, "sched_setaffinity") and Path("/proc/self/schedstat").is_file()

    def collect(self, start_ns: int, end_ns: int) -> Evidence:
        """Return what happened between two times of time.monotonic_ns. Waits until the watchers have run again."""
        self._await_beats(end_ns, BEAT_TIMEOUT_S)
        gaps = [Gap(int(cpu), *map(int, times)) for cpu, *times in self._read("gaps-*")]
        waits = [Wait(task, *map(int, times)) for task, *times in self._read("waits-*")]
        return Evidence(
            tuple(g for g in gaps if g.end_ns > start_ns and g.start_ns < end_ns),
            tuple(w for w in waits if w.end_ns > start_ns and w.start_ns < end_ns),
        )

    def close(self) -> None:
        """End the processes."""
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    def _read(self, pattern: str) -> Iterator[list[str]]:
        for path in sorted(self._path.glob(pattern)):
            for line in path.read_text().split("\n")[:-1]:
                yield line.rsplit(" ", 3)

    def _await_beats(self, after_ns: int, timeout_s: float) -> None:
        until = time.monotonic() + timeout_s
        while time.monotonic() < until and self._process.poll() is None:
            beats = struct.unpack(f"{len(self._cpus)}q", (self._path / "beats").read_bytes())
            if all(beat > after_ns for beat in beats):
                return
            time.sleep(INTERVAL_NS * 1e-9)


def read_cpu_time(pid: int) -> int:
    """Return the CPU time of all threads of a process in ns, or 0 if it has ended."""
    try:
        return time.clock_gettime_ns(~pid << 3 | 2)  # the clock that clock_getcpuclockid() gives
    except OSError:
        return 0


def watch_cpu(cpu: int, beat: int, folder: Path, shared: mmap.mmap) -> None:
    """Note each late wake-up on a CPU until the parent process has ended."""
    parent = os.getppid()
    os.sched_setaffinity(0, {cpu})
    beats = mmap.mmap(os.open(folder / "beats", os.O_RDWR), 0)
    gaps = os.open(folder / f"gaps-{cpu}", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    used: dict[int, int] = {}
    while os.getppid() == parent:
        due = time.monotonic_ns() + INTERVAL_NS
        time.sleep(INTERVAL_NS * 1e-9)
        now = time.monotonic_ns()
        count = struct.unpack_from("i", shared)[0]
        new = {pid: read_cpu_time(pid) for pid in struct.unpack_from(f"{count}i", shared, 4)}
        if now - due >= NOTED_NS:
            own = sum(max(0, ns - used.get(pid, 0)) for pid, ns in new.items())
            os.write(gaps, f"{cpu} {due} {now} {max(0, now - due - own)}\n".encode())
        used = new
        struct.pack_into("q", beats, 8 * beat, now)


class Tree:
    """The processes under test: a process and its descendants, found in /proc."""

    def __init__(self, root: int) -> None:
        self._known: dict[int, bool] = {root: True}

    def update(self) -> list[int]:
        """Return the processes under test. Reads only processes that were not there at the last call."""
        there = sorted(int(name) for name in os.listdir("/proc") if name.isdigit())
        self._known = {pid: self._known[pid] for pid in there if pid in self._known}
        for pid in there:
            if pid not in self._known:
                self._known[pid] = pid != os.getpid() and self._known.get(_read_parent(pid), False)
        return [pid for pid, is_own in self._known.items() if is_own]


def _read_parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[1])
    except OSError:
        return 0


def read_tasks(pids: list[int]) -> dict[int, tuple[int, int]]:
    """Return the time in ns for which each task ran, and for which it waited for a CPU."""
    tasks = {}
    for pid in pids:
        try:
            names = os.listdir(f"/proc/{pid}/task")
        except OSError:
            continue
        for name in names:
            try:
                ran, waited, _ = Path(f"/proc/{pid}/task/{name}/schedstat").read_bytes().split()
            except (OSError, ValueError):
                continue
            tasks[int(name)] = int(ran), int(waited)
    return tasks


def sample_waits(root: int, folder: Path, shared: mmap.mmap) -> None:
    """Publish the processes under test and note their tasks' waits until the root process has ended."""
    tree = Tree(root)
    waits = os.open(folder / "waits-", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    before, last = {}, time.monotonic_ns()
    while os.getppid() == root:
        pids = tree.update()
        count = min(len(pids), MOST_PIDS)
        struct.pack_into(f"{count + 1}i", shared, 0, count, *pids[:count])
        tasks, now = read_tasks(pids), time.monotonic_ns()
        ran = {task: of[0] - before.get(task, (0, 0))[0] for task, of in tasks.items()}
        total = sum(ran.values())
        for task, (_, waited) in tasks.items():
            if task in before:
                host = waited - before[task][1] - (total - ran[task])
                if host >= NOTED_NS:
                    os.write(waits, f"{task} {last} {now} {host}\n".encode())
        before, last = tasks, now
        time.sleep(SAMPLE_NS * 1e-9)


def main(root: int, folder: Path, cpus: list[int]) -> None:
    """Watch until the process `root` has ended."""
    shared = mmap.mmap(-1, 4 + 4 * MOST_PIDS)
    for beat, cpu in enumerate(cpus):
        if os.fork() == 0:
            try:
                watch_cpu(cpu, beat, folder, shared)
            finally:
                os._exit(0)
    sample_waits(root, folder, shared)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), list(map(int, sys.argv[3].split(","))))

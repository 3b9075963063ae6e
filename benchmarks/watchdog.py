"""Measure the time for which a vehicle's outputs act after its process was killed, stopped or starved.

Also measure the time until a vehicle detects that the process of its outputs was killed. On a real craft, the
servos then get no pulses.

    python benchmarks/watchdog.py --times 100

A process hands over rows every millisecond, as a vehicle's loop does. It is killed (SIGKILL), stopped (SIGSTOP) or
starved (a process with higher priority takes its processor for a while; only as root). The time from this event to the
safe row is read from the outputs' port.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from time import monotonic_ns

from trimtab.flight.output_port import DRIVEN, OutputReader
from trimtab.flight.real_time import Histogram

BUCKETS_MS = (1, 2, 5, 10, 20, 50, 60, 70, 80, 100, 200, 500, 1000)
FEEDER = """
import sys, time
from pathlib import Path
from trimtab.flight.outputs import Outputs
timeout = int(sys.argv[2])
outputs = Outputs([0.0, 0.0], timeout=timeout, lift_delay=0, latch=5 * timeout, folder=Path(sys.argv[1]),
    wanted_real_time=True)
while outputs.is_alive:
    outputs.hand_over(True, True, [0.95, 1.7])
    time.sleep(0.001)
print(time.monotonic_ns(), flush=True)
"""
HOG = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
began = time.monotonic_ns()
while time.monotonic_ns() - began < 300_000_000:
    pass
print(began, flush=True)
"""
KILLED, STOPPED, STARVED, OUTPUTS_KILLED = "killed", "stopped", "starved", "outputs killed"


def measure_once(what: str, timeout: int) -> int:
    """Return the time (ns) from the event to the safe row, or until the vehicle detects the death of the outputs."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "outputs.bin"
        command = [sys.executable, "-c", FEEDER, folder, str(timeout)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            while not file.exists() or file.stat().st_size == 0:
                time.sleep(0.005)
            port = OutputReader(file)
            while port.read()[1].state != DRIVEN:
                time.sleep(0.005)
            time.sleep(0.05)
            if what == OUTPUTS_KILLED:
                return kill_outputs(process)
            began, hog = monotonic_ns(), start_hog(process) if what == STARVED else None
            if hog is None:
                os.kill(process.pid, signal.SIGKILL if what == KILLED else signal.SIGSTOP)
            while port.read()[1].state == DRIVEN:
                time.sleep(0.001)
            return port.read()[0] - (began if hog is None else int(hog.communicate()[0]))
        finally:
            process.kill()
            process.wait()


def kill_outputs(process: "subprocess.Popen[str]") -> int:
    """Kill the process of a vehicle's outputs. Return the time (ns) until the vehicle detects it."""
    (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert process.stdout is not None
    began = monotonic_ns()
    os.kill(int(child), signal.SIGKILL)
    return int(process.stdout.readline()) - began


def start_hog(process: "subprocess.Popen[str]") -> "subprocess.Popen[str]":
    """Take a process's processor away for 0.3 s, but not that of the outputs. The hog prints its start time."""
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(process.pid, {core})
    return subprocess.Popen([sys.executable, "-c", HOG, str(core)], stdout=subprocess.PIPE, text=True)


def main() -> None:
    """Print a table for each event."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=50, help="number of measurements of each event [50]")
    parser.add_argument(
        "--watchdog", type=float, default=50.0, help="time without data after which outputs go safe (ms) [50]"
    )
    options = parser.parse_args()
    ways = (KILLED, STOPPED, *((STARVED,) if os.geteuid() == 0 else ()), OUTPUTS_KILLED)
    for what in ways:
        times = [measure_once(what, int(options.watchdog * 1e6)) for _ in range(options.times)]
        histogram = Histogram()
        for t in times:
            histogram.add(t)
        s = histogram.summary()
        print(f"{what}: median {s.p50 * 1e3:.1f} ms, 99 % {s.p99 * 1e3:.1f} ms, longest {s.longest * 1e3:.1f} ms")
        low = 0
        for high in BUCKETS_MS:
            n = sum(low <= t * 1e-6 < high for t in times)
            if n:
                print(f"  {low:4d} to {high:4d} ms  {n:4d}  {'#' * (60 * n // len(times))}")
            low = high


if __name__ == "__main__":
    main()

"""Fly a hovercraft in real time with and without its log, alternately. Measure deadlines and the cost of logging.

python benchmarks/deadlines.py

The vehicle is a separate program on a loopback link. Each round arms it again. The cost of logging is the difference of
the median computing time per period with and without the log, in a pair of flights, as a fraction of the period.
"""

import argparse
import contextlib
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

from paired import Ratio, load, machine, row

from trimtab.core.time import seconds, to_seconds
from trimtab.flight.autopilot import LiveAutopilot
from trimtab.flight.flight_signals import LiveFlightSummary
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.transports.open_link import open_link
from trimtab.run.blocks import compile_autopilot
from trimtab.scenarios import catalogue

SCENARIO = "hovercraft/zero-velocity"
COMMAND = "python benchmarks/deadlines.py"
START = "import sys; from trimtab.cli import main; sys.exit(main())"


@contextlib.contextmanager
def vehicle(line):
    """Run the vehicle as a separate program, until the end of the `with` block."""
    asked = ("vehicle", SCENARIO, "--listen", line, "--unsigned", "--json")
    process = subprocess.Popen(
        [sys.executable, "-c", START, *asked], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait(60)


def fly(scenario, line, step, duration, log) -> LiveFlightSummary:
    """One flight."""
    link = open_link(line)
    try:
        step.reset()
        flyer = LiveAutopilot(scenario, link, lambda d: Endpoint(d, 1, 191, unsigned=True), step=step)
        flyer.connect(120.0)
        return flyer.fly(duration=duration, log=log)
    finally:
        link.close()


def rounds(count: int, duration: int) -> tuple[list[tuple[LiveFlightSummary, LiveFlightSummary]], float]:
    """Return pairs of flights, with and without a log, in random order, and the period (s)."""
    scenario, rng, pairs = catalogue.load_scenario(SCENARIO)[0], random.Random(0), []
    line, step = f"loopback://benchmark-{os.getpid()}", compile_autopilot(scenario)
    with tempfile.TemporaryDirectory() as folder, vehicle(line):
        for k in range(count):
            logs = {"with": Path(folder) / f"{k}.mcap", "without": None}
            found = {name: fly(scenario, line, step, duration, logs[name]) for name in rng.sample(list(logs), 2)}
            written = found["with"].log
            if written is None or written.dropped or written.unwritten:
                sys.exit(f"the log lost rows: {written}")
            pairs.append((found["with"], found["without"]))
    return pairs, to_seconds(scenario.autopilot.period)


def table(pairs) -> None:
    """Print the deadlines of all flights."""
    print(f"{'us':24}{'median':>9}{'99 %':>9}{'99.9 %':>9}{'longest':>9}{'own':>6}{'sched':>6}")
    for k, both in enumerate(pairs):
        for name, flight in zip(("with log", "without"), both, strict=True):
            kept = flight.deadlines
            for what in ("late", "step", "work"):
                q = getattr(kept, what).summary()
                cells = "".join(f"{1e6 * v:9.1f}" for v in (q.p50, q.p99, q.p999, q.longest))
                causes = f"{kept.own:6}{kept.scheduler:6}" if what == "work" else ""
                print(f"{k + 1:3} {name:9} {what:9} {cells}{causes}")


def spread(values) -> Ratio:
    """Return the median, smallest and largest value."""
    ordered = sorted(values)
    return Ratio(ordered[len(ordered) // 2], ordered[0], ordered[-1])


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rounds", type=int, default=5, help="number of pairs of flights (default: 5)")
    p.add_argument("--seconds", type=float, default=10.0, help="duration of each flight (s) (default: 10)")
    p.add_argument("--quick", action="store_true", help="one pair of two seconds, only to check that the program works")
    p.add_argument("--markdown", action="store_true", help="print the rows for the documentation's table at the end")
    a = p.parse_args()
    print(f"{machine('jax')}\n{load()}")
    pairs, period = rounds(1 if a.quick else a.rounds, seconds(2 if a.quick else a.seconds))
    table(pairs)
    works = [[flight.deadlines.work.summary().p50 for flight in both] for both in pairs]
    shares = spread([100 * (one - other) / period for one, other in works])
    tails = spread([100 * both[0].deadlines.step.summary().p999 / period for both in pairs])
    print(f"logging: {shares} % of the period of {1e3 * period:g} ms; {pairs[0][0].grant}")
    print(f"compiled step, 99.9 %: {tails} % of the period\n{load()}")
    if a.markdown:
        print(row("real time, 1 kHz: work added by logging everything, % of the period", shares, "≤ 5", COMMAND))
        print(row("real time, 1 kHz: 99.9 % of compiled steps within, % of the period", tails, "≤ 10", COMMAND))

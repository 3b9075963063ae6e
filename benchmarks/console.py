"""Measure a pilot console: CPU share of its server, deadlines of the loop, delay of the stick and of the plots.

    python benchmarks/console.py                    a minute without a page, with one, with three, and with a crowd
    python benchmarks/console.py --one-page 600     ten minutes with one page, one minute for each other phase

The real command flies `hovercraft/pilot`. The pages run in Chromium (Debian's package) on the same cores, without a
GPU. Each page plots 12 signals. Lateness and overruns are read from the flight's log, phase by phase.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trimtab.logs.mcap import read_mcap

START_S, SETTLE_S = 300.0, 5.0
PLOTTED = 12
SERVER = "trimtab.console.server"
CROWD = Path(__file__).with_name("console_crowd.py")
GAMEPAD = """
window.pad = {connected: true, mapping: 'standard', id: 'a stub', index: 0, timestamp: 0, axes: [0, -0.2, 0, 0],
              buttons: Array.from({length: 17}, () => ({pressed: false, value: 0}))};
navigator.getGamepads = () => [window.pad];
"""


class Phase(NamedTuple):
    """Phase of the flight, in monotonic time (s). cpu: CPU time of the server (s). memory: its memory (MB)."""

    name: str
    began: float
    ended: float
    cpu: float
    memory: tuple[float, float]
    rows: float


def server_pid(parent: int) -> int:
    """Return the process ID of the server, a child of the flight's process."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            line, stat = (folder / "cmdline").read_bytes(), (folder / "stat").read_text()
        except OSError:
            continue
        if SERVER.encode() in line and int(stat.rpartition(")")[2].split()[1]) == parent:
            return int(folder.name)
    raise SystemExit("the console's server was not found")


def cpu_seconds(pid: int) -> float:
    """Return the CPU time (s) that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> float:
    """Return the resident memory (MB) of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def watch(name: str, pid: int, seconds: float, count_rows) -> Phase:
    """Measure a phase, after a few seconds in which newly opened pages load."""
    time.sleep(SETTLE_S)
    began, cpu, memory, rows = time.monotonic(), cpu_seconds(pid), memory_mb(pid), count_rows()
    time.sleep(seconds)
    ended = time.monotonic()
    return Phase(name, began, ended, cpu_seconds(pid) - cpu, (memory, memory_mb(pid)), count_rows() - rows)


def open_page(browser, url: str):
    """Open a page that plots a dozen signals."""
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.add_init_script(GAMEPAD)
    page.goto(url)
    while not page.evaluate("!!(window.trimtab && trimtab.source && trimtab.source.rows.count > 10)"):
        page.wait_for_timeout(100)
    while page.evaluate("trimtab.state.plots.flat().length") < PLOTTED:
        adds = "#plot-add:enabled, [aria-label='Add a signal to this plot']:enabled"
        page.locator(adds).first.click()
        page.locator("#picker-list button:enabled").first.click()
        if page.locator("#picker[open]").count():
            page.click("#picker-close")
    return page


def print_phases(phases: list[Phase], log, offset: float) -> None:
    """Print one row for each phase. offset: log time minus monotonic time (s)."""
    heads = {
        "server, % of a core": 22,
        "its memory, MB": 22,
        "rows/s": 9,
        "late p50, p99, p99.9, us": 28,
        "overruns": 10,
    }
    print(" " * 14 + "".join(f"{head:>{width}}" for head, width in heads.items()))
    for phase in phases:
        inside = (log.t >= phase.began + offset) & (log.t <= phase.ended + offset)
        late, overruns = log["loop.late"][inside] * 1e6, log["loop.overruns"][inside]
        quantiles = "  ".join(f"{q:7.1f}" for q in np.quantile(late, (0.5, 0.99, 0.999)))
        length = phase.ended - phase.began
        memory = f"{phase.memory[0]:.1f} -> {phase.memory[1]:.1f}"
        cells = f"{100 * phase.cpu / length:>22.2f}{memory:>22}{phase.rows / length:>9.2f}{quantiles:>28}"
        print(f"{phase.name:14}{cells}{int(overruns[-1] - overruns[0]):>10}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of each phase (s)")
    parser.add_argument("--one-page", type=float, help="duration (s) of the phase with one page, if different")
    given = parser.parse_args()
    seconds = given.seconds
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("chromium must be installed (Debian: apt-get install chromium)")
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        said = Path(folder) / "said.txt"
        environment = {**os.environ, "TRIMTAB_CONFIG": folder, "PYTHONUNBUFFERED": "1"}
        words = [sys.executable, "-m", "trimtab", "console", "hovercraft/pilot", "--out", f"{folder}/flown"]
        with said.open("w") as out:
            process = subprocess.Popen(words, env=environment, stdout=out, stderr=subprocess.STDOUT)
        end = time.monotonic() + START_S
        while not (found := re.search(r"console: (http\S+)", said.read_text())):
            if process.poll() is not None or time.monotonic() > end:
                raise SystemExit(said.read_text())
            time.sleep(0.2)
        pid, browser = server_pid(process.pid), play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        phases = [watch("no page", pid, seconds, lambda: 0.0)]
        page = open_page(browser, found[1])

        def rows() -> float:
            return page.evaluate("trimtab.source.rows.base + trimtab.source.row")

        phases.append(watch("one page", pid, given.one_page or seconds, rows))
        page.keyboard.press("t")
        page.wait_for_timeout(3000)
        stick = page.evaluate("[trimtab.state.status.stick_latency, trimtab.state.status.longest_stick_latency]")
        pixels = page.evaluate("[trimtab.latency.median, trimtab.latency.p99]")
        page.keyboard.press("t")
        others = [open_page(browser, found[1]) for _ in range(2)]
        phases.append(watch("three pages", pid, seconds, rows))
        offset = page.evaluate("trimtab.source.time") - time.monotonic()
        for other in others:
            other.close()
        crowd = [sys.executable, str(CROWD), found[1], "--seconds", str(seconds + 2 * SETTLE_S)]
        with subprocess.Popen(crowd, stdout=subprocess.PIPE, text=True) as joined:
            phases.append(watch("a crowd", pid, seconds, rows))
            came, _ = joined.communicate()
        page.close()
        browser.close()
        process.terminate()
        process.wait(60)
        print_phases(phases, read_mcap(Path(folder) / "flown" / "flight.mcap"), offset)
        print(came.strip())
        print(f"stick, from the server to the wire: median {stick[0] * 1e3:.2f} ms, longest {stick[1] * 1e3:.2f} ms")
        print(f"state to pixels: median {pixels[0] * 1e3:.0f} ms, 99 % {pixels[1] * 1e3:.0f} ms")


if __name__ == "__main__":
    main()

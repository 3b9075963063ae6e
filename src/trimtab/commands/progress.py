"""Messages on standard error about a subcommand's progress, remaining time and expected output size."""

import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from trimtab.logs.log_limit import round_size

LARGE = 10_000_000
"""Expected size (bytes) of an output file or folder from which on the expected size is printed."""
EACH = 10.0
"""Time (s) between two lines of progress if standard error is not a terminal."""
HOUR = 3600.0
"""Minimum remaining time (s) at which a terminal also shows the remaining time on a permanent line."""


def announce_size(what: str, size: float) -> None:
    """Print the expected size of a large file or folder while the file or folder is being written."""
    if size >= LARGE:
        click.echo(f"{what}: about {round_size(size)}", err=True)


def warn_of_room(what: str, most: float, folder: Path) -> None:
    """Warn if the free space on the disk may be too small. The final size depends on the compression.

    Args:
        what: name of the output, e.g. "store".
        most: bytes still to be written, before compression.
        folder: folder of the output, which need not exist yet.
    """
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(there).free
    if most > free:
        room = f"only {round_size(free)} are free on the disk of {str(folder)!r}"
        click.echo(f"{what}: up to {round_size(most)} more, but {room}", err=True)


def _can_redraw() -> bool:
    """Return True if standard error is a terminal with lines that can be redrawn, unlike a notebook's `!` command."""
    in_notebook = "JPY_PARENT_PID" in os.environ or "matplotlib_inline" in os.environ.get("MPLBACKEND", "")
    return sys.stderr.isatty() and not in_notebook and os.environ.get("TERM") != "dumb"


@contextmanager
def show_progress(total: int) -> Iterator[Callable[[str, int], None]]:
    """Show a transient progress bar on standard error. Yield a function to call with a text and a number of new items.

    If more than an hour remains, the remaining time is printed once on a permanent line. Without a terminal, a line of
    progress is printed every ten seconds.
    """
    if not _can_redraw():
        without_bar = _ProgressLines(total, lambda line: click.echo(line, err=True))
        with _reminders(without_bar.remind):
            yield without_bar.add
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    text = TextColumn("{task.description}")
    with Progress(*columns, text, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total)
        lines = _ProgressLines(total, lambda line: bar.console.print(line, highlight=False), HOUR, math.inf)

        def tell(text: str, more: int) -> None:
            bar.update(task, description=text, advance=more)
            lines.add(text, more)

        yield tell


@contextmanager
def show_spinner(text: str) -> Iterator[None]:
    """Show a transient spinner with a text. Without a terminal, print the text every ten seconds."""
    if not _can_redraw():
        with _reminders(lambda waited: click.echo(f"{text}: {waited:.0f} s so far", err=True)):
            yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


@contextmanager
def _reminders(say: Callable[[float], None]) -> Iterator[None]:
    """Call a function every ten seconds with the time waited (s), from a separate thread."""
    ended, began = threading.Event(), time.monotonic()

    def remind() -> None:
        while not ended.wait(EACH):
            say(time.monotonic() - began)

    thread = threading.Thread(target=remind, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def show_count(total: int, before: str) -> Iterator[Callable[[int], None]]:
    """Show a progress bar with runs per second. Yield a function to call with the number of finished runs.

    before: text shown until the first runs are finished.
    """
    with show_progress(total) as tell:
        tell(before, 0)
        rate = _Rate()

        def tell_all(done: int) -> None:
            more, text = rate.add(done)
            tell(text or before, more)

        yield tell_all


class _Rate:
    """Runs per second since the first runs finished. The compilation before is not counted."""

    def __init__(self) -> None:
        self.since, self.first, self.most = 0.0, -1, 0

    def add(self, done: int) -> tuple[int, str]:
        """Return the number of newly finished runs, and runs per second as text. A run reported twice counts once."""
        now, more = time.monotonic(), max(done - self.most, 0)
        self.most = max(self.most, done)
        if self.first < 0:
            self.since, self.first = now, done
        flown, seconds = self.most - self.first, now - self.since
        return more, f"{flown / seconds:.0f} runs/s" if flown > 0 and seconds > 0 else ""


class _ProgressLines:
    """Progress as printed lines. A short task prints no lines.

    The remaining time is extrapolated from the finished items. The time for compilation is not counted.

    Args:
        total: number of items.
        say: function that prints a line.
        long: minimum remaining time (s) at which a line is printed.
        each: time (s) between two printed lines.
    """

    def __init__(self, total: int, say: Callable[[str], None], long: float = 5.0, each: float = EACH) -> None:
        self.total, self.say, self.long, self.each = total, say, long, each
        self.text, self.done, self.at_first = "", 0, 0
        self.began, self.said = 0.0, -math.inf

    def add(self, text: str, more: int) -> None:
        """Count `more` items as done, and print a line of progress if it is time."""
        now = time.monotonic()
        self.text = text
        self.done += more
        if not self.began and more:
            self.began, self.at_first = now, self.done
            return
        flown = self.done - self.at_first
        if not self.began or flown <= 0 or now - self.said < self.each or now - self.began < 1.0:
            return
        left = (now - self.began) / flown * (self.total - self.done)
        if left > self.long:
            self.said = now
            self.say(f"{text}: {self.done} of {self.total}, about {format_wait(left)} left on {_cores()}")

    def remind(self, waited: float) -> None:
        """Print the time waited (s), unless another line of progress was printed meanwhile."""
        now = time.monotonic()
        if now - self.said >= self.each:
            self.said = now
            self.say(f"{self.text}: {self.done} of {self.total}, {waited:.0f} s so far".removeprefix(": "))


def _cores() -> str:
    """Return the number of usable processor cores as text, e.g. "4 cores"."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{count} core{'s' if count > 1 else ''}"


def format_wait(seconds: float) -> str:
    """Format a waiting time: "40 s", "3 min", "2.5 h"."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

"""How far a verb is, how long it will take and how large what it writes will be: on standard error, before it hurts."""

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from trimtab.logs.log_limit import round_size

LARGE = 10_000_000
"""Bytes from which on a file is announced."""
HOUR = 3600.0
"""Seconds from which on what is left is said on a screen as well, in a line that stays."""


def announce_size(what: str, size: float) -> None:
    """Say, while it is still written, what a large file or folder will take; small ones pass."""
    if size >= LARGE:
        click.echo(f"{what}: about {round_size(size)}", err=True)


def warn_of_room(what: str, most: float, folder: Path) -> None:
    """Say, before it is written, that a disk may not hold it: it may, for how far it will compress is not known.

    Args:
        what: is written, e.g. "store".
        most: bytes that are still to come, before they are compressed.
        folder: in which it is written; it need not be there yet.
    """
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(there).free
    if most > free:
        room = f"only {round_size(free)} are free on the disk of {str(folder)!r}"
        click.echo(f"{what}: up to {round_size(most)} more, but {room}", err=True)


def _can_redraw() -> bool:
    """Whether standard error is a screen: a terminal, but not the one that a notebook's `!` puts around a command."""
    in_notebook = "JPY_PARENT_PID" in os.environ or "matplotlib_inline" in os.environ.get("MPLBACKEND", "")
    return sys.stderr.isatty() and not in_notebook and os.environ.get("TERM") != "dumb"


@contextmanager
def show_progress(total: int) -> Iterator[Callable[[str, int], None]]:
    """A bar that vanishes, on standard error. Tell it what goes on, and how many more are done.

    What will take more than an hour is said once, in a line that stays; where nothing can be drawn over, how far it is,
    from time to time.
    """
    if not _can_redraw():
        yield _ProgressLines(total, lambda line: click.echo(line, err=True)).add
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
    """A spinner that says what is waited for, and vanishes; nothing where no screen can be drawn over."""
    if not _can_redraw():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


@contextmanager
def show_count(total: int, before: str) -> Iterator[Callable[[int], None]]:
    """The same with runs per second; it is told how many are done in all, and shows `before` until the first are."""
    with show_progress(total) as tell:
        tell(before, 0)
        rate = _Rate()

        def tell_all(done: int) -> None:
            more, text = rate.add(done)
            tell(text or before, more)

        yield tell_all


class _Rate:
    """Runs per second since the first ones: before, a program is compiled."""

    def __init__(self) -> None:
        self.since, self.first, self.most = 0.0, -1, 0

    def add(self, done: int) -> tuple[int, str]:
        """How many more are done, and how fast it goes; who flies and who keeps both tell."""
        now, more = time.monotonic(), max(done - self.most, 0)
        self.most = max(self.most, done)
        if self.first < 0:
            self.since, self.first = now, done
        flown, seconds = self.most - self.first, now - self.since
        return more, f"{flown / seconds:.0f} runs/s" if flown > 0 and seconds > 0 else ""


class _ProgressLines:
    """Progress as lines on standard error: none of what is short.

    The first says how long the whole takes, by the part that is done; what is compiled before is not counted.

    Args:
        total: how many there are to do.
        say: prints a line.
        long: seconds that must be left before a line is worth it.
        each: seconds between two lines.
    """

    def __init__(self, total: int, say: Callable[[str], None], long: float = 5.0, each: float = 30.0) -> None:
        self.total, self.say, self.long, self.each = total, say, long, each
        self.done = self.at_first = 0
        self.began, self.said = 0.0, -math.inf

    def add(self, text: str, more: int) -> None:
        """So many more are done."""
        now = time.monotonic()
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
            self.say(f"{text}: {self.done} of {self.total}, about {format_wait(left)} more on {_cores()}")


def _cores() -> str:
    """How many of this machine's cores may be used."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{count} core{'s' if count > 1 else ''}"


def format_wait(seconds: float) -> str:
    """How long to wait, for people: "40 s", "3 min", "2.5 h"."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

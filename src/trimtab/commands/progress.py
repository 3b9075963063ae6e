"""A progress bar for long work, on standard error."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def show_progress(total: int) -> Iterator[Callable[[str, int], None]]:
    """A bar that vanishes; nothing where standard error is no terminal. Tell it what goes on, and how many are done."""
    if not sys.stderr.isatty():
        yield lambda text, done: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda text, done: bar.update(task, description=text, advance=done)


@contextmanager
def show_spinner(text: str) -> Iterator[None]:
    """A spinner that says what is waited for, and vanishes; nothing where standard error is no terminal."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


@contextmanager
def show_count(total: int, before: str) -> Iterator[Callable[[int], None]]:
    """A bar with rate and remaining time, which is told how many are done in all; `before` until the first are."""
    if not sys.stderr.isatty():
        yield lambda done: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(20), MofNCompleteColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(before, total=total)
        since, first, most = 0.0, -1, -1

        def tell(done: int) -> None:
            nonlocal since, first, most
            now, most = time.monotonic(), max(most, done)  # who flies and who keeps both tell
            if first in (-1, most):  # still compiling
                since, first = now, most
                return
            bar.update(task, description=f"{(most - first) / (now - since):.0f} runs/s", completed=most)

        yield tell

"""What the verbs write: JSON, tables, progress on standard error, and files that are checked before anything runs."""

import contextlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trimtab.core.errors import InputError
from trimtab.logs.log_limit import list_files

if TYPE_CHECKING:  # rich is imported when a table is printed, not for --json
    from rich.console import Console
    from rich.table import Table


def print_json(result: Mapping[str, Any], files: Iterable[str | Path] = ()) -> None:
    """One object on one line; a number that is not finite is null. Names the files, where any were written."""
    names = [str(file) for file in files]
    click.echo(json.dumps(_to_json({**result} | ({"files": names} if names else {})), allow_nan=False))


def _to_json(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _to_json(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_files(files: Iterable[str | Path]) -> None:
    """Say what was written."""
    for file in files:
        click.echo(f"wrote {file}")


def console() -> "Console":
    """Standard output; wide enough for a table when it is not a terminal."""
    from rich.console import Console

    screen = Console(highlight=False, soft_wrap=False)
    return screen if screen.is_terminal else Console(highlight=False, width=140)


def new_table(*headings: str, title: str | None = None, unwrapped: Sequence[str] = ()) -> "Table":
    """An empty table in our style, with a column a heading: one that begins with > stands on the right, as numbers do.

    unwrapped: headings of the columns whose cells stay on one line.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold", title=title, title_justify="left")
    for heading in headings:
        name = heading.removeprefix(">")
        table.add_column(name, justify="left" if name == heading else "right", no_wrap=name in unwrapped)
    return table


def format_number(value: float | None) -> str:
    """A number of a table in few digits; a dash where there is none."""
    if value is None:
        return "-"
    small = value != 0 and abs(value) < 0.01
    return f"{value:.2e}" if small and abs(value) < 1e-4 else f"{value:.5f}" if small else f"{value:.3f}"


def check_picture(picture: Path | None, out: Path | None) -> None:
    """Refuse a folder or a picture that could not be written."""
    if out is not None:
        check_folder("--out", out)
    if picture is not None:
        if picture.suffix.lower() not in (".png", ".pdf", ".svg"):
            problem = f"{picture.name!r} has no picture's ending"
            raise InputError("--plot", problem, choices=(".png", ".pdf", ".svg"), fix=f"--plot {picture.stem}.png")
        if out is None or picture.parent != out:
            check_folder("--plot", picture.parent)
        if picture.is_dir():
            raise InputError("--plot", f"{str(picture)!r} is a folder", fix=f"--plot {picture / 'run.png'}")


def check_folder(part: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, by trying; leaves nothing behind."""
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(part, problem, fix=f"{part} with a folder of yours, e.g. {part} flight") from None
    finally:
        for new in missing:
            with contextlib.suppress(OSError):
                new.rmdir()


def new_log(out: Path, name: str) -> Path:
    """Where a flight's log goes: a new file in the folder, which is made where it is missing."""
    check_folder("--out", out)
    out.mkdir(parents=True, exist_ok=True)
    present = list_files(out / name)
    if present:
        raise InputError("--out", f"there is a log already: {present[0]}", fix="--out with a new folder")
    return out / name


def write_text(file: Path, text: str) -> Path:
    """Write a file, whole or not at all, and its folder where there is none yet."""
    from trimtab.logs.mcap import replace_file  # brings numpy along, which a list of names does not need

    file.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(file) as stream:
        stream.write(text.encode())
    return file


def draw_plot(file: Path | None, plot: Callable[..., object], *subjects: Any, **options: Any) -> list[Path]:
    """Draw a picture of `plots` where a file is named, and its folder where there is none yet; what was written."""
    if file is None:
        return []
    file.parent.mkdir(parents=True, exist_ok=True)
    plot(*subjects, path=file, **options)
    return [file]


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

"""Output of the subcommands as JSON, tables and files. Output paths are checked before anything runs."""

import contextlib
import json
import math
import os
import shlex
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trimtab.commands.written_files import PICTURES, check_new, note_written
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.logs.log_limit import list_files, round_size

if TYPE_CHECKING:  # rich is imported when a table is printed, not for --json
    from rich.console import Console
    from rich.table import Column, Table

NARROWEST = 20
"""Smallest value of the environment variable COLUMNS that is accepted as a terminal width."""


ANSWERS = Path(__file__).with_name("answers.json")
"""JSON Schema of the output of ``--json``."""
ANSWER_VERSION = 1
"""Version of the JSON output. It is increased if a field is removed or changed, not if a field is added."""


def print_json(result: Mapping[str, Any], files: Iterable[str | Path] = (), verb: str = "") -> None:
    """Print the answer of a subcommand as one JSON object on one line, in the format of `ANSWERS`, with files written.

    verb: name of the subcommand, or an empty text for the subcommand that runs.
    """
    names = [str(file) for file in files]
    note_written(names)
    answer = compose_answer(verb or _running_verb(), {**result} | ({"files": names} if names else {}))
    click.echo(json.dumps(answer, allow_nan=False))


def compose_answer(verb: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer of a subcommand: its name with version, then the fields. Non-finite numbers become null."""
    return {"answer": f"{verb}/{ANSWER_VERSION}"} | _to_json(result)


def _running_verb() -> str:
    """Return the name of the subcommand that runs, the word after the program's name."""
    context = click.get_current_context()
    while context.parent is not None and context.parent.parent is not None:
        context = context.parent
    return str(context.info_name)


def print_schema(schema: Mapping[str, Any]) -> None:
    """Print a JSON schema on one line, e.g. for an editor or a validator."""
    click.echo(json.dumps(schema, allow_nan=False))


def _to_json(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _to_json(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def quote(word: str | Path) -> str:
    """Return a file or a name as the user types it in a shell, e.g. with quotes around a name with a space."""
    return shlex.quote(str(word))


def print_files(files: Iterable[str | Path]) -> None:
    """Print the paths of the written files, and record that trimtab wrote them."""
    files = list(files)
    note_written(files)
    for file in files:
        click.echo(f"wrote {file}")


def console() -> "Console":
    """Return a console on standard output.

    If it is not a terminal and COLUMNS is not set, it is wide enough for any table.
    """
    from rich.console import Console

    screen = Console(highlight=False, soft_wrap=False)
    columns = os.environ.get("COLUMNS", "")
    width = int(columns) if columns.isdecimal() and int(columns) >= NARROWEST else None
    return screen if screen.is_terminal and not width else Console(highlight=False, width=width or 140)


def new_table(*headings: str, title: str | None = None, unwrapped: Sequence[str] = ()) -> "Table":
    """Return an empty table in trimtab's style. A heading that begins with > marks a right-aligned column of numbers.

    unwrapped: headings of the columns whose cells stay on one line.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold", title=title, title_justify="left")
    for heading in headings:
        name = heading.removeprefix(">")
        is_number = name != heading
        table.add_column(name, justify="right" if is_number else "left", no_wrap=is_number or name in unwrapped)
    return table


def print_table(table: "Table") -> None:
    """Print a table. If the table is too wide, wrap headings and words, but never numbers.

    A table that still does not fit is printed row by row. Control characters in cells are shown as escapes.
    """
    from rich.text import Text

    screen = console()
    if table.title:  # the table would wrap the title at the table's width, which may be much narrower than the terminal
        screen.print(Text(str(table.title), style="table.title"))
        table.title = None
    for column in table.columns:
        vars(column)["_cells"] = [show_controls(cell) if isinstance(cell, str) else cell for cell in column.cells]
    rows = list(zip(*(column.cells for column in table.columns), strict=True))
    if not rows or _fit_columns(table, screen):
        screen.print(table)
        return
    for row in rows:
        words = [Text.from_markup(str(cell)).plain.strip() for cell in row]
        pairs = [
            f"{c.header}: {word}" if c.header else word for c, word in zip(table.columns, words, strict=True) if word
        ]
        click.echo(click.wrap_text("; ".join(pairs), screen.width, subsequent_indent="    "))


GAPS = ((0, 1), (0, 0))
"""Padding of table cells as (lines, characters), first the normal one, then that for a narrow terminal."""


def _fit_columns(table: "Table", screen: "Console") -> bool:
    """Set the column widths so that the table fits the terminal. Return False if the table cannot fit."""
    least, longest = zip(*(_column_widths(column, screen) for column in table.columns), strict=True)
    for padding in GAPS:
        edges = 2 + (1 + 2 * padding[1]) * (len(least) - 1)
        room, widths = screen.width - edges - sum(least), list(least)
        if room < 0:
            continue
        for _ in range(room):
            lack = [most - width for most, width in zip(longest, widths, strict=True)]
            widths[lack.index(max(lack))] += max(lack) > 0
        table.padding = padding
        for column, width in zip(table.columns, widths, strict=True):
            column.width, column.no_wrap = width, False
        return True
    return False


def _column_widths(column: "Column", screen: "Console") -> tuple[int, int]:
    """Return the minimum and the natural width of a table's column. Cells of an unwrapped column are not broken."""
    heading, *cells = (screen.render_str(str(cell)) for cell in (column.header, *column.cells))
    words = [len(word) for text in (heading, *cells) for word in text.plain.split()]
    whole = [cell.cell_len for cell in cells if column.no_wrap]
    return max((*words, *whole, 1)), max(heading.cell_len, *(cell.cell_len for cell in cells))


def format_number(value: float | None) -> str:
    """Format a number with few digits for a table. Return a dash for None."""
    if value is None:
        return "-"
    if abs(value) >= 1e7:
        return f"{value:.3e}"
    small = value != 0 and abs(value) < 0.01
    return f"{value:.2e}" if small and abs(value) < 1e-4 else f"{value:.5f}" if small else f"{value:.3f}"


def check_picture(picture: Path | None, out: Path | None) -> None:
    """Raise InputError if the folder of --out or the picture of --plot cannot be written."""
    if out is not None:
        check_folder("--out", out)
    if picture is not None:
        if picture.suffix.lower() not in PICTURES:
            problem = f"{picture.name!r} does not end in a supported picture format"
            raise InputError("--plot", problem, choices=PICTURES, fix=f"--plot {picture.stem}.png")
        if out is None or picture.parent != out:
            check_folder("--plot", picture.parent)
        if picture.is_dir():
            raise InputError("--plot", f"{str(picture)!r} is a folder", fix=f"--plot {picture / 'run.png'}")
        check_new("--plot", picture)


def check_animation(file: Path | None) -> None:
    """Raise InputError if the animation of --animate is not a GIF, or cannot be written."""
    if file is not None:
        if file.suffix.lower() != ".gif":
            problem = f"{file.name!r} does not end in .gif"
            raise InputError("--animate", problem, fix=f"--animate {file.with_suffix('.gif')}")
        check_out("--animate", file)


def check_out(option: str, file: Path, example: str = "") -> None:
    """Raise InputError if a file cannot be written, or is a file of the user. example: valid file name for errors."""
    check_folder(option, file.parent)
    if file.is_dir():
        raise InputError(option, f"{str(file)!r} is a folder", fix=f"{option} {file / (example or 'result.json')}")
    check_new(option, file)


def check_folder(part: str, folder: Path) -> None:
    """Raise InputError if a folder is not writable, which is tested with a temporary file."""
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(part, problem, fix=f"{part} with a folder that you can write to, e.g. {part} flight") from None
    finally:
        for new in missing:
            with contextlib.suppress(OSError):
                new.rmdir()


def new_log(out: Path, name: str) -> Path:
    """Return the path of a flight's new log. Create the folder if it is missing."""
    check_folder("--out", out)
    out.mkdir(parents=True, exist_ok=True)
    present = list_files(out / name)
    if present:
        raise InputError("--out", f"the folder already contains a log: {present[0]}", fix="--out with a new folder")
    return out / name


def print_log_size(log: Mapping[str, Any] | None) -> None:
    """Print the size of a flight's log, and the size per minute. log: fields of the log's `LogFileSummary`, or None."""
    if log is not None:
        minute = "" if log["minute_size"] is None else f", {round_size(log['minute_size'])} a minute"
        click.echo(f"log: {round_size(log['size'])}{minute}")


def write_text(file: Path, text: str) -> Path:
    """Write a file atomically. Create the folder if it is missing."""
    from trimtab.logs.mcap import replace_file  # imports numpy, which a list of names does not need

    file.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(file) as stream:
        stream.write(text.encode())
    return file


def draw_plot(file: Path | None, plot: Callable[..., object], *subjects: Any, **options: Any) -> list[Path]:
    """Draw a picture if a file is named, and create the folder if it is missing. Return the files written."""
    if file is None:
        return []
    file.parent.mkdir(parents=True, exist_ok=True)
    plot(*subjects, path=file, **options)
    return [file]

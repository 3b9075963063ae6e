"""Record of the files that trimtab wrote and may replace. Any other file belongs to the user and is kept.

The cache's folder `written` stores digests (SHA-256) of the path and of the content of each file that a subcommand
wrote. A file with that content may be replaced. A file that was edited since, or was not written by trimtab, is not
replaced unless ``--overwrite`` is given: the subcommand ends with an error before anything runs. Without a cache, no
existing file is replaced.
"""

import hashlib
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from trimtab.core.cache_folder import cache_folder
from trimtab.core.errors import InputError

FOLDER = "written"
PICTURES = (".png", ".pdf", ".svg")
"""File name suffixes of the supported picture formats."""
OVERWRITE = "trimtab.overwrite"
"""Key under which the click context stores True after ``--overwrite``."""
LIMIT = 5000
"""Maximum number of recorded files. If there are more, the oldest records are deleted."""


def with_overwrite(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--overwrite`` to a subcommand, unless the subcommand already has it."""
    options = getattr(function, "__click_params__", ())
    if any("--overwrite" in option.opts for option in options):
        return function
    return click.option(
        "--overwrite",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=lambda context, parameter, value: context.meta.update({OVERWRITE: value}),
        help="Replace existing files, even if trimtab did not write them or they were edited since.",
    )(function)


def check_new(option: str, *files: Path | None) -> None:
    """Raise InputError if a file exists that trimtab did not write, or that was edited since.

    option: option with which the user named the files, e.g. --out.
    """
    context = click.get_current_context(silent=True)
    if context is not None and context.meta.get(OVERWRITE):
        return
    for file in files:
        if file is not None and file.is_file() and not _is_as_written(file):
            other = (
                file.with_name(f"{file.stem}{'_' if file.suffix == '.py' else '-'}2{file.suffix}")
                if option != "--out" or file.suffix
                else file
            )
            problem = f"{str(file)!r} already exists; either trimtab did not write it, or it was edited since"
            raise InputError(option, problem, fix=f"another name, e.g. {other.name}, or --overwrite to replace it")


def check_new_in(option: str, folder: Path | None, *patterns: str) -> None:
    """Apply `check_new` to the files of a folder that match patterns, e.g. "*.png"."""
    if folder is not None and folder.is_dir():
        check_new(option, *sorted({file for pattern in patterns for file in folder.glob(pattern)}))


def note_written(files: Iterable[str | Path]) -> None:
    """Record files that trimtab has just written. Without a cache they later count as files of the user."""
    with suppress(OSError):
        folder = cache_folder(FOLDER)
        for file in map(Path, files):
            if file.is_file():
                (folder / _place_digest(file)).write_text(_content_digest(file), encoding="ascii")
        for old in sorted(folder.iterdir(), key=lambda note: note.stat().st_mtime)[:-LIMIT]:
            old.unlink(missing_ok=True)


def place_files(option: str, scratch: Path, files: Iterable[Path], folder: Path) -> list[Path]:
    """Move all files of a scratch folder to the target folder, or none of them. Return the new paths of `files`.

    Raises: InputError if a file would replace a file of the user.
    """
    moves = [(file, folder / file.relative_to(scratch)) for file in sorted(scratch.rglob("*")) if file.is_file()]
    check_new(option, *(place for _, place in moves))
    try:
        for file, place in moves:
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(file, place)
    except OSError as error:
        problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
        raise InputError(option, problem, fix=f"{option} with a folder that you can write to") from None
    note_written(place for _, place in moves)
    return [folder / file.relative_to(scratch) for file in files]


def _is_as_written(file: Path) -> bool:
    try:
        noted = (cache_folder(FOLDER) / _place_digest(file)).read_text(encoding="ascii")
        return noted == _content_digest(file)
    except OSError:
        return False


def _place_digest(file: Path) -> str:
    return hashlib.sha256(str(file.resolve()).encode()).hexdigest()


def _content_digest(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

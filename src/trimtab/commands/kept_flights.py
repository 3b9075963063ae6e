"""Storage of a search's runs in the folder of ``--store``, or else in the cache, so that no runs are lost after Ctrl-C.

Each typed command has a separate folder in the cache, which is deleted when the command has finished. Runs of a
scenario in the user's own file are stored only with ``--store``, because changes in modules that the file imports would
go unnoticed.
"""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import click

from trimtab.core.cache_folder import cache_folder

FOLDER = "searches"
LIMIT = 20
"""Maximum number of stopped searches in the cache. If there are more, the oldest are deleted."""


@contextmanager
def keep_flights(scenario: str, store: Path | None) -> Iterator[Path | None]:
    """Yield the folder in which the runs are stored, or None if runs are not stored.

    After Ctrl-C, report whether the runs are stored.
    """
    folder = store or _cached_folder(scenario)
    try:
        yield folder
    except KeyboardInterrupt:
        kept = "completed runs are stored; the same command continues from there"
        click.echo(kept if folder is not None else "runs are not stored; use --store DIR to continue later", err=True)
        raise
    except BaseException:
        if store is None and folder is not None and not any(folder.glob("*")):
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if store is None and folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def _cached_folder(scenario: str) -> Path | None:
    context = click.get_current_context(silent=True)
    if ":" in scenario or context is None:
        return None
    with suppress(OSError):
        folder = cache_folder(FOLDER)
        for old in sorted(folder.iterdir(), key=lambda one: one.stat().st_mtime)[:-LIMIT]:
            shutil.rmtree(old, ignore_errors=True)
        words = "\n".join((str(context.info_name), scenario, *map(str, sorted(context.params.items()))))
        return folder / hashlib.sha256(f"{words}\n{context.meta}".encode()).hexdigest()
    return None

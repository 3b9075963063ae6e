"""Where a search keeps its flights, so that Ctrl-C loses none: the folder of ``--store``, else one in the cache.

In the cache the folder belongs to the command that was typed, and goes when that is done. A scenario in a file of one's
own is kept with ``--store`` only: what else its code imports can change, and nobody would notice.
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
"""Stopped searches that are kept; beyond, the oldest go."""


@contextmanager
def keep_flights(scenario: str, store: Path | None) -> Iterator[Path | None]:
    """The folder, or None where nothing is kept; says after Ctrl-C what becomes of the flights."""
    folder = store or _cached_folder(scenario)
    try:
        yield folder
    except KeyboardInterrupt:
        kept = "what was flown is kept; the same command goes on from there"
        click.echo(kept if folder is not None else "nothing is kept: with --store DIR it goes on from there", err=True)
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

"""Rows of a campaign on disk, as a Zarr group: an array for each column, written a block at a time, and what is done.

A block's `done` is written after its columns, each chunk under another name and then renamed: whatever ends the
process, a row is done or it isn't, and the same campaign started again flies those that are not.
"""

import contextlib
import errno
import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError

DONE = "done"
LOCK = ".lock"


class Store:
    """An open store; one process writes at a time. Close it, or use it in a `with`."""

    def __init__(self, folder: Path, group: Any, lock: Any) -> None:
        self.folder, self._group, self._lock = folder, group, lock

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let others write."""
        os.close(self._lock)

    @property
    def about(self) -> dict[str, Any]:
        """What the store says of its campaign."""
        return dict(self._group.attrs)

    def done(self) -> Any:
        """Which rows are there: bool (runs,)."""
        return np.asarray(self._group[DONE][:])

    def write(self, first: int, columns: Mapping[str, Any]) -> None:
        """Keep the rows of a block, which begins at a multiple of the block's length.

        Raises: InputError where there is no room, or the disk fails; what was done before remains.
        """
        n = len(next(iter(columns.values())))
        try:
            for name, column in columns.items():
                self._group[key_of(name)][first : first + n] = column
            self._group[DONE][first : first + n] = np.ones(n, bool)
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            problem = (
                f"{'the disk is full' if full else error.strerror or error}: {int(self.done().sum())} runs are kept"
            )
            fix = ("make room, then " if full else "") + "start the same command again: it goes on from there"
            raise InputError(f"store {str(self.folder)!r}", problem, fix=fix) from None

    def read(self) -> dict[str, Any]:
        """Every column by name, of the rows that are done, and `run`, their numbers."""
        done = self.done()
        names = self._group.attrs["columns"]
        return {"run": np.flatnonzero(done), **{n: np.asarray(self._group[key_of(n)][:])[done] for n in names}}


def key_of(name: str) -> str:
    """The name of a column's array: slashes of a path of a file would make groups."""
    return name.replace("/", "|")


def open_store(folder: Path, about: Mapping[str, Any], columns: Mapping[str, Any], runs: int, block: int) -> Store:
    """Open the store of a campaign, or make it; grow it where more runs are wanted.

    Args:
        folder: of the store, e.g. mass.zarr.
        about: attributes; `identity` in it must be that of a store that is there.
        columns: name -> an array of a row's type.
        runs: how many there will be.
        block: rows of a chunk, for a new store.
    """
    zarr = _zarr()
    part = f"store {str(folder)!r}"
    lock = _locked(folder, part)
    try:
        if (folder / "zarr.json").exists():
            group = zarr.open_group(folder, mode="r+")
            _check_same(part, dict(group.attrs), about)
            if runs > group[DONE].shape[0]:
                for name in [*group.attrs["columns"], DONE]:
                    group[key_of(name)].resize((runs,))
                group.attrs.update(dict(about))
            return Store(folder, group, lock)
        if any(f.name != LOCK for f in folder.iterdir()):
            raise InputError(part, "is a folder with other things in it", fix="name another store: --store NAME.zarr")
        group = zarr.open_group(folder, mode="a")
        for name, example in {**columns, DONE: np.zeros(0, bool)}.items():
            kind = np.asarray(example).dtype
            group.create_array(key_of(name), shape=(runs,), chunks=(block,), dtype=kind, fill_value=kind.type(0))
        group.attrs.update({**about, "columns": list(columns), "block": block})
        return Store(folder, group, lock)
    except OSError as error:
        os.close(lock)
        raise InputError(
            part, f"{error.strerror or error}", fix="make room, or name another store: --store NAME.zarr"
        ) from None
    except BaseException:
        os.close(lock)
        raise


def read_store(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Attributes and columns of a store that is there; a campaign may be writing it meanwhile."""
    zarr = _zarr()
    if not (folder / "zarr.json").exists():
        raise InputError(
            "--store", f"there is no store {str(folder)!r}", fix="trimtab campaign SCENARIO --store NAME.zarr"
        )
    store = Store(folder, zarr.open_group(folder, mode="r"), -1)
    return store.about, store.read()


def block_of(folder: Path) -> int | None:
    """Rows of a chunk of the store that is there, or None."""
    with contextlib.suppress(OSError, ValueError, KeyError):
        return int(json.loads((folder / "zarr.json").read_text())["attributes"]["block"])
    return None


def missing(done: Any, runs: int, block: int) -> Iterator[tuple[int, int]]:
    """First and last + 1 of each block in which a row is missing."""
    for first in range(0, runs, block):
        last = min(first + block, runs)
        if not done[first:last].all():
            yield first, last


def _locked(folder: Path, part: str) -> int:
    """The store's lock, which ends with this process."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        problem = f"cannot write there: {(error.strerror or str(error)).lower()}"
        raise InputError(part, problem, fix="--store with a folder of yours, e.g. --store mass.zarr") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        fix = "wait for it to end, or give this one another store: --store OTHER.zarr"
        raise InputError(part, "another campaign is writing it", fix=fix) from None
    return lock


def _check_same(part: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuse to mix rows that another campaign, scenario, version or machine made."""
    was, now = there.get("identity"), here["identity"]
    if was == now:
        return
    if not isinstance(was, Mapping):
        raise InputError(part, "holds no campaign", fix="name another store: --store NAME.zarr")
    apart = [name for name in now if was.get(name) != now[name]]
    told = ", ".join(f"{name} (there {was.get(name)}, here {now[name]})" for name in apart)
    fix = "the command that made it is in its attribute `command`; or name another store: --store OTHER.zarr"
    raise InputError(part, f"holds rows of another campaign: {told} differs", fix=fix)


def _zarr() -> Any:
    try:
        import zarr
    except ImportError:
        raise InputError("--store", "needs zarr", fix='pip install "trimtab[campaign]"') from None
    return zarr

"""Rows (results of runs) of a campaign, in memory or on disk as a Zarr group. The group has one array for each column,
and an array `done` that marks finished rows.

For a block of rows, `done` is written after the block's columns have reached the disk. Each chunk is written under a
temporary name and then renamed. A row is therefore either finished or not, even if the process is killed. When the same
campaign is started again, it flies the missing rows. Chunks have a checksum. A block with a damaged or missing chunk is
flown again.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name, install_command

DONE = "done"
LOCK = ".lock"
PARTIAL = ".partial"
"""Suffix of the temporary names under which Zarr writes files before it renames them."""
LONGEST_KEY = 160
"""Maximum length of an array's name in bytes."""


class MemoryStore:
    """Store of a campaign's rows in memory, with the interface of `CampaignStore`.

    The rows are lost when the process ends.
    """

    def __init__(self, runs: int) -> None:
        self._runs, self._finished_rows = runs, np.zeros(runs, bool)
        self._columns: dict[str, Any] = {}

    def finished_rows(self) -> Any:
        """Return an array (runs,) that is True for each finished run."""
        return self._finished_rows.copy()

    def write(self, first: int, columns: Mapping[str, Any]) -> None:
        """Store the rows of a block of runs. first: number of the first run."""
        for name, column in columns.items():
            rows = self._columns.setdefault(name, np.zeros(self._runs, np.asarray(column).dtype))
            rows[first : first + len(column)] = column
        self._finished_rows[first : first + len(columns["success"])] = True

    def read(self) -> dict[str, Any]:
        """Return the columns of the finished rows by name. The column `run` contains the run numbers."""
        done = self._finished_rows
        return {"run": np.flatnonzero(done), **{name: rows[done] for name, rows in self._columns.items()}}


def array_key(name: str) -> str:
    """Return the name of a column's array in the store.

    The name has no slashes, which would create groups, and a limited length.
    """
    key = name.replace("/", "|")
    return key if len(key.encode()) <= LONGEST_KEY else f"{key[:80]}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"


def has_store(folder: Path) -> bool:
    """Return True if the folder contains a store. Incomplete files of a killed process are not a store.

    Raises: InputError if the folder contains other files.
    """
    about = folder / "zarr.json"
    files = [f for f in folder.rglob("*") if f.is_file() and f.name != LOCK and f.suffix != PARTIAL]
    if all(f.name == "zarr.json" for f in files):
        return about.exists() and bool(about.read_text()) and bool(json.loads(about.read_text()).get("attributes"))
    if not about.exists():
        fix = f"name another store: {argument('store', 'NAME.zarr')}"
        raise InputError(f"store {str(folder)!r}", "contains files that do not belong to a campaign's store", fix=fix)
    return True


def create_group(zarr: Any, folder: Path, columns: Mapping[str, Any], runs: int, block: int) -> Any:
    """Create the Zarr group of a new store. Incomplete files of a killed process are overwritten."""
    group = zarr.open_group(folder, mode="a")
    options: dict[str, Any] = {"shape": (runs,), "chunks": (block,), "overwrite": True}
    options["compressors"] = [zarr.codecs.ZstdCodec(level=0, checksum=True)]
    for name, example in {**columns, DONE: np.zeros(0, bool)}.items():
        kind = np.asarray(example).dtype
        group.create_array(array_key(name), dtype=kind, fill_value=kind.type(0), **options)
    return group


def sync_descriptions(folder: Path) -> None:
    """Flush the metadata files of the group and of its arrays to the disk."""
    sync_files(folder.glob("*/zarr.json"))
    sync_files([folder / "zarr.json"])


def sync_files(files: Iterable[Path]) -> None:
    """Flush files and their directory entries to the disk, several at a time."""
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(_sync_file, files))


def _sync_file(file: Path) -> None:
    for place in (file, file.parent):
        handle = os.open(place, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


class CampaignStore:
    """Open store of a campaign. Only one process at a time can write.

    Close the store after use, or use it in a `with` block.
    """

    def __init__(self, folder: Path, group: Any, lock: Any) -> None:
        self.folder, self._group, self._lock = folder, group, lock
        self._block = int(group.attrs["block"])
        names = [*group.attrs["columns"], DONE]
        self._arrays = {n: group[array_key(n)].with_config({"write_empty_chunks": True}) for n in names}

    def __enter__(self) -> "CampaignStore":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock of the store."""
        os.close(self._lock)

    @property
    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the store, which describe the campaign."""
        return dict(self._group.attrs)

    def finished_rows(self) -> Any:
        """Return an array (runs,) that is True for each finished run."""
        return np.asarray(self._arrays[DONE][:])

    def write(self, first: int, columns: Mapping[str, Any]) -> None:
        """Store the rows of a block that begins at a multiple of the block's length.

        Raises: InputError if the disk is full or fails. Earlier rows remain.
        """
        n = len(next(iter(columns.values())))
        try:
            for name, column in columns.items():
                self._arrays[name][first : first + n] = column
            sync_files(self._chunk_path(name, first // self._block) for name in columns)
            self._arrays[DONE][first : first + n] = np.ones(n, bool)
            sync_files([self._chunk_path(DONE, first // self._block)])
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            cause = "the disk is full" if full else error.strerror or error
            problem = f"{cause}; {int(self.finished_rows().sum())} finished runs are stored"
            fix = ("free disk space, then " if full else "") + "start the same command again; it resumes there"
            raise InputError(f"store {str(self.folder)!r}", problem, fix=fix) from None

    def read(self) -> dict[str, Any]:
        """Return the columns of the finished rows by name. The column `run` contains the run numbers."""
        try:
            done = self.finished_rows()
            columns = {n: np.asarray(a[: len(done)])[done] for n, a in self._arrays.items() if n != DONE}
        except RuntimeError as error:
            problem = f"a chunk is damaged: {error}"
            fix = "start the command that made the store again; it flies the damaged runs again"
            raise InputError(f"store {str(self.folder)!r}", problem, fix=fix) from None
        return {"run": np.flatnonzero(done), **columns}

    def repair(self) -> None:
        """Mark the rows of blocks with a damaged or missing chunk as not finished, so that they are flown again."""
        for k in self._damaged_chunks(DONE, set()):
            self._chunk_path(DONE, k).unlink()
        done, bounds = self.finished_rows(), self._chunk_bounds()
        needed = {k for k, (first, last) in enumerate(bounds) if done[first:last].any()}
        for k in set().union(*(self._damaged_chunks(name, needed) for name in self._arrays)):
            first, last = bounds[k]
            self._arrays[DONE][first:last] = np.zeros(last - first, bool)
            for name in self._arrays:
                if name != DONE:
                    self._chunk_path(name, k).unlink(missing_ok=True)

    def _damaged_chunks(self, name: str, needed: set[int]) -> set[int]:
        """Return the numbers of those chunks of a column that are unreadable, or that are needed but missing."""
        there = {int(f.name) for f in self._chunk_path(name, 0).parent.glob("*")}
        if self._is_readable(name, slice(None)):
            return needed - there
        bounds = self._chunk_bounds()
        return (needed - there) | {k for k in there if not self._is_readable(name, slice(*bounds[k]))}

    def _is_readable(self, name: str, rows: slice) -> bool:
        try:
            self._arrays[name][rows]
        except RuntimeError:
            return False
        return True

    def _chunk_bounds(self) -> list[tuple[int, int]]:
        """Return first row and last row + 1 of each chunk of rows."""
        runs = self._arrays[DONE].shape[0]
        return [(first, min(first + self._block, runs)) for first in range(0, runs, self._block)]

    def _chunk_path(self, name: str, k: int) -> Path:
        return self.folder / array_key(name) / "c" / str(k)


def open_store(
    folder: Path, about: Mapping[str, Any], columns: Mapping[str, Any], runs: int, block: int
) -> CampaignStore:
    """Open or create the store of a campaign. Enlarge the store if more runs are requested.

    Args:
        folder: folder of the store, e.g. mass.zarr.
        about: attributes of the store. The attribute `identity` must equal that of an existing store.
        columns: column name -> array with the data type of the column.
        runs: total number of runs.
        block: number of rows in a chunk of a new store.
    """
    zarr = _import_zarr()
    part = f"store {str(folder)!r}"
    lock = _acquire_lock(folder, part)
    try:
        was_there = has_store(folder)
        if was_there:
            group = zarr.open_group(folder, mode="r+")
            _check_identity(part, dict(group.attrs), about)
            if runs > group[DONE].shape[0]:
                for name in [*group.attrs["columns"], DONE]:
                    group[array_key(name)].resize((runs,))
                group = group.update_attributes(dict(about))
                sync_descriptions(folder)
        else:
            group = create_group(zarr, folder, columns, runs, block)
            group = group.update_attributes({**about, "columns": list(columns), "block": block})
            sync_descriptions(folder)
        for half in folder.rglob("*" + PARTIAL):  # remains of killed processes
            half.unlink()
        store = CampaignStore(folder, group, lock)
        if was_there:
            store.repair()
        return store
    except BaseException as error:
        os.close(lock)
        if isinstance(error, json.JSONDecodeError | KeyError):
            problem = f"a description in the store is damaged: {error}"
            raise InputError(part, problem, fix=f"name another store: {argument('store', 'OTHER.zarr')}") from None
        if isinstance(error, OSError):
            fix = f"free disk space, or name another store: {argument('store', 'NAME.zarr')}"
            raise InputError(part, f"{error.strerror or error}", fix=fix) from None
        raise


def read_store(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return attributes and columns of an existing store. A campaign may write to the store at the same time."""
    zarr = _import_zarr()
    if not (folder / "zarr.json").exists():
        fix = "trimtab campaign SCENARIO --store NAME.zarr"
        raise InputError(argument_name("store"), f"the store {str(folder)!r} does not exist", fix=fix)
    group = zarr.open_group(folder, mode="r")
    if "identity" not in group.attrs:
        raise InputError(
            f"store {str(folder)!r}",
            "contains no campaign",
            fix=f"name a campaign's store: {argument('store', 'NAME.zarr')}",
        )
    store = CampaignStore(folder, group, -1)
    return store.attributes, store.read()


def estimate_store_size(folder: Path, runs: int) -> int | None:
    """Estimate the size (bytes) of a store with `runs` runs from the finished blocks.

    Return None without a finished block.
    """
    arrays, finished = _finished_chunks(folder, runs)
    with contextlib.suppress(OSError):
        kept = sum((array / "c" / k).stat().st_size for array in arrays for k in finished)
        head = sum((place / "zarr.json").stat().st_size for place in [folder, *arrays])
        return round(head + kept * runs / sum(finished.values())) if finished else None
    return None


def count_missing_rows(folder: Path, runs: int) -> int:
    """Return the number of rows that are missing in a store, which need not exist."""
    return runs - sum(_finished_chunks(folder, runs)[1].values())


def _finished_chunks(folder: Path, runs: int) -> tuple[list[Path], dict[str, int]]:
    """Return the folders of the arrays, and name of each finished chunk -> number of rows in the chunk."""
    with contextlib.suppress(OSError, ValueError, KeyError):
        about = json.loads((folder / "zarr.json").read_text())["attributes"]
        block, arrays = int(about["block"]), [folder / array_key(name) for name in [*about["columns"], DONE]]
        names = [k for f in (arrays[-1] / "c").iterdir() if (k := f.name).isdecimal() and int(k) * block < runs]
        return arrays, {k: min(block, runs - block * int(k)) for k in names}
    return [], {}


def read_block_length(folder: Path) -> int | None:
    """Return the number of rows in a chunk of an existing store, or None if the store does not exist."""
    with contextlib.suppress(OSError, ValueError, KeyError):
        return int(json.loads((folder / "zarr.json").read_text())["attributes"]["block"])
    return None


def missing_blocks(done: Any, runs: int, block: int) -> Iterator[tuple[int, int]]:
    """Yield first row and last row + 1 of each block in which a row is missing."""
    for first in range(0, runs, block):
        last = min(first + block, runs)
        if not done[first:last].all():
            yield first, last


def _acquire_lock(folder: Path, part: str) -> int:
    """Acquire the lock of a store. The lock is released when this process ends, or earlier."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        problem = f"cannot write to this folder: {(error.strerror or str(error)).lower()}"
        raise InputError(
            part,
            problem,
            fix=(
                f"{argument_name('store')} with a folder that you can write to, e.g. {argument('store', 'mass.zarr')}"
            ),
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        fix = f"wait until that campaign ends, or use another store: {argument('store', 'OTHER.zarr')}"
        raise InputError(part, "another campaign is writing to it", fix=fix) from None
    return lock


def _check_identity(part: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raise InputError if the stored rows come from another campaign, scenario, version or machine."""
    was, now = there.get("identity"), here["identity"]
    if was == now:
        return
    if not isinstance(was, Mapping):
        raise InputError(part, "contains no campaign", fix=f"name another store: {argument('store', 'NAME.zarr')}")
    apart = [name for name in now if was.get(name) != now[name]]
    differences = ", ".join(f"{name} (stored {was.get(name)}, now {now[name]})" for name in apart)
    fix = "the store's attribute `command` contains the command that made the store; or use another store: "
    fix += argument("store", "OTHER.zarr")
    raise InputError(part, f"contains rows of another campaign; different: {differences}", fix=fix)


def _import_zarr() -> Any:
    try:
        import zarr
    except ImportError:
        raise InputError(argument_name("store"), "needs zarr", fix=install_command("campaign")) from None
    return zarr

"""Cache of a search's flights on disk, from which the same search resumes after a stop.

A search is reproducible, because its points depend only on its seed and on earlier flights. Each block of flights is
stored under a SHA-256 key of the block's origin (plan, scenario, this package, the user's scenario file) and points.
After a restart, the search requests the same points and reads the stored blocks. Blocks in an unreadable file are flown
again. Changes in modules that the user's scenario file imports are not detected, so use a new folder after such
changes.
"""

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.cache_folder import package_stamp
from trimtab.core.errors import InputError, argument_name
from trimtab.logs.mcap import replace_file

Columns = dict[str, Any]


class FlightMemo:
    """Cache of flights in a folder, with one file for each block of flights.

    Args:
        folder: folder of the cache, created if missing. None: nothing is stored.
        about: origin of the flights: digests of campaign and scenario, backend, versions. It is part of each key.
        scenario: name of the scenario. If it names a Python file, the text of this file is part of each key, too.
    """

    def __init__(self, folder: Path | None, about: Mapping[str, Any], scenario: str = "") -> None:
        self.folder, self.recalled = folder, 0
        own = Path(scenario.rpartition(":")[0])
        text = own.read_bytes() if own.suffix == ".py" and own.is_file() else b""
        head = json.dumps([package_stamp(), dict(about)], sort_keys=True, default=str)
        self._head = hashlib.sha256(head.encode() + text).digest()
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                problem = f"cannot write in {str(folder)!r}: {(error.strerror or str(error)).lower()}"
                raise InputError(
                    argument_name("store"), problem, fix=f"{argument_name('store')} with a folder that you can write to"
                ) from None

    def recall(self, asked: Iterable[Any], fly: Callable[[], Columns]) -> Columns:
        """Return the results of a block of flights: stored results if available, otherwise those of `fly`.

        asked: arrays that identify the block.
        """
        if self.folder is None:
            return fly()
        file = self.folder / f"{self._digest(asked)}.npz"
        with suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as kept:
                columns = {name: kept[name] for name in kept.files}
            self.recalled += 1
            return columns
        columns = fly()
        with replace_file(file) as stream:
            np.savez(stream, **columns)
        return columns

    def _digest(self, asked: Iterable[Any]) -> str:
        digest = hashlib.sha256(self._head)
        for array in map(np.asarray, asked):
            digest.update(f"{array.dtype.str} {array.shape} ".encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

"""Stored flights of a search, from which the same search resumes after a stop.

A search is reproducible: its points follow from its seed and from earlier flights. Each block of flights is stored
under the SHA-256 of its origin (plan, scenario, this package, a scenario's own file) and of its request. After a
restart, the search makes the same requests and reads the stored blocks. An unreadable file is flown again. Changes in
code that a scenario's own file imports are not detected, so use a new folder after such changes.
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
    """Flights stored in a folder, one file for each block.

    Args:
        folder: the folder, created if missing. None: nothing is stored.
        about: origin of the flights besides the request: names of plan and scenario, metrics.
        scenario: name of the scenario. The text of its own file is part of the key, too.
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
        """Return the columns for a request (arrays): stored columns if there are any, otherwise newly flown columns."""
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

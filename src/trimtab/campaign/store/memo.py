"""Flights of a search, kept as they come, so that the same search goes on where it was stopped.

A search is the same each time: its points follow from its seed and from what flew before. So each block of flights is
kept under the SHA-256 of what made it (the plan, the scenario, this package, a scenario's own file) and of what was
asked for. Started again, the search asks for the same, and what was flown is read instead. A file that can't be read is
flown again. Changed code that a scenario's own file imports isn't noticed: give that a new folder.
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
    """What was flown, in a folder of files, one a block.

    Args:
        folder: where; made if need be. None: nothing is kept.
        about: what makes the flights, besides what is asked for: names of plan and scenario, metrics.
        scenario: its name; the text of a file of its own counts, too.
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
                    argument_name("store"), problem, fix=f"{argument_name('store')} with a folder of yours"
                ) from None

    def recall(self, asked: Iterable[Any], fly: Callable[[], Columns]) -> Columns:
        """The columns of what is asked for, arrays: as they were flown before, or by flying now."""
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

"""Rows of a campaign without a store."""

from collections.abc import Mapping
from typing import Any

import numpy as np


class InMemory:
    """Rows in memory, gone with the process; as `Store` else."""

    def __init__(self, runs: int) -> None:
        self._runs, self._done = runs, np.zeros(runs, bool)
        self._columns: dict[str, Any] = {}

    def done(self) -> Any:
        """Which rows are there: bool (runs,)."""
        return self._done.copy()

    def write(self, first: int, columns: Mapping[str, Any]) -> None:
        """Keep the rows of a block."""
        for name, column in columns.items():
            held = self._columns.setdefault(name, np.zeros(self._runs, np.asarray(column).dtype))
            held[first : first + len(column)] = column
        self._done[first : first + len(columns["success"])] = True

    def read(self) -> dict[str, Any]:
        """Every column by name, of the rows that are done, and `run`, their numbers."""
        return {"run": np.flatnonzero(self._done), **{n: c[self._done] for n, c in self._columns.items()}}

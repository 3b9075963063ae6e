"""Derived signals of a vehicle that moves in three dimensions, for the pages: roll, pitch, yaw, altitude and speeds.

For a recording, `logs.spatial.with_flight` derives the signals from the true state. For a live flight, this module
derives the signals from the estimate. It runs in the console's process, so that the flight itself has no additional
work.
Source: docs page, Protocol of the console.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.flight.console_packets import HEAD
from trimtab.logs.spatial import DECLARED, FLIGHT, find_named, find_spatial, work_out_flight

ESTIMATE = "estimate.state."
UNWRAPPED = {"roll", "yaw"}
TURN = 2 * np.pi


class FlightNumbers:
    """Derived signals that are appended to the rows of a flight. Without an estimated attitude, no signals are
    appended."""

    def __init__(self, signals: Sequence[Mapping[str, Any]]) -> None:
        """signals: descriptions of the signals of a row, in order, as in the first message to a page (hello)."""
        own = [s for s in signals if not s["path"].startswith(FLIGHT)]
        slots: dict[str, list[int]] = {}
        declared: dict[str, Quantity] = {}
        for k, signal in enumerate(own):
            number = re.fullmatch(r"(.+)\.\d+", signal["path"])
            if number and number[1].startswith(ESTIMATE):
                slots.setdefault(number[1], []).append(k)
                declared[number[1]] = Quantity(signal["unit"], signal["meaning"], signal["frame"], signal["kind"])
        found = find_spatial({path: (len(at),) for path, at in slots.items()}, declared)
        self.found = found if found is not None and found.frame == "W" else None
        """Signals of the estimate from which the appended signals are derived, or None without an estimated
        attitude."""
        self._slots = {path: slots[path] for path in (self.found or ())[:4] if path}
        order = {signal["path"]: k for k, signal in enumerate(own)}
        self._named = {} if self.found else {n: order[p] for n, p in find_named(order, ESTIMATE).items()}
        self._before: dict[str, float] = {}
        names = self._work_out(np.zeros(len(own)))
        self.declared = {FLIGHT + name: DECLARED[name] for name in names}
        """Declaration of each signal that is appended to a row, by path."""

    def extend(self, row: bytes) -> bytes:
        """Return a row of the flight with the derived signals appended."""
        if not self.declared:
            return row
        numbers = self._work_out(np.frombuffer(row, "<f4", offset=HEAD.size))
        for name in UNWRAPPED & numbers.keys():
            before = self._before.get(name, np.nan)
            if np.isfinite(before):
                numbers[name] -= TURN * np.round((numbers[name] - before) / TURN)
            self._before[name] = numbers[name]
        return row + np.array(list(numbers.values()), "<f4").tobytes()

    def _work_out(self, row: Any) -> dict[str, float]:
        if self.found is None:
            return {name: float(row[at]) for name, at in self._named.items()}
        rows = {path: row[at][None].astype(float) for path, at in self._slots.items()}
        return {name: float(x[0]) for name, x in work_out_flight(self.found, np.zeros(1), rows, {}).items()}

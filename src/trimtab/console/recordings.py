"""Recorded flights in a console: conversion of logs to the format of the pages, and the source of these data for the
server.

A log is untrusted data. The scenario that a log names is used only if trimtab's catalogue contains this scenario.
Source: docs page, Protocol of the console.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from trimtab.console.access import HEADERS
from trimtab.console.clients import Client
from trimtab.console.hello import describe_signal, describe_view, list_set_points, shorten_hash
from trimtab.core.errors import InputError
from trimtab.core.time import UNITS_PER_SECOND, to_seconds
from trimtab.flight.console_packets import LONGEST_VECTOR, ROW_PERIOD
from trimtab.logs.log import Log
from trimtab.logs.mcap import read_mcap
from trimtab.logs.spatial import with_flight
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.recorded import rebuild_scenario


class Recording(NamedTuple):
    """Recorded flight.

    rows: bytes of all rows. A row is a time as float64 and a float32 for each signal.  about: description of the
    recording for the pages.
    """

    about: Mapping[str, Any]
    rows: bytes
    events: Sequence[Mapping[str, Any]]


def record_flight(log: Log, title: str, file: str = "", scenario: Scenario | None = None) -> Recording:
    """Convert a log to a recording for the pages. Rows are left out if the log has a higher row rate than a live
    flight.

    Args:
        log: log of a run or a flight.
        title: title that the page shows.
        file: path of the log.
        scenario: scenario that defines beacons, fence and set-points, or None if it is unknown.
    """
    if not len(log):
        raise InputError(title, "has no rows", fix="use the log of a run or a flight")
    log = with_flight(log)
    slots = log.ticks // ROW_PERIOD
    kept = np.concatenate([[True], np.diff(slots) > 0])
    names, columns = _list_columns(log)
    table = np.zeros(int(kept.sum()), np.dtype([("t", "<f8"), ("x", "<f4", (len(names),))]))
    table["t"] = log.ticks[kept] / UNITS_PER_SECOND
    with np.errstate(over="ignore"):
        for k, column in enumerate(columns):
            table["x"][:, k] = column[kept]
    paths = [name["path"] for name in names]
    about = {
        "title": title,
        "file": file,
        "duration": float(table["t"][-1] - table["t"][0]),
        "rows": len(table),
        "row_period": to_seconds(ROW_PERIOD),
        "signals": names,
        "view": describe_view(paths, scenario),
        "set_points": {} if scenario is None else list_set_points(scenario, paths),
        "calibration": shorten_hash(log.metadata.get("choices")),
        "side": str(log.metadata.get("side", "simulation")),
    }
    events = [{"t": e["t"], "text": e["text"], "level": "info"} for e in log.metadata.get("events") or ()]
    return Recording(about, table.tobytes(), events)


def _list_columns(log: Log) -> tuple[list[dict[str, Any]], list[Any]]:
    """Return descriptions and values of the signals that the page shows, selected as in `flight.console_line`."""
    names, columns = [], []
    for path in log.paths:
        declared, values = log.declarations.get(path), np.asarray(log[path])
        width = math.prod(values.shape[1:])
        if (
            width > LONGEST_VECTOR
            or (declared is not None and declared.kind == "time")
            or values.dtype.kind not in "fiub"
        ):
            continue
        flat = values.reshape(len(values), width)
        own = [path] if values.ndim == 1 else [f"{path}.{k}" for k in range(width)]
        names += [describe_signal(name, declared) for name in own]
        columns += [flat[:, k] for k in range(width)]
    return names, columns


def load_recording(file: Path) -> Recording:
    """Load a log from a file, and convert it to a recording. Beacons and fence are shown if the catalogue contains the
    log's scenario."""
    log = read_mcap(file)
    try:
        scenario = rebuild_scenario(log)
    except InputError:
        scenario = None
    return record_flight(log, "/".join(file.parts[-2:]), str(file), scenario)


class RecordingFeed:
    """Source of data for pages without a live flight: the first message (hello), and recorded flights by number."""

    def __init__(self, hello: Mapping[str, Any], flights: Sequence[Recording]) -> None:
        """hello: first message to a page, without the list of recorded flights."""
        self._hello, self.flights = hello, list(flights)
        self.clients: list[Client] = []
        self._count = 0

    def join(self, client: Client) -> None:
        """Add a page, and send it the first message (hello)."""
        self.clients.append(client)
        client.send({"type": "hello", "role": client.role, **self._hello, "flights": [f.about for f in self.flights]})

    def leave(self, client: Client, why: str) -> None:
        """Remove a page."""
        self.clients.remove(client)

    def next_number(self) -> int:
        """Return a number for a new page."""
        self._count += 1
        return self._count

    def handle(self, client: Client, message: dict[str, Any]) -> None:
        """Ignore messages of pages, because there is no live flight."""

    def routes(self) -> list[BaseRoute]:
        """Return the HTTP routes that serve recorded flights."""
        return [
            Route("/flights/{k:int}", self._pick(lambda flight: JSONResponse(flight.about, headers=HEADERS))),
            Route("/flights/{k:int}/rows", self._pick(lambda flight: Response(flight.rows, headers=HEADERS))),
            Route("/flights/{k:int}/events", self._pick(lambda flight: JSONResponse(flight.events, headers=HEADERS))),
        ]

    def _pick(self, answer: Callable[[Recording], Response]) -> Any:
        async def give(request: Request) -> Response:
            k = request.path_params["k"]
            if k >= len(self.flights):
                return PlainTextResponse(f"no flight {k}\n", 404, HEADERS)
            return answer(self.flights[k])

        return give


def describe_recordings(flights: Sequence[Recording]) -> dict[str, Any]:
    """Return the first message (hello) for one or two recordings."""
    first = flights[0].about
    return {"kind": "recording", "title": " and ".join(f.about["title"] for f in flights), **_blank(first)}


def _blank(about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of the first message that describes the drawing of the vehicle, with empty values for the control
    of a flight."""
    drawn = {name: about[name] for name in ("signals", "row_period", "view", "set_points")}
    return drawn | {"parameters": [], "supervisor": None, "pilot": None, "ages": []}

"""Whole flights in lockstep: a compiled side, its line, its log.

Source: docs page, Lockstep.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.interfaces import Link
from trimtab.core.time import ms, to_seconds
from trimtab.live.autopilot_end import Pilot, dialect_for, frame_name
from trimtab.live.flight_log import FlightLog, Source
from trimtab.live.lockstep import follow, lead
from trimtab.live.virtual_vehicle import VirtualVehicle
from trimtab.live.world_step import compiled_world
from trimtab.logs.stream import Written
from trimtab.loop.scenario import Scenario
from trimtab.run.fast_step import fast_step
from trimtab.run.program import described
from trimtab.wire.dialect import Dialect, dialect_of
from trimtab.wire.mavlink import Endpoint

MakeEndpoint = Callable[[Dialect], Endpoint]


class LockstepVehicle:
    """The vehicle's end: it leads."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the world. endpoint: makes the vehicle's end for a dialect."""
        world, frame, command = compiled_world(scenario, seed=seed)
        dialect = dialect_of(frame, command)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.body = VirtualVehicle(scenario, dialect, world)

    def run(self, link: Link, log: Path | None = None, log_period: int = ms(1)) -> Written | None:
        """Lead through the scenario's duration; raises Silence where nobody follows."""
        body, world = self.body, self.body.world
        about = described(self.scenario) | {"side": "vehicle", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(log_period)
        sources = [Source(body.row, world.exported.outputs, lambda p: p)]
        book = FlightLog(log, sources, {}, about) if log else None

        def each(t: int) -> None:
            if book is not None and t and body.row_t % log_period == 0:
                book.put(body.row_t)

        written = None
        try:
            lead(body, link, self.endpoint, each)
        finally:
            self.endpoint.close()
            written = book.close(self._final()) if book else None
        return written

    def _final(self) -> dict[str, Any]:
        world = self.body.world
        return {p: np.array(world.outputs[at]) for p, at in world.writes.items() if p.startswith("truth.")}


class LockstepPilot:
    """The autopilot's end: it follows."""

    def __init__(self, scenario: Scenario, endpoint: MakeEndpoint, *, seed: int = 0) -> None:
        """Compile the autopilot. endpoint: makes its end for a dialect."""
        scenario.check()
        dialect = dialect_for(scenario)
        self.scenario, self.seed = scenario, seed
        self.endpoint = endpoint(dialect)
        self.pilot = Pilot(scenario, dialect, fast_step(scenario, seed=seed))

    def run(self, link: Link, log: Path | None = None) -> Written | None:
        """Follow through the scenario's duration; raises Silence where nobody leads."""
        step, period = self.pilot.step, self.scenario.autopilot.period
        about = described(self.scenario) | {"side": "autopilot", "seed": self.seed, "run": 0, "backend": "c"}
        about["log_period_s"] = to_seconds(period)
        sources = [
            Source(step.inputs, step.exported.inputs, frame_name),
            Source(step.outputs, step.exported.outputs, lambda p: p),
        ]
        book = FlightLog(log, sources, {}, about) if log else None
        written = None
        try:
            for t in follow(self.pilot, link, self.endpoint, self.scenario.duration, period):
                if book is not None:
                    book.put(t)
        finally:
            self.endpoint.close()
            written = book.close() if book else None
        return written

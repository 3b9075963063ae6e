"""The supervisor in a compiled autopilot: what it has decided, and what it is asked in flight.

A request goes into the frame, as the sample that the supervisor reads; so the flight's log has it, and a replay repeats
it.
Source: docs pages, Fly and Supervisor.
"""

from typing import NamedTuple

from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervision import ENDED, FLYING, HOLD, REQUESTS
from trimtab.run.fast_step import FastStep

LEADS_TO = {"hold": HOLD, "resume": FLYING, "end": ENDED}
"""Where a request leads: it isn't made again where that is so already, say because its acknowledgement was lost."""


class _Named(NamedTuple):
    at: int
    names: tuple[str, ...]


class _Place(NamedTuple):
    request: int
    t: int
    age: int
    fresh: int
    valid: int


class Supervised:
    """The supervisor of a compiled step; where there is none, it decides nothing and takes no requests."""

    def __init__(self, scenario: Scenario, step: FastStep) -> None:
        """step: the compiled autopilot of this scenario."""
        self._step = step
        declared = {m.path: m.declared for m in step.exported.outputs}
        paths = ("supervisor.mode", "supervisor.cause")
        self._watched = [_Named(step.writes[p], d.modes) for p in paths if (d := declared.get(p)) is not None]
        self._decided: tuple[int, ...] = ()
        supervisor = scenario.autopilot.supervisor
        sample = "" if supervisor is None else f"samples.{supervisor.pilot}"
        fields = ("value.request", "t", "age", "fresh", "valid")
        places = [step.reads[path] for path in (f"{sample}.{f}" for f in fields) if path in step.reads]
        self._place = _Place(*places) if len(places) == len(fields) and self._watched else None
        self._wanted: str | None = None

    @property
    def mode(self) -> int | None:
        """The supervisor's, by its number; None where there is none, or it can't be asked."""
        return None if self._place is None else int(self._step.outputs[self._watched[0].at])

    def ask(self, request: str) -> None:
        """Make a request in the next step, unless it would change nothing."""
        self._wanted = None if self.mode in (None, LEADS_TO[request]) else request

    def give(self, t: int) -> None:
        """What the step at integer time t reads of requests."""
        if self._place is None:
            return
        inputs, at = self._step.inputs, self._place
        inputs[at.fresh] = self._wanted is not None
        if self._wanted is not None:
            inputs[at.request], inputs[at.t], inputs[at.valid] = REQUESTS.index(self._wanted), t, True
            self._wanted = None
        inputs[at.age] = (t - inputs[at.t]) * SECONDS_PER_UNIT

    def news(self) -> str:
        """What it has decided since this was last asked, for people; empty for nothing."""
        found = tuple(int(self._step.outputs[one.at]) for one in self._watched)
        if found == self._decided:
            return ""
        self._decided = found
        return "supervisor: " + ": ".join(one.names[k] for one, k in zip(self._watched, found, strict=True))

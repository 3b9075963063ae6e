"""Supervisor inside a compiled autopilot: its decisions, and requests to the supervisor in flight.

Source: docs pages, Fly and Supervisor.
"""

from collections.abc import Sequence

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.flight.remote import RemoteVehicle
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import ENDED, FLYING, HOLD, LINK, LOST, REQUESTS, STANDBY

REQUEST_MODES = {"arm": FLYING, "hold": HOLD, "resume": FLYING, "end": ENDED, "clear": STANDBY}
"""Mode of the supervisor that each request leads to. A request for the current mode, e.g. repeated after a lost
acknowledgement, is ignored."""


class CompiledSupervisor:
    """Supervisor of a compiled autopilot. If the autopilot has no supervisor, requests to the supervisor (arm, hold,
    end …) are ignored."""

    def __init__(self, scenario: Scenario, step: CompiledBlock) -> None:
        """step: compiled autopilot of the scenario."""
        self._step = step
        declared = {m.path: m.declaration for m in step.text.outputs}
        paths = ("supervisor.mode", "supervisor.cause")
        self._codes = [(step.writes[p], d.modes) for p in paths if (d := declared.get(p)) is not None]
        self._last_codes: tuple[int, ...] = ()
        supervisor = scenario.autopilot.supervisor
        sample = "" if supervisor is None else f"samples.{supervisor.pilot}"
        fields = ("value.request", "t", "age", "fresh", "valid")
        slots = {f: step.reads[path] for f in fields if (path := f"{sample}.{f}") in step.reads}
        self._slots = slots if len(slots) == len(fields) and self._codes else None
        self._request: str | None = None

    @property
    def mode(self) -> int | None:
        """Number of the supervisor's mode, or None without a supervisor that accepts requests."""
        return None if self._slots is None else int(self._step.outputs[self._codes[0][0]])

    @property
    def cause(self) -> int | None:
        """Number of the cause of the supervisor's current mode, or None without a supervisor."""
        return int(self._step.outputs[self._codes[1][0]]) if len(self._codes) > 1 else None

    @property
    def is_asked(self) -> bool:
        """True while a request to the supervisor waits for the next control period. Each period accepts one request."""
        return self._request is not None

    def request(self, request: str) -> None:
        """Make a request to the supervisor in the next control period, unless the supervisor is already in the
        requested mode."""
        self._request = None if self.mode in (None, REQUEST_MODES[request]) else request

    def set_inputs(self, t: int) -> None:
        """Write the pending request into the inputs of the compiled autopilot, for the control period at integer time
        t."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["fresh"]] = self._request is not None
        if self._request is not None:
            inputs[at["value.request"]], inputs[at["t"]], inputs[at["valid"]] = REQUESTS.index(self._request), t, True
            self._request = None
        inputs[at["age"]] = (t - inputs[at["t"]]) * SECONDS_PER_UNIT

    def describe_changes(self) -> str:
        """Return a message with the supervisor's new decision, or an empty string if nothing has changed since the last
        call."""
        codes = tuple(int(self._step.outputs[at]) for at, _ in self._codes)
        if codes == self._last_codes:
            return ""
        self._last_codes = codes
        return "supervisor: " + ": ".join(names[k] for (_, names), k in zip(self._codes, codes, strict=True))


def explain_change(
    supervised: CompiledSupervisor, remote: RemoteVehicle, backward_sensors: Sequence[str] | None, was_armed: bool
) -> str:
    """Return an explanation of a supervisor's decision, or "". The explanation uses the state of link and vehicle,
    which the supervisor does not know.

    backward_sensors: names of sensors with decreasing time stamps, or None if no data arrive and the link is really
    lost.
    """
    if supervised.cause == LINK and supervised.mode == LOST and backward_sensors is not None:
        names = ", ".join(backward_sensors)
        why = f"time stamps of {names} run backwards" if names else "no sensor gives a sample"
        return f", but the vehicle sends data: {why}"
    if supervised.mode == FLYING and was_armed and not remote.arming.armed:
        state = "in failsafe" if remote.arming.is_in_failsafe else "not armed"
        return f", but the vehicle is {state}: commands are ignored"
    return ""

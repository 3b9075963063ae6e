"""A fault put into a virtual vehicle that is flying, by its parameters.

Source: docs page, Faults.
"""

from collections.abc import Mapping
from time import monotonic, monotonic_ns
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.core.record import leaves
from trimtab.live.vehicle import on_real_link
from trimtab.loop.fault import Fault
from trimtab.loop.faults import parsed, switchable
from trimtab.loop.scenario import Scenario
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.parameters import Parameters

PATIENCE, AGAIN, QUICK = 10.0, 0.3, 0.05
NUMBERS = ("start", "duration", "severity", "bias", "word")
"""What is sent of a fault; the word last, for then it acts."""


class Injection(NamedTuple):
    """A fault, and when it begins by the vehicle's clock (100 ns)."""

    fault: Fault
    start: int


def ready_for_faults(scenario: Scenario) -> Scenario:
    """The scenario as a virtual vehicle flies it: on a real line, with a fault in every part that does nothing yet."""
    return switchable(on_real_link(scenario))


class Plan(NamedTuple):
    """What is set for a fault. values: names of parameters, and their values, in order."""

    fault: Fault
    values: dict[str, float]


def names_for_faults(scenario: Scenario) -> dict[str, str]:
    """Path of a number of the vehicle that flies a scenario -> its name on the wire."""
    table = Parameters(ready_for_faults(scenario).world, "world").table()
    return {path: name for name, (path, _) in table.items()}


def planned(scenario: Scenario, text: str, known: Mapping[str, str] | None = None) -> Plan:
    """What to set for a fault written as text; refused where it can't be set while it flies.

    Args:
        scenario: as the vehicle was asked to fly it.
        text: see the docs page, Faults.
        known: the names as `names_for_faults` gives them, if it has been asked.
    """
    where, fault = parsed(scenario, text)
    if fault.watch:
        fix = "leave the condition out, or start the vehicle with  --fault"
        raise InputError(f"fault {text!r}", "a condition can't be set while it flies", fix=fix)
    before = f"world.{where.replace('sensor:', 'sensors.')}.fault"
    names = known or names_for_faults(scenario)
    wanted = {n: float(value) for n, value, _ in leaves(fault) if n in NUMBERS}
    return Plan(fault, {names[f"{before}.{n}"]: wanted[n] for n in NUMBERS})


class Injector:
    """Questions to a vehicle, and their answers."""

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        self.link, self.endpoint = link, endpoint

    def inject(self, plan: Plan) -> Injection:
        """Set all of a fault; its start counts from now."""
        start = self.vehicle_time() + int(plan.fault.start)
        for k, (name, value) in enumerate(plan.values.items()):
            self.set(name, value if k else float(start))
        return Injection(plan.fault, start)

    def _ask(self, what: str, packet: Any, answer: Any) -> Any:
        given_up = monotonic() + PATIENCE
        while monotonic() < given_up:
            self.link.send(packet())
            again = monotonic() + AGAIN
            while (left := again - monotonic()) > 0:
                for message in self.endpoint.feed(self.link.receive(min(left, QUICK))):
                    found = answer(message)
                    if found is not None:
                        return found
        counts = self.endpoint.counts
        problem = f"no vehicle answers ({what}); frames taken {counts.accepted}, refused {counts.refused}"
        raise InputError("--link", problem, fix="give its address, its scenario and settings, and its key")

    def vehicle_time(self) -> int:
        """The vehicle's clock now (100 ns), to half a round trip."""

        def answer(message: Any) -> int | None:
            mine = message.name == "TIMESYNC" and message.get("tc1") > 0
            return message.get("tc1") // 100 if mine else None

        return self._ask("time", lambda: self.endpoint.pack("TIMESYNC", {"ts1": monotonic_ns()}), answer)

    def set(self, name: str, value: float) -> None:
        """Set a parameter, until the vehicle has said that it holds."""
        fields = {"param_id": name, "param_value": value, "param_type": 9, "target_system": 1, "target_component": 1}

        def answer(message: Any) -> bool | None:
            if message.name != "PARAM_VALUE" or message.get("param_id") != name:
                return None
            held = message.get("param_value")
            return True if abs(held - value) <= 1e-6 * abs(value) else None

        self._ask(name, lambda: self.endpoint.pack("PARAM_SET", fields), answer)

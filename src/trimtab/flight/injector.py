"""Fault injection into a virtual vehicle in flight, by changing the vehicle's parameters over a link.

Source: docs page, Faults.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.errors import InputError, argument_name
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity, leaves
from trimtab.core.time import FOREVER, format_time
from trimtab.flight.connection_problem import key_problem
from trimtab.flight.exchange import request_answer
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import REAL_32
from trimtab.flight.station.parameters import Parameters
from trimtab.loop.fault_text import add_dormant_faults, parse_fault
from trimtab.loop.faults import Fault
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import replace_links

T = TypeVar("T")
PATIENCE, RESEND_PERIOD = 10.0, 0.3
"""Longest time (s) to wait for the vehicle's answer, and time (s) after which an unanswered request is repeated."""
FAULT_NUMBERS = ("start", "duration", "severity", "bias", "kind")
"""Names of the parameters that describe a fault, in the order in which they are sent.

`kind` is sent last, because it activates the fault.
"""


def add_idle_faults(scenario: Scenario) -> Scenario:
    """Return the scenario as a virtual vehicle runs it: a real link replaces the modelled links, and every part has an
    inactive fault."""
    return add_dormant_faults(replace_links(scenario))


class FaultPlan(NamedTuple):
    """Parameters of a vehicle to set for a fault. values: value of each parameter, by the parameter's name, in the
    order of sending."""

    fault: Fault
    values: dict[str, float]


def fault_parameter_names(scenario: Scenario) -> dict[str, str]:
    """Return the MAVLink parameter name of each parameter of a scenario's virtual vehicle, by the parameter's path."""
    table = Parameters(add_idle_faults(scenario).world, "world").table()
    return {path: name for name, (path, _) in table.items()}


def plan_fault(scenario: Scenario, text: str, names: Mapping[str, str] | None = None) -> FaultPlan:
    """Return the parameters to set for a fault given as text. Raise InputError if the fault cannot be set in flight.

    Args:
        scenario: scenario that the vehicle flies.
        text: the fault, written as on the docs page Faults.
        names: result of `fault_parameter_names`, or None to compute it here.
    """
    where, fault = parse_fault(scenario, text)
    if fault.watch:
        fix = f"leave the condition out, or start the vehicle with  {argument_name('faults')}"
        raise InputError(f"fault {text!r}", "a condition cannot be set in flight", fix=fix)
    if fault.field:
        fix = f"name the whole input ({where} …), or start the vehicle with  {argument_name('faults')}"
        raise InputError(f"fault {text!r}", "a single field of the input cannot be set in flight", fix=fix)
    before = f"world.{where.replace('sensor:', 'sensors.')}.fault"
    names = names or fault_parameter_names(scenario)
    numbers = {n: float(value) for n, value, _ in leaves(fault) if n in FAULT_NUMBERS}
    return FaultPlan(fault, {names[f"{before}.{n}"]: numbers[n] for n in FAULT_NUMBERS})


class Injector:
    """Injector of faults, which sets parameters of a vehicle over a link and waits for the confirmation of each
    parameter."""

    def __init__(self, link: Link, endpoint: Endpoint, clock: Clock = SYSTEM_CLOCK) -> None:
        self.link, self.endpoint, self._clock = link, endpoint, clock

    def inject(self, plan: FaultPlan) -> int:
        """Set all parameters of a fault, whose start time is relative to now. Return the fault's start time by the
        vehicle's clock.

        Times are in 100 ns.
        """
        start = self.read_vehicle_time() + int(plan.fault.start)
        for k, (name, value) in enumerate(plan.values.items()):
            self.set(name, value if k else float(start))
        return start

    def _request(self, what: str, packet: Callable[[], bytes], answer: Callable[[Message], T | None]) -> T:
        result = request_answer(
            self.link,
            self.endpoint,
            lambda: [packet()],
            answer,
            patience=PATIENCE,
            resend_period=RESEND_PERIOD,
            clock=self._clock,
        )
        if result is not None:
            return result
        counts = self.endpoint.counts
        if counts.wrong_signature and not counts.accepted:
            problem = key_problem(counts.wrong_signature, "").problem
            fix = f"name the vehicle's scenario, or {argument_name('key')} FILE with a copy of the vehicle's key file"
            raise InputError(argument_name("link"), problem, fix=fix)
        problem = f"no vehicle answers ({what}); received frames: {counts.accepted} accepted, {counts.refusals} refused"
        fix = (
            "start the vehicle: trimtab vehicle SCENARIO --listen URI; then use the vehicle's address, scenario, "
            "settings and key here"
        )
        raise InputError(argument_name("link"), problem, fix=fix)

    def read_vehicle_time(self) -> int:
        """Return the current time of the vehicle's clock (100 ns), with an error of at most half the round-trip
        time."""

        def answer(message: Message) -> int | None:
            mine = message.name == "TIMESYNC" and message.get("tc1") > 0
            return message.get("tc1") // 100 if mine else None

        return self._request(
            "time", lambda: self.endpoint.pack("TIMESYNC", {"ts1": self._clock.monotonic_ns()}), answer
        )

    def set(self, name: str, value: float) -> None:
        """Set a parameter of the vehicle. Repeat the request until the vehicle confirms the value."""
        to = {"target_system": 1, "target_component": 1}
        fields = {"param_id": name, "param_value": value, "param_type": REAL_32} | to

        def answer(message: Message) -> bool | None:
            if message.name != "PARAM_VALUE" or message.get("param_id") != name:
                return None
            return True if abs(message.get("param_value") - value) <= 1e-6 * abs(value) else None

        self._request(name, lambda: self.endpoint.pack("PARAM_SET", fields), answer)


def format_value(declared: Quantity, value: float) -> str:
    """Return a parameter's value as text for the user: a mode by its name, a time with its unit."""
    if declared.kind == "time":
        return "until the end" if value >= FOREVER else format_time(int(value))
    return declared.modes[int(value)] if declared.modes else f"{value:g}"

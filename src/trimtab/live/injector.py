"""A fault put into a virtual vehicle that is flying, by its parameters.

Source: docs page, Faults.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

from trimtab.core.clock import SYSTEM_CLOCK, Clock
from trimtab.core.errors import InputError, argument_name
from trimtab.core.interfaces import Link
from trimtab.core.record import Quantity, leaves
from trimtab.core.time import FOREVER, format_time
from trimtab.live.exchange import request_answer
from trimtab.loop.fault_text import add_dormant_faults, parse_fault
from trimtab.loop.faults import Fault
from trimtab.loop.scenario import Scenario
from trimtab.run.blocks import replace_links
from trimtab.wire.definitions import Message
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.parameters import Parameters
from trimtab.wire.protocol import REAL_32

T = TypeVar("T")
PATIENCE, RESEND_PERIOD = 10.0, 0.3
"""Seconds until no answer is expected any more, and until a question is sent again."""
FAULT_NUMBERS = ("start", "duration", "severity", "bias", "word")
"""What is sent of a fault; the word last, for then it acts."""


def add_idle_faults(scenario: Scenario) -> Scenario:
    """The scenario as a virtual vehicle flies it: on a real line, with a fault in every part that does nothing yet."""
    return add_dormant_faults(replace_links(scenario))


class FaultPlan(NamedTuple):
    """What is set for a fault. values: names of parameters, and their values, in order."""

    fault: Fault
    values: dict[str, float]


def fault_parameter_names(scenario: Scenario) -> dict[str, str]:
    """Path of a number of the vehicle that flies a scenario -> its name on the wire."""
    table = Parameters(add_idle_faults(scenario).world, "world").table()
    return {path: name for name, (path, _) in table.items()}


def plan_fault(scenario: Scenario, text: str, names: Mapping[str, str] | None = None) -> FaultPlan:
    """What to set for a fault written as text; refused where it can't be set while it flies.

    Args:
        scenario: as the vehicle was asked to fly it.
        text: see the docs page, Faults.
        names: as `fault_parameter_names` gives them; None: it is asked here.
    """
    where, fault = parse_fault(scenario, text)
    if fault.watch:
        fix = f"leave the condition out, or start the vehicle with  {argument_name('faults')}"
        raise InputError(f"fault {text!r}", "a condition can't be set while it flies", fix=fix)
    if fault.field:
        fix = f"name all of them ({where} …), or start the vehicle with  {argument_name('faults')}"
        raise InputError(f"fault {text!r}", "one field of the input can't be chosen while it flies", fix=fix)
    before = f"world.{where.replace('sensor:', 'sensors.')}.fault"
    names = names or fault_parameter_names(scenario)
    numbers = {n: float(value) for n, value, _ in leaves(fault) if n in FAULT_NUMBERS}
    return FaultPlan(fault, {names[f"{before}.{n}"]: numbers[n] for n in FAULT_NUMBERS})


class Injector:
    """Questions to a vehicle, and their answers."""

    def __init__(self, link: Link, endpoint: Endpoint, clock: Clock = SYSTEM_CLOCK) -> None:
        self.link, self.endpoint, self._clock = link, endpoint, clock

    def inject(self, plan: FaultPlan) -> int:
        """Set all of a fault; its start counts from now. Returns when it begins by the vehicle's clock (100 ns)."""
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
        problem = f"no vehicle answers ({what}); frames taken {counts.accepted}, refused {counts.refusals}"
        fix = "start it: trimtab vehicle SCENARIO --listen URI; then give here its address, scenario, settings and key"
        raise InputError(argument_name("link"), problem, fix=fix)

    def read_vehicle_time(self) -> int:
        """The vehicle's clock now (100 ns), to half a round trip."""

        def answer(message: Message) -> int | None:
            mine = message.name == "TIMESYNC" and message.get("tc1") > 0
            return message.get("tc1") // 100 if mine else None

        return self._request(
            "time", lambda: self.endpoint.pack("TIMESYNC", {"ts1": self._clock.monotonic_ns()}), answer
        )

    def set(self, name: str, value: float) -> None:
        """Set a parameter, until the vehicle has said that it holds."""
        to = {"target_system": 1, "target_component": 1}
        fields = {"param_id": name, "param_value": value, "param_type": REAL_32} | to

        def answer(message: Message) -> bool | None:
            if message.name != "PARAM_VALUE" or message.get("param_id") != name:
                return None
            return True if abs(message.get("param_value") - value) <= 1e-6 * abs(value) else None

        self._request(name, lambda: self.endpoint.pack("PARAM_SET", fields), answer)


def format_value(declared: Quantity, value: float) -> str:
    """A number as people read it: a mode by its name, a time with its unit."""
    if declared.kind == "time":
        return "until the end" if value >= FOREVER else format_time(int(value))
    return declared.modes[int(value)] if declared.modes else f"{value:g}"

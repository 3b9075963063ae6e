"""`trimtab inject`: a fault into a virtual vehicle that is flying."""

import json
from collections.abc import Mapping
from pathlib import Path
from time import monotonic, monotonic_ns
from typing import Any, NamedTuple

import click

from trimtab.commands.fly_scenario import Request as Asked
from trimtab.commands.fly_scenario import build
from trimtab.commands.line import INJECTOR, end_of, find_key, opened
from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.core.time import FOREVER, show

PATIENCE, AGAIN, QUICK = 10.0, 0.3, 0.05
NUMBERS = ("start", "duration", "severity", "bias", "word")
"""What is sent of a fault; the word last, for then it acts."""


class Request(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    link: str
    fault: str
    settings: Mapping[str, str] = {}
    key: Path | None = None
    unsigned: bool = False
    as_json: bool = False


def inject(request: Request) -> None:
    """Set the numbers of a fault that the vehicle has ready; refused where it doesn't answer."""
    from trimtab.loop.faults import parsed, switchable
    from trimtab.run.pilot import dialect_for
    from trimtab.run.vehicle import on_real_link
    from trimtab.wire.parameters import Parameters

    scenario = build(Asked(request.scenario, request.settings))
    where, fault = parsed(scenario, request.fault)
    if fault.watch:
        fix = "leave the condition out, or start the vehicle with  --fault"
        raise InputError(f"fault {request.fault!r}", "a condition can't be set while it flies", fix=fix)
    key = find_key(request.scenario, request.key, request.unsigned, request.link, create=False)
    ready = switchable(on_real_link(scenario))
    place = where.replace("sensor:", "sensors.")
    wanted = {f"world.{place}.fault.{n}": value for n, value, _ in leaves(fault) if n in NUMBERS}
    names = {path: name for name, (path, _) in Parameters(ready.world, "world").table().items() if path in wanted}
    with opened(request.link, listen=False) as link:
        line = _Line(link, end_of(request.link, INJECTOR, key)(dialect_for(ready)))
        try:
            now = line.vehicle_time()
            wanted[f"world.{place}.fault.start"] = now + int(fault.start)
            for number in NUMBERS:
                path = f"world.{place}.fault.{number}"
                line.set(names[path], float(wanted[path]))
        finally:
            line.endpoint.close()
    lasts = "until the end" if fault.duration == FOREVER else f"for {show(int(fault.duration))}"
    found = {"fault": request.fault, "from": show(now + int(fault.start)), "lasts": lasts}
    click.echo(json.dumps(found) if request.as_json else f"{request.fault}: from {found['from']} on, {lasts}")


class _Line:
    """Questions and answers."""

    def __init__(self, link: Any, endpoint: Any) -> None:
        self.link, self.endpoint = link, endpoint

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

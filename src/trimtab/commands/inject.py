"""`trimtab inject`: a fault into a virtual vehicle that is flying."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click

from trimtab.commands.fly_scenario import RunRequest as Asked
from trimtab.commands.fly_scenario import build_from_request
from trimtab.commands.line import INJECTOR, endpoint_factory, find_key, open_line
from trimtab.core.time import FOREVER, format_time


class InjectRequest(NamedTuple):
    """What was asked for on the command line."""

    scenario: str
    link: str
    fault: str
    settings: Mapping[str, str] = {}
    key: Path | None = None
    unsigned: bool = False
    as_json: bool = False


def inject(request: InjectRequest) -> None:
    """Set the numbers of a fault that the vehicle has ready; refused where it doesn't answer."""
    from trimtab.live.autopilot_end import scenario_dialect
    from trimtab.live.injector import Injector, plan_fault

    scenario = build_from_request(Asked(request.scenario, request.settings))
    plan = plan_fault(scenario, request.fault)
    key = find_key(request.scenario, request.key, request.unsigned, request.link, create=False)
    with open_line(request.link, listen=False) as link:
        endpoint = endpoint_factory(request.link, INJECTOR, key)(scenario_dialect(scenario))
        try:
            done = Injector(link, endpoint).inject(plan)
        finally:
            endpoint.close()
    lasts = "until the end" if plan.fault.duration == FOREVER else f"for {format_time(int(plan.fault.duration))}"
    found = {"fault": request.fault, "from": format_time(done.start), "lasts": lasts}
    click.echo(json.dumps(found) if request.as_json else f"{request.fault}: from {found['from']} on, {lasts}")

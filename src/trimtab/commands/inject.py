"""`trimtab inject`: a fault into a virtual vehicle that is flying."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click

from trimtab.commands.fly_scenario import Request as Asked
from trimtab.commands.fly_scenario import build
from trimtab.commands.line import INJECTOR, end_of, find_key, opened
from trimtab.core.time import FOREVER, show


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
    from trimtab.live.autopilot_end import dialect_for
    from trimtab.live.injector import Injector, planned

    scenario = build(Asked(request.scenario, request.settings))
    plan = planned(scenario, request.fault)
    key = find_key(request.scenario, request.key, request.unsigned, request.link, create=False)
    with opened(request.link, listen=False) as link:
        endpoint = end_of(request.link, INJECTOR, key)(dialect_for(scenario))
        try:
            done = Injector(link, endpoint).inject(plan)
        finally:
            endpoint.close()
    lasts = "until the end" if plan.fault.duration == FOREVER else f"for {show(int(plan.fault.duration))}"
    found = {"fault": request.fault, "from": show(done.start), "lasts": lasts}
    click.echo(json.dumps(found) if request.as_json else f"{request.fault}: from {found['from']} on, {lasts}")

"""`trimtab inject`: inject a fault into a simulated vehicle in flight."""

from pathlib import Path

import click

from trimtab.commands.line import INJECTOR, endpoint_factory, find_key, live_settings, open_line
from trimtab.commands.options import JSON, KEY, LINK, NAVIGATION, SCENARIO, SET, UNSIGNED
from trimtab.commands.output import print_json
from trimtab.core.time import FOREVER, format_time
from trimtab.flight.autopilot_end import scenario_dialect
from trimtab.flight.injector import Injector, plan_fault
from trimtab.scenarios.build import build


@click.command()
@SCENARIO
@click.argument("fault", metavar="FAULT")
@LINK
@SET
@NAVIGATION
@KEY
@UNSIGNED
@JSON
def command(
    scenario: str, fault: str, link: str, settings: dict[str, str], key: Path | None, unsigned: bool, as_json: bool
) -> None:
    """Inject a fault into a simulated vehicle in flight.

    FAULT has the form WHERE WORD [by NUMBER] [@ TIME] [for TIME]. The time after @ counts from now. WHERE is
    sensor:NAME, downlink, uplink or actuators. WORD is off, stuck, garbage, wrong, slow, delayed or intermittent.

    \b
    trimtab inject hovercraft/forward 'sensor:navigation off for 1 s' --link udp://127.0.0.1:14550
    trimtab inject hovercraft/forward 'actuators wrong by -2 @ 1 s for 500 ms' --link udp://127.0.0.1:14550
    """
    built = build(scenario, live_settings(scenario, ("stick",)) | settings)
    plan = plan_fault(built, fault)
    signing_key = find_key(scenario, key, unsigned, link, create=False)
    with open_line(link, listen=False) as line:
        endpoint = endpoint_factory(link, INJECTOR, signing_key)(scenario_dialect(built))
        try:
            start = format_time(Injector(line, endpoint).inject(plan))
        finally:
            endpoint.close()
    lasts = "until the end" if plan.fault.duration == FOREVER else f"for {format_time(int(plan.fault.duration))}"
    if as_json:
        print_json({"fault": fault, "from": start, "lasts": lasts})
    else:
        click.echo(f"{fault}: from {start} on, {lasts}")

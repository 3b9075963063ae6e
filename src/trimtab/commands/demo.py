"""`trimtab demo`: the first flight."""

import sys
from pathlib import Path

import click

from trimtab.commands import run
from trimtab.commands.options import JSON, OUT, SEED

SCENARIO = "hovercraft/pose"
LOOK_AT = """\
look at {picture}, at its right: the way over the floor, from above.
  The ideal craft has neither delay nor errors of navigation nor limits; the real
  one is flown over Bluetooth as it was measured. Both come to the wanted place
  and heading, the real one later: that is what the imperfections cost.
what each costs:  trimtab budget {scenario}
other scenarios:  trimtab list"""


@click.command()
@SEED
@OUT("DIR", "Write the picture in this folder.  [default: here]")
@JSON
@click.pass_context
def command(context: click.Context, seed: int, out: Path | None, as_json: bool) -> None:
    """Fly the hovercraft to a place over its radio, ideal beside real.

    The source's craft with its measured Bluetooth latencies; writes trimtab-demo.png, and says what to look at there.
    """
    picture = (out or Path()) / "trimtab-demo.png"
    settings = {"links": "measured"}
    try:
        context.invoke(run.command, scenario=SCENARIO, settings=settings, seed=seed, plot=picture, as_json=as_json)
    finally:
        if not as_json and picture.is_file() and sys.exc_info()[0] is SystemExit:  # flown, and not refused
            click.echo(LOOK_AT.format(picture=picture, scenario=SCENARIO))

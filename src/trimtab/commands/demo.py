"""`trimtab demo`: a first flight for new users."""

import sys
from pathlib import Path

import click

from trimtab.commands import run
from trimtab.commands.options import JSON, OUT, SEED

SCENARIO = "hovercraft/pose"
LOOK_AT = """\
open {picture}. The right side shows the path over the floor, from above.
  The ideal craft has no delay, no navigation errors and no limits. The real
  craft is flown over Bluetooth with measured latencies. Both reach the target
  position and heading, but the real craft later, because of its imperfections.
cost of each imperfection:  trimtab budget {scenario}
other scenarios:            trimtab list"""


@click.command()
@SEED
@OUT("DIR", "Write the picture to this folder.  [default: here]")
@JSON
@click.pass_context
def command(context: click.Context, seed: int, out: Path | None, as_json: bool) -> None:
    """Fly the hovercraft to a position, ideal and real.

    Uses the craft of the thesis with its measured Bluetooth latencies. Writes trimtab-demo.png and explains this
    picture.
    """
    picture = (out or Path()) / "trimtab-demo.png"
    settings = {"links": "measured"}
    try:
        context.invoke(run.command, scenario=SCENARIO, settings=settings, seed=seed, plot=picture, as_json=as_json)
    finally:
        if (
            not as_json and picture.is_file() and sys.exc_info()[0] is SystemExit
        ):  # print the explanation only if the flight ran without an input error
            click.echo(LOOK_AT.format(picture=picture, scenario=SCENARIO))

"""`trimtab demo`: the first flight."""

from pathlib import Path

import click

from trimtab.commands import run
from trimtab.commands.options import FILE, SEED


@click.command()
@SEED
@click.option("--out", type=FILE, default=Path(), help="Folder for the picture.  [default: here]")
@click.pass_context
def command(context: click.Context, seed: int, out: Path) -> None:
    """Bring the hovercraft to rest over its radio, ideal beside real.

    Zero velocity with the source's settings and its measured Bluetooth latencies; writes trimtab-demo.png.
    """
    picture = out / "trimtab-demo.png"
    context.invoke(
        run.command, scenario="hovercraft/zero-velocity", settings={"links": "measured"}, seed=seed, plot=picture
    )
    click.echo("next: trimtab list, trimtab run --help")

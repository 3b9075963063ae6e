"""The verbs that fly thousands of runs."""

import sys
from pathlib import Path
from typing import Any

import click

from trimtab.commands.live_cli import FAULT, FILE, JSON, SCENARIO, SEED, SET
from trimtab.core.errors import InputError


def parse_spreads(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=distribution texts as a mapping."""
    found: dict[str, str] = {}
    for text in values:
        path, equals, written = text.partition("=")
        if not equals or not path.strip():
            fix = "--spread 'world.vehicle.mass=normal(100%, 5%)'; trimtab list SCENARIO shows every path"
            raise InputError("--spread", f"{text!r} is not PATH=DISTRIBUTION", fix=fix)
        if path.strip() in found:
            raise InputError(f"--spread {path.strip()}", "is named twice", fix="keep one of them")
        found[path.strip()] = written
    return found


SPREAD = click.option(
    "--spread",
    multiple=True,
    callback=parse_spreads,
    metavar="PATH=DISTRIBUTION",
    help="E.g. 'world.vehicle.mass=normal(100%, 5%)'; repeatable.",
)
SUCCESS = click.option(
    "--success", multiple=True, metavar="TEXT", help="E.g. 'settling:yaw_rate <= 10'; repeatable, all must hold."
)
WITHOUT = click.option("--without", multiple=True, metavar="FAULT", help="Switch one imperfection off; repeatable.")


@click.command()
@SCENARIO
@click.option("--runs", type=click.IntRange(1), default=1000, show_default=True, help="How many worlds.")
@SPREAD
@click.option("--correlate", multiple=True, metavar="PATH,PATH=RHO", help="Let two hang together; repeatable.")
@click.option("--metric", "metrics", multiple=True, metavar="KIND:SIGNAL", help="What is kept of each run; repeatable.")
@SUCCESS
@click.option("--require", multiple=True, metavar="TEXT", help="E.g. 'success >= 0.99 @ 95%'; else exit code 1.")
@click.option("--stop", metavar="TEXT", help="Stop early, e.g. at 'width(success) <= 0.01 @ 95%'.")
@click.option(
    "--sampling", default="random", show_default=True, help="random, sobol, latin; saltelli or morris for what matters."
)
@click.option("--store", type=FILE, metavar="DIR", help="Zarr store; started again, only what is missing flies.")
@click.option("--rerun", type=click.IntRange(0), metavar="RUN", help="One run once more, held against its row.")
@SET
@WITHOUT
@FAULT
@SEED
@click.option("--device", type=click.Choice(("auto", "cpu", "gpu")), default="auto", show_default=True)
@click.option("--threads", type=click.IntRange(1), metavar="N", help="[default: as many as cores]")
@click.option("--cluster", metavar="URI", help="Fly on the workers of a scheduler, tls://HOST:8786.")
@click.option("--tls-ca", type=FILE, metavar="FILE", help="Certificate of who signed the others'.")
@click.option("--tls-cert", type=FILE, metavar="FILE", help="Own certificate.")
@click.option("--tls-key", type=FILE, metavar="FILE", help="Own key.")
@click.option("--out", type=FILE, metavar="DIR", help="Folder for pictures and table (Parquet).")
@JSON
def campaign(as_json: bool, tls_ca: Path | None, tls_cert: Path | None, tls_key: Path | None, **asked: Any) -> None:
    """Fly a scenario in thousands of worlds, and say how often it succeeds, with bounds.

    A run's numbers depend on the seed and on its own number alone. Distributions: normal(MEAN, STD), truncated(MEAN,
    STD, LOW, HIGH), lognormal(MEDIAN, STD_OF_LOG), uniform(LOW, HIGH), loguniform(LOW, HIGH), choice(A, B, …),
    file(NAME.csv:COLUMN); a number with % is a share of the scenario's own value. Metrics: settling, first_reach,
    overshoot, error_rms of what has a target; final, least, most, peak, mean, rms, tail_mean, tail_rms of any signal.

    \b
    trimtab campaign hovercraft/zero-velocity --spread 'world.vehicle.mass=normal(100%, 5%)' --store mass.zarr
    trimtab campaign hovercraft/zero-velocity --spread 'world.vehicle.mass=normal(100%, 5%)' --store mass.zarr \\
        --rerun 12 --out run-12
    trimtab campaign hovercraft/zero-velocity --sampling saltelli --runs 4096 --out matters \\
        --spread 'world.vehicle.mass=normal(100%, 5%)' --spread 'autopilot.law.k2=uniform(80%, 120%)'
    trimtab campaign hovercraft/spin --runs 4000 --require 'success >= 0.99 @ 95%' --out spin
    """
    from trimtab.commands.campaign import CampaignRequest
    from trimtab.commands.campaign import campaign as carry_out

    if not carry_out(CampaignRequest(**asked, tls=(tls_ca, tls_cert, tls_key), as_json=as_json)):
        sys.exit(1)


@click.command(name="map")
@SCENARIO
@click.option("--x", required=True, metavar="AXIS=LOW:HIGH[:N]", help="E.g. delay=0:0.6, or any PATH=LOW:HIGH.")
@click.option("--y", required=True, metavar="AXIS=LOW:HIGH[:N]", help="E.g. jitter=0:0.3.")
@SUCCESS
@SET
@WITHOUT
@click.option("--runs", type=click.IntRange(1), default=8, show_default=True, help="Worlds at each point.")
@click.option("--depth", type=click.IntRange(0, 8), default=4, show_default=True, help="How often cells are halved.")
@click.option("--threshold", type=click.FloatRange(0, 1), default=0.5, show_default=True, help="Share at the boundary.")
@SEED
@click.option("--theory/--no-theory", default=True, show_default=True, help="Draw the linear theory where it applies.")
@click.option("--plot", type=FILE, metavar="FILE", help="Picture of the map.")
@JSON
def stability_map(as_json: bool, **asked: Any) -> None:
    """Say where in the plane of two parameters a scenario succeeds.

    A coarse grid is flown, then only the cells through which the boundary passes are halved. Axes: delay, jitter, loss
    of the link, or any parameter by its path. Without --success every target must be inside its band for the last
    third.

    \b
    trimtab map hovercraft/zero-velocity --x delay=0:0.6 --y loss=0:0.9 --success 'error_rms:yaw_rate <= 0.6'
    trimtab map hovercraft/zero-velocity --x world.vehicle.mass=1:5 --y autopilot.law.k2=50%:400% \\
        --success 'error_rms:yaw_rate <= 0.4'
    trimtab map hypersonic/noise --x world.vehicle.modes.w1=70%:130%:7 --y world.vehicle.modes.zeta1=0.001:0.021:5 \\
        --set duration=60 --success 'tail_rms:law.h_error <= 1'
    trimtab map hovercraft/forward --x delay=0:0.4 --y jitter=0:0.4 --without navigation-error \\
        --set initial.sway_velocity=0.05 --set initial.yaw_rate=0.15 --set duration=30
    """
    from trimtab.commands.stability_map import MapRequest
    from trimtab.commands.stability_map import stability_map as carry_out

    carry_out(MapRequest(**asked, as_json=as_json))


@click.command()
@SCENARIO
@SPREAD
@SUCCESS
@click.option("--runs", type=click.IntRange(1), default=5000, show_default=True, help="How many may fly.")
@click.option(
    "--words", type=click.IntRange(1), default=4, show_default=True, help="Random numbers each point flies with."
)
@click.option("--over", type=click.Choice(("worst", "mean")), default="worst", show_default=True, help="Of these.")
@click.option("--until-first", is_flag=True, help="End with the first failure.")
@SET
@WITHOUT
@FAULT
@SEED
@click.option("--threads", type=click.IntRange(1), metavar="N", help="[default: as many as cores]")
@click.option("--out", type=FILE, metavar="FILE", help="Scenario file that flies the worst run again, e.g. worst.py.")
@click.option("--plot", type=FILE, metavar="FILE", help="Picture of the search.")
@JSON
def falsify(as_json: bool, **asked: Any) -> None:
    """Search for the worst world inside given bounds, instead of waiting for it.

    The bounds are those of the distributions. Exit code 1 when a failure was found, 0 when none was: none found is no
    proof that there is none.

    \b
    trimtab falsify hovercraft/zero-velocity --spread 'world.vehicle.mass=uniform(80%, 120%)' \\
        --spread 'autopilot.law.k2=uniform(50%, 200%)' --success 'error_rms:yaw_rate <= 0.5' --out worst.py
    trimtab run worst.py:scenario --seed 0 --run 133
    """
    from trimtab.commands.falsify import FalsifyRequest
    from trimtab.commands.falsify import falsify as carry_out

    if not carry_out(FalsifyRequest(**asked, as_json=as_json)):
        sys.exit(1)


def parse_gains(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """path=low:high texts as a mapping."""
    found = {}
    for text in values:
        path, equals, span = text.partition("=")
        if not equals or not path.strip():
            raise InputError("--gain", f"{text!r} is not PATH=LOW:HIGH", fix="--gain autopilot.law.k1=0.5:3")
        found[path.strip()] = span
    return found


@click.command()
@SCENARIO
@click.option("--gain", "gains", multiple=True, required=True, callback=parse_gains, metavar="PATH=LOW:HIGH")
@click.option("--cost", default="error_rms:yaw_rate", show_default=True, help="Metric whose mean is made small.")
@click.option("--method", type=click.Choice(("search", "gradient")), default="search", show_default=True)
@click.option("--runs", type=click.IntRange(2), default=64, show_default=True, help="Worlds to tune on.")
@click.option("--held-out", type=click.IntRange(2), default=256, show_default=True, help="Worlds to judge on.")
@click.option("--iterations", type=click.IntRange(1), default=30, show_default=True)
@click.option("--width", type=float, default=0.05, show_default=True, help="Of the smoothing, as a share of a range.")
@SPREAD
@SET
@WITHOUT
@FAULT
@SEED
@click.option("--threads", type=click.IntRange(1), metavar="N", help="[default: as many as cores]")
@click.option("--out", type=FILE, metavar="FILE", help="Scenario file with the gains, e.g. tuned.py.")
@click.option("--plot", type=FILE, metavar="FILE", help="Picture of how it went.")
@JSON
def tune(as_json: bool, **asked: Any) -> None:
    """Tune gains over many worlds, and say what they are worth in worlds that the tuning did not see.

    Exit code 1 where it can't be said that they help there; nothing is written then.

    \b
    trimtab tune hovercraft/zero-velocity --gain autopilot.law.k1=0.5:3 --gain autopilot.law.k2=1:5 --out tuned.py
    trimtab run tuned.py:scenario
    trimtab tune hovercraft/zero-velocity --gain autopilot.law.k2=1:5 --method gradient
    """
    from trimtab.commands.tune import TuneRequest
    from trimtab.commands.tune import tune as carry_out

    if not carry_out(TuneRequest(**asked, as_json=as_json)):
        sys.exit(1)

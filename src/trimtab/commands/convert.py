"""`trimtab convert`: convert a log for other viewers."""

from pathlib import Path

import click

from trimtab.commands.foreign_logs import read_own_log
from trimtab.commands.options import FILE, JSON, OUT
from trimtab.commands.output import check_folder, check_out, print_files, print_json, quote
from trimtab.commands.progress import show_spinner
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError
from trimtab.core.time import parse_time
from trimtab.logs.messages import EPOCH

ENDING = ".rrd"
"""File name suffix of Rerun recordings."""


@click.command()
@click.argument("file", type=FILE, metavar="LOG")
@click.option("--as", "kind", type=click.Choice(["ros2", "rerun"]), required=True, help="Format to write.")
@OUT("PATH", "Write a ROS 2 bag to this new folder, or a Rerun recording to this .rrd file.", required=True)
@click.option(
    "--scenario", metavar="SCENARIO", help="Scenario of the log, e.g. my_boat.py:scenario, if not in the catalogue."
)
@click.option("--period", metavar="TIME", default="10 ms", show_default=True, help="Period of the written poses.")
@JSON
def command(file: Path, kind: str, out: Path, scenario: str | None, period: str, as_json: bool) -> None:
    """Convert a flight to a ROS 2 bag or a Rerun recording.

    A bag holds Odometry, Imu and tf. A bag uses the axes of ROS: world axes east, north, up; body axes forward,
    left, up. Foxglove opens bags and trimtab's logs.

    \b
    trimtab convert flight/run.mcap --as ros2 --out bag          and then:  ros2 bag play bag
    trimtab convert flight/run.mcap --as rerun --out flight.rrd  and then:  rerun flight.rrd
    """
    from trimtab.logs.rerun_file import import_rerun, write_rerun
    from trimtab.logs.ros2_bag import write_ros2_bag
    from trimtab.run.log_motion import read_imus, read_motion
    from trimtab.scenarios.recorded import rebuild_scenario

    apart = parse_time(period)
    if apart <= 0:
        raise InputError("--period", f"must be above 0, got {period!r}", fix="--period '10 ms'")
    if kind == "ros2":
        if out.exists():
            raise InputError("--out", f"{str(out)!r} already exists", fix="name a new folder; a bag cannot be extended")
        check_folder("--out", out.parent)
    else:
        if out.suffix != ENDING:
            raise InputError(
                "--out",
                f"{str(out)!r} is not a Rerun file; the name must end in .rrd",
                fix=f"--out {quote(out.with_suffix(ENDING))}",
            )
        check_out("--out", out, f"flight{ENDING}")
        import_rerun()
    log = read_own_log(file)
    flown = rebuild_scenario(log, scenario)
    enable_cache()
    with show_spinner(f"converting {file.name}"):
        motion, imus = read_motion(log, flown, apart), read_imus(log)
        if kind == "ros2":
            counts = write_ros2_bag(out, motion, imus, int(log.metadata.get(EPOCH, 0)))
            files = sorted(out.iterdir())
        else:
            out.parent.mkdir(parents=True, exist_ok=True)
            counts, files = write_rerun(out, log, motion), [out]
    if as_json:
        print_json({"log": str(file), "to": kind, "messages": counts}, files)
        return
    for topic, count in counts.items():
        click.echo(f"{topic}: {count}")
    print_files(files)

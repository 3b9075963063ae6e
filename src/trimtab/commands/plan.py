"""`trimtab plan`: plan a feasible path between obstacles, as a table for `--reference`."""

from pathlib import Path

import click

from trimtab.commands.options import FILE, JSON, OUT, PLOT, FiniteRange
from trimtab.commands.output import check_out, check_picture, draw_plot, print_files, print_json, quote, write_text
from trimtab.commands.progress import show_spinner
from trimtab.core.cache_folder import enable_cache
from trimtab.core.errors import InputError


@click.command()
@click.argument("floor", type=FILE, metavar="FLOOR.toml")
@OUT("FILE.csv", "Write the path to this file, as a table of time, north, east and heading.")
@PLOT("Draw obstacles, planned path and flight to this picture.")
@click.option("--speed", type=FiniteRange(0.05, 1.0), default=0.5, show_default=True, help="Maximum speed, m/s.")
@JSON
def command(floor: Path, out: Path | None, plot: Path | None, speed: float, as_json: bool) -> None:
    """Plan a path between obstacles within the craft's limits.

    If no path is found, the command prints the reason.

    The file contains the size of the floor, obstacles (circles and polygons), the width of the craft, start and goal. A
    path is searched and smoothed. The plan is the flight of the hovercraft's model along this path, within the limits
    of fan and rudder.

    \b
    trimtab plan examples/hall.toml --out plan.csv --plot plan.png
    trimtab run hovercraft/track --reference plan.csv --set law=horizon
    """
    check_picture(plot, None)
    if out is not None:
        check_out("--out", out, "plan.csv")
        if out.suffix != ".csv":
            problem = f"{str(out)!r} does not end in .csv, so --reference would not read it"
            raise InputError("--out", problem, fix=f"--out {out.with_suffix('.csv')}")
    from trimtab.design.obstacles import read_task  # JAX is imported below, after the input is checked
    from trimtab.design.route import Tempo

    task = read_task(floor)
    enable_cache()
    from trimtab.run.planner import plan_path

    with show_spinner("planning"):
        plan = plan_path(task, Tempo(speed=speed), str(floor))
    files = []
    if out is not None:
        files.append(write_text(out, plan.table()))
    if plot is not None:
        from trimtab.plots.planned_path import plot_planned_path

        files += draw_plot(plot, plot_planned_path, task, plan, title=floor.stem)
    flown = plan.flown
    result = {
        "duration_s": float(plan.times[-1]),
        "length_m": plan.length,
        "clearance_m": plan.clearance,
        "arrival_m": plan.arrival[0],
        "arrival_speed_m_s": plan.arrival[1],
        "speed_m_s": plan.tempo.speed,
        "thrust_N": [float(flown["thrust"].min()), float(flown["thrust"].max())],
        "force_angle_rad": float(abs(flown["force_angle"]).max()),
    }
    if as_json:
        print_json(result, files)
        return
    low, high = result["thrust_N"]
    click.echo(f"{floor}: {result['length_m']:.1f} m in {result['duration_s']:.1f} s, at most {plan.tempo.speed:g} m/s")
    click.echo(
        f"  clearance              {result['clearance_m']:.2f} m between obstacles and craft at the closest point"
    )
    click.echo(f"  arrival                {plan.arrival[0]:.2f} m from the goal, at {plan.arrival[1]:.2f} m/s")
    click.echo(f"  thrust                 {low:.2f} … {high:.2f} N, allowed {-plan.law.pull:g} … {plan.law.push:g} N")
    click.echo(
        f"  force angle            {result['force_angle_rad']:.2f} rad at most, allowed {plan.law.deflection:g} rad"
    )
    print_files(files)
    if out is not None:
        click.echo(f"fly it:  trimtab run hovercraft/track --reference {quote(out)} --set law=horizon")

"""`trimtab plot`: plot a log, or some signals of the log."""

from pathlib import Path

import click

from trimtab.commands.foreign_logs import read_any_log
from trimtab.commands.options import ANIMATE, FILE, JSON, PLOT
from trimtab.commands.output import check_animation, check_picture, draw_plot, print_files, print_json, quote
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.core.time import parse_time, to_seconds


@click.command()
@click.argument("file", type=FILE, metavar="LOG")
@click.argument("signals", nargs=-1, metavar="[PATH…]")
@PLOT("Draw the signals to this picture (.png, .svg or .pdf).  [default: the log's name with .png]")
@ANIMATE
@click.option("--since", metavar="TIME", help="Start time of the plot, e.g. '2 s'.")
@click.option("--until", metavar="TIME", help="End time of the plot.")
@JSON
def command(
    file: Path,
    signals: tuple[str, ...],
    plot: Path | None,
    animate: Path | None,
    since: str | None,
    until: str | None,
    as_json: bool,
) -> None:
    """Plot signals of a log, one panel for each path. Without paths, plot the main signals as `trimtab run` does.

    In a path, * stands for any characters. Without --plot the picture is written to the folder of the log.

    \b
    trimtab plot flight/run.mcap
    trimtab plot flight/run.mcap truth.yaw_rate law.mode 'actuators.*' --plot turn.svg
    trimtab plot flight/run.mcap truth.heading --since '2 s' --until '4 s'
    trimtab plot flight/run.mcap --animate turn.gif
    """
    from trimtab.plots.run import plot_run
    from trimtab.plots.signals import plot_signals, select_paths

    picture = plot or (file.with_suffix(".png") if animate is None else None)
    check_picture(picture, None)
    check_animation(animate)
    log = read_any_log(file, None, quiet=as_json)
    if since is not None or until is not None:
        ends = [None if text is None else float(to_seconds(parse_time(text))) for text in (since, until)]
        log = log.between(ends[0] or 0.0, float("inf") if ends[1] is None else ends[1])
    if not len(log):
        fix = "leave --since and --until out"
        raise InputError(f"log file '{file}'", "the log has no row in this interval", fix=fix)
    name = str(log.metadata.get("scenario", file.name))
    if signals:
        paths = select_paths(log, signals)
        files = draw_plot(picture, lambda path: plot_signals({file.name: log}, paths, path, title=name))
    else:
        paths, files = list(log.paths), draw_plot(picture, lambda path: plot_run(log, None, path, title=name))
    if animate is not None:
        from trimtab.plots.animation import animate_run

        files += draw_plot(animate, animate_run, log, title=name)
    if as_json:
        print_json({"log": str(file), "signals": paths, "rows": len(log)}, files)
        return
    print_files(files)
    if not signals:
        click.echo(f"{len(paths)} signals; to plot some of them: trimtab plot {quote(file)} {show_controls(paths[0])}")

"""The command line: each verb is one function of the package.

Exit code 0: done and good; 1: done and failed; 2: refused input.
"""

import sys
from pathlib import Path
from typing import Any

import click

from trimtab import __version__
from trimtab.commands import campaign_cli, live_cli
from trimtab.commands.live_cli import FAULT, JSON, SCENARIO, parse_pairs
from trimtab.core.errors import InputError
from trimtab.scenarios import catalogue

NAVIGATION = click.option(
    "--navigation",
    metavar="KIND",
    help="What it finds its way with, e.g. ins; `trimtab list SCENARIO` has the choices.",
)


class Verbs(click.Group):
    """The verbs; input that is refused ends with the fix on standard error and exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            click.echo(f"error: {error}", err=True)
            ctx.exit(2)


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="trimtab")
def main() -> None:
    """Guidance, navigation and control of vehicles that are hard to steer.

    \b
    trimtab demo                                     the first flight: a table and a picture
    trimtab list                                     every scenario
    trimtab list hovercraft/spin                     every setting of one, with unit and meaning
    trimtab run hovercraft/spin --plot spin.png      fly it, ideal beside real
    trimtab run hovercraft/spin --set world.vehicle.mass=3.2 --without navigation-error
    trimtab run hovercraft/forward --navigation ins  flown on IMU and ultrasonic network, not on an error model
    trimtab budget hovercraft/forward                what each imperfection costs
    trimtab campaign hovercraft/spin --runs 4000     how often it succeeds, with bounds
    trimtab falsify hovercraft/zero-velocity --spread 'world.vehicle.mass=uniform(80%, 120%)'
    trimtab tune hovercraft/zero-velocity --gain autopilot.law.k1=0.5:3 --gain autopilot.law.k2=1:5
    trimtab map hovercraft/zero-velocity --x delay=0:0.6 --y loss=0:0.9 --success 'error_rms:yaw_rate <= 0.6'
    trimtab reproduce hovercraft2006                 a publication computed again, with verdicts
    trimtab calibrate noise still/run.mcap           noise of a sensor at rest, and a filter's Q and R
    trimtab design hypersonic --out gain.json        a gain, and a certificate that proves it
    trimtab vehicle hovercraft/forward --listen udp://:14550           a vehicle behind a real line
    trimtab fly hovercraft/forward --link udp://127.0.0.1:14550        and its autopilot in real time
    trimtab replay here/flight.mcap                  a log's frames once more: the same to the bit
    """


@main.command()
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random numbers.")
@click.option("--out", type=click.Path(path_type=Path), default=Path(), help="Folder for the picture.  [default: here]")
def demo(seed: int, out: Path) -> None:
    """Bring the hovercraft to rest over its radio, ideal beside real.

    Zero velocity with the source's settings and its measured Bluetooth latencies; writes trimtab-demo.png.
    """
    from trimtab.commands.fly_scenario import RunRequest, fly_scenario

    fly_scenario(
        RunRequest(
            scenario="hovercraft/zero-velocity",
            settings={"links": "measured"},
            seed=seed,
            plot=out / "trimtab-demo.png",
        )
    )
    click.echo("next: trimtab list, trimtab run --help")


@main.command(name="list")
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@JSON
def list_(scenario: str | None, as_json: bool) -> None:
    """List the scenarios, or every setting of one.

    \b
    trimtab list
    trimtab list hovercraft/zero-velocity
    """
    if scenario is None:
        from trimtab.commands.tables import print_scenarios

        print_scenarios(catalogue.scenario_names(), as_json)
        return
    from trimtab.commands.tables import print_settings

    built, _ = catalogue.load_scenario(scenario)
    print_settings(scenario, built, catalogue.scenario_choices(scenario), as_json)


@main.command()
@SCENARIO
@click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", callback=parse_pairs, help="Change a setting; repeatable."
)
@NAVIGATION
@click.option("--without", multiple=True, metavar="FAULT", help="Switch one imperfection off; repeatable.")
@FAULT
@click.option("--seed", type=int, default=0, show_default=True, help="Of the random numbers.")
@click.option("--run", "number", type=int, default=0, show_default=True, help="Number of a run within a campaign.")
@click.option("--duration", metavar="TIME", help="E.g. 20, '20 s', '500 ms'.  [default: the scenario's]")
@click.option("--ideal/--no-ideal", default=True, show_default=True, help="Fly the ideal twin beside it.")
@click.option(
    "--backend", type=click.Choice(("auto", "c", "jax")), default="auto", show_default=True, help="What flies it."
)
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help="Picture of all signals.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for log (MCAP) and picture.")
@click.option("--log-period", metavar="TIME", default="1 ms", show_default=True, help="Between two rows of the log.")
@JSON
def run(
    scenario: str,
    settings: dict[str, str],
    navigation: str | None,
    without: tuple[str, ...],
    faults: tuple[str, ...],
    seed: int,
    number: int,
    duration: str | None,
    ideal: bool,
    backend: str,
    plot: Path | None,
    out: Path | None,
    log_period: str,
    as_json: bool,
) -> None:
    """Fly a scenario in virtual time, ideal beside real.

    SCENARIO is a name from `trimtab list`, or your own: my_boat.py:scenario.

    \b
    trimtab run hovercraft/zero-velocity --plot rest.png
    trimtab run hovercraft/heading-bang-bang --set initial=rest --seed 3
    trimtab run hovercraft/forward --without navigation-error --out forward/
    trimtab run hovercraft/spin --set autopilot.law.spinning.k2=5 --duration '30 s' --json
    trimtab run hovercraft/zero-velocity --navigation ins --plot ins.png
    trimtab run hovercraft/forward --fault 'uplink off @ 5 s for 2 s' --plot cut.png
    """
    from trimtab.commands.fly_scenario import RunRequest, fly_scenario
    from trimtab.core.time import parse_time

    if duration is not None:
        settings["duration"] = duration
    if navigation is not None:
        settings["navigation"] = navigation
    rows = parse_time(log_period)
    fly_scenario(
        RunRequest(scenario, settings, without, seed, ideal, plot, out, as_json, backend, faults, rows, number)
    )


@main.command()
@SCENARIO
@click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE", callback=parse_pairs, help="Change a setting; repeatable."
)
@NAVIGATION
@click.option("--without", multiple=True, metavar="FAULT", help="Leave one imperfection out of it all; repeatable.")
@click.option("--only", multiple=True, metavar="FAULT", help="Only what this one costs; repeatable.  [default: every]")
@click.option("--runs", type=click.IntRange(1), default=20, show_default=True, help="Flights in each set.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the first flight.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help="Picture of the costs.")
@JSON
def budget(navigation: str | None, as_json: bool, **asked: Any) -> None:
    """Say what each imperfection of a scenario costs.

    The same flights with all imperfections, without each, with each alone, and with none: how far the vehicle is from
    its targets in the second half, and how far its navigation from the truth.
    With --navigation ins there are two dozen imperfections: some minutes the first time; --only takes a few of them.

    \b
    trimtab budget hovercraft/forward
    trimtab budget hovercraft/zero-velocity --navigation ins --runs 40 --plot budget.png
    trimtab budget hovercraft/spin --only navigation-error --only uplink-delay --json
    """
    from trimtab.commands.budget import BudgetRequest
    from trimtab.commands.budget import budget as carry_out

    if navigation is not None:
        asked["settings"]["navigation"] = navigation
    carry_out(BudgetRequest(**asked, as_json=as_json))


@main.command()
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@click.option("--target", type=click.Choice(("c", "cortex-m4", "cortex-m7")), default="c", show_default=True)
@click.option(
    "--float",
    "real",
    type=click.Choice(("double", "single")),
    help="Precision.  [default: single on cortex-m4]",
)
@click.option("--part", type=click.Choice(("autopilot", "loop")), default="autopilot", show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for the C, its test and its vectors."
)
@click.option("--steps", type=click.IntRange(1), default=2000, show_default=True, help="Simulated steps to test with.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the simulated steps.")
@click.option("--run", "fly", is_flag=True, help="Fly it on the emulated board of --target.")
@click.option("--verify", "check", type=click.Path(path_type=Path), metavar="DIR", help="Check an exported folder.")
@click.option("--set", "settings", multiple=True, metavar="PATH=VALUE", callback=parse_pairs, help="Change a setting.")
@click.option("--without", multiple=True, metavar="FAULT", help="Switch one imperfection off; repeatable.")
@JSON
def export(as_json: bool, **asked: Any) -> None:
    """Write a scenario's autopilot as C for a microcontroller, and prove that it computes the same.

    \b
    trimtab export hovercraft/zero-velocity --out autopilot
    trimtab export --verify autopilot
    trimtab export hovercraft/heading-bang-bang --float single --out flash/
    trimtab export hovercraft/zero-velocity --target cortex-m7 --run
    trimtab export hovercraft/spin --part loop --out whole-loop
    """
    from trimtab.commands.export import ExportRequest
    from trimtab.commands.export import export as carry_out

    if not carry_out(ExportRequest(**asked, as_json=as_json)):
        sys.exit(1)


@main.command()
@click.argument("study", metavar="[STUDY]", required=False)
@click.option("--only", multiple=True, metavar="GROUP", help="Only this group of figures; repeatable.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for the study's pictures.")
@JSON
def reproduce(study: str | None, only: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """Compute a publication's figures again: printed beside computed, with the verdict.

    Exit code 1 when a figure that should be reproduced is not. Without STUDY the studies and their groups are listed.

    \b
    trimtab reproduce
    trimtab reproduce hovercraft2006
    trimtab reproduce hovercraft2006 --only inertia --json
    trimtab reproduce hovercraft2006 --out figures/
    """
    from trimtab.commands.reproduce import ReproduceRequest
    from trimtab.commands.reproduce import reproduce as carry_out

    if not carry_out(ReproduceRequest(study, only, out, as_json)):
        sys.exit(1)


@main.command()
@click.argument("system", metavar="[SYSTEM]", required=False)
@click.option("--method", type=click.Choice(("lqr", "lmi")), help="Riccati equation, or a solver.  [default: lqr]")
@click.option("--filter", "filter_", metavar="KIND", help="Filter of the unmeasured states.  [default: tuned]")
@click.option("--integral", is_flag=True, help="With integral action.")
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="Write the certificate (JSON).")
@click.option("--check", type=click.Path(path_type=Path), metavar="FILE", help="Prove a certificate again.")
@JSON
def design(as_json: bool, **asked: Any) -> None:
    """Design a feedback gain, with a certificate that proves it; or prove a certificate again.

    A certificate holds the linear model, gain, Lyapunov matrices and filter. --check proves it from these alone, in
    exact arithmetic and without the solver that found them; exit code 1 where a condition fails, with the number that
    broke it. With SYSTEM beside --check, the model in it is also compared with that of the system as it is now.

    \b
    trimtab design hypersonic                        gain, poles and every condition
    trimtab design hypersonic --out gain.json
    trimtab design --check gain.json
    trimtab design hypersonic --check gain.json
    trimtab design hypersonic --method lmi --filter printed --json
    """
    from trimtab.commands.design import DesignRequest
    from trimtab.commands.design import design as carry_out

    if not carry_out(DesignRequest(**asked, as_json=as_json)):
        sys.exit(1)


@main.group()
def calibrate() -> None:
    """From measured data to parameters.

    \b
    trimtab calibrate noise still/run.mcap           noise of a sensor at rest, and a filter's Q and R
    """


@calibrate.command(name="noise")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--signal", "signals", multiple=True, metavar="PATH", help="Only this signal; repeatable.")
@click.option(
    "--shortest", metavar="TIME", help="Leave shorter averages out, e.g. of a sensor that filters its output."
)
@click.option("--tick", metavar="TIME", help="Step of the filter.  [default: that of the sensor]")
@click.option("--time", metavar="NAME", help="Column of times (s) of a CSV file.  [default: t, time, …]")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help="Picture of the Allan deviations.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for figures (JSON) and picture.")
@JSON
def noise(as_json: bool, **asked: Any) -> None:
    """Noise coefficients of a sensor at rest: white, flicker and walk, with intervals, and a filter's Q and R.

    LOG is an MCAP file of `trimtab run … --out`, or a CSV file with a column of times.

    \b
    trimtab run navigation/still --out still
    trimtab calibrate noise still/run.mcap --plot allan.png
    trimtab calibrate noise bench.csv --signal gyro_z --shortest '20 ms' --json
    """
    from trimtab.commands.calibrate import CalibrateRequest, calibrate_noise

    calibrate_noise(CalibrateRequest(**asked, as_json=as_json))


for verb in ("vehicle", "fly", "inject", "link_test", "replay", "firmware", "live_faults"):
    main.add_command(getattr(live_cli, verb))
for command in (campaign_cli.campaign, campaign_cli.stability_map, campaign_cli.falsify, campaign_cli.tune):
    main.add_command(command)


if __name__ == "__main__":
    sys.exit(main())

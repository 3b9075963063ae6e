"""`trimtab linearise`: poles, modes, zeros, Gramians and matrices of a vehicle's linear model about a trim."""

import itertools
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.linearise_loop import print_loop
from trimtab.commands.options import AT, JSON, NAVIGATION, OUT, PLOT, SET, VEHICLE, WITHOUT, FiniteRange
from trimtab.commands.output import check_out, new_table, print_files, print_json, print_table, write_text
from trimtab.commands.trim import point_json, print_point
from trimtab.core.errors import InputError
from trimtab.design.gramians import Gramians, find_gramians
from trimtab.design.linear_file import linear_json
from trimtab.design.linearise import LinearModel, linearise
from trimtab.design.trim import Trim
from trimtab.design.zero_dynamics import Zeros, transmission_zeros
from trimtab.run.design_point import find_point, smooth_model
from trimtab.run.plant import Plant, load_plant

STATE = click.option(
    "--state",
    "states",
    multiple=True,
    metavar="NAME",
    help="State to keep. All other states are held constant. May be repeated.",
)
INPUT = click.option(
    "--input",
    "inputs",
    multiple=True,
    metavar="NAME",
    help="Input to keep. All other inputs are held constant. May be repeated.",
)
OUTPUT = click.option(
    "--output",
    "outputs",
    multiple=True,
    metavar="NAME",
    help="Output to keep. All other outputs are left out. May be repeated.",
)
ON_AXIS = 1e-7
"""Largest absolute real part, as a fraction of `Zeros.size`, at which a zero counts as on the imaginary axis."""


@click.command()
@VEHICLE
@AT
@STATE
@INPUT
@OUTPUT
@SET
@NAVIGATION
@click.option(
    "--horizon",
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Time horizon of the controllability and observability Gramians.",
)
@click.option("--closed-loop", is_flag=True, help="Linearise the whole sampled loop of a scenario.")
@click.option("--direct", is_flag=True, help="With --closed-loop: apply the law's demand directly, without actuators.")
@click.option(
    "--settle",
    type=FiniteRange(),
    metavar="SECONDS",
    help="With --closed-loop: time to fly before linearising, to reach a steady state. Default: 10, 100 or 1000, the "
    "first that leads to rest.",
)
@click.option(
    "--round",
    "round_time",
    type=FiniteRange(),
    metavar="SECONDS",
    help="With --closed-loop: duration of one lap, for a reference on a closed path.",
)
@PLOT("Draw the open-loop frequency response (Bode) to this picture. Only with --closed-loop.", "picture")
@WITHOUT
@OUT("FILE", "Write the matrices A, B, C, D and the names of states, inputs and outputs (JSON).")
@JSON
def command(
    vehicle: str,
    at: tuple[str, ...],
    states: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    settings: dict[str, str],
    horizon: float,
    closed_loop: bool,
    direct: bool,
    settle: float | None,
    round_time: float | None,
    picture: Path | None,
    without: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Linearise a vehicle about a trim: poles, zeros and Gramians.

    Each pole comes with frequency, damping and participating states.

    VEHICLE and --at are as in `trimtab trim`. For a vehicle with a quaternion, the attitude states are the three
    angles of rotation from steady flight. --state, --input and --output keep only the named states, inputs and outputs;
    all other states and inputs are held constant.

    \b
    trimtab linearise hovercraft/forward --at surge_velocity=1
    trimtab linearise hypersonic --output h --output V --out model.json
    trimtab linearise my_jet.py:system --at speed='150 m/s' --at climb=0
    trimtab linearise hovercraft/forward --closed-loop --direct --plot bode.png     poles and margins of the loop

    --closed-loop differentiates the sampled loop itself, without noise, over one common period of all parts of the
    loop: vehicle, actuators, sensors, links with the packets in transit, estimator and law. Margins are computed
    exactly from the loop's poles.
    """
    open_loop = {"--at": at, "--state": states, "--input": inputs, "--output": outputs, "--out": out}
    own = {"--direct": direct, "--plot": picture, "--without": without, "--round": round_time, "--settle": settle}
    _refuse_options(open_loop if closed_loop else own, closed_loop)
    if out is not None:
        check_out("--out", out)
    plant = load_plant(vehicle, settings)
    if closed_loop:
        flight: dict[str, Any] = {"direct": direct, "off": without, "settle": settle, "round_time": round_time}
        print_loop(plant, **flight, picture=picture, as_json=as_json)
        return
    point = find_point(plant, at).require_trim("trim")
    linear = linearise(smooth_model(plant, point, outputs))
    linear = linear.part(states or None, inputs or None, outputs or None)
    zeros, gramians = transmission_zeros(linear), find_gramians(linear, horizon)
    about = point_json(plant, point)
    files = [write_text(out, linear_json(linear, about))] if out is not None else []
    if as_json:
        print_json(_result_json(linear, zeros, gramians, about), files)
        return
    _print_result(plant, point, linear, zeros, gramians, horizon, is_chosen=bool(outputs))
    print_files(files)


def _refuse_options(options: dict[str, Any], closed_loop: bool) -> None:
    for name, value in options.items():
        if value:
            fix = f"leave {name} out" if closed_loop else f"add --closed-loop, or leave {name} out"
            raise InputError(
                name, "cannot be combined with --closed-loop" if closed_loop else "needs --closed-loop", fix=fix
            )


def _result_json(linear: LinearModel, zeros: Zeros, gramians: Gramians, about: dict[str, Any]) -> dict[str, Any]:
    return {
        **about,
        "A": linear.A.tolist(),
        "B": linear.B.tolist(),
        "C": linear.C.tolist(),
        "D": linear.D.tolist(),
        "names": {"states": linear.states, "inputs": linear.inputs, "outputs": linear.outputs},
        "modes": [
            {
                "pole": [m.pole.real, m.pole.imag],
                "frequency": m.frequency,
                "damping": m.damping,
                "time_constant": m.time_constant,
                "states": dict(m.states),
            }
            for m in linear.modes()
        ],
        "zeros": zeros_json(zeros),
        "hardly_moved": {"size": gramians.hardly_moved.size, "states": gramians.hardly_moved.words},
        "hardly_seen": {"size": gramians.hardly_seen.size, "states": gramians.hardly_seen.words},
    }


def zeros_json(zeros: Zeros) -> list[dict[str, Any]]:
    """Return the zeros of a vehicle as plain data for JSON."""
    return [
        {"zero": [float(z.real), float(z.imag)], "is_right": bool(z.real > zero_limit(zeros)), "states": words}
        for z, words in zip(zeros.zeros, zeros.dominant, strict=True)
    ]


def zero_limit(zeros: Zeros) -> float:
    """Return the largest absolute real part (1/s) at which a zero counts as on the imaginary axis."""
    return ON_AXIS * max(zeros.size, np.finfo(float).tiny)


def print_zeros(zeros: Zeros, linear: LinearModel) -> None:
    """Print a table of zeros, in which zeros in the right half plane are marked."""
    pair = f"from {', '.join(linear.inputs)} to {', '.join(linear.outputs)}"
    if not len(zeros.zeros):
        click.echo(f"no zeros {pair}")
        return
    click.echo(f"zeros {pair}")
    table = new_table(">zero [1/s]", "", "states, with zero output")
    limit = zero_limit(zeros)
    for z, words in zip(zeros.zeros, zeros.dominant, strict=True):
        if z.imag < -limit:
            continue
        real = 0.0 if abs(z.real) <= limit else float(z.real)
        mark = "RIGHT: non-minimum phase" if real > 0 else "on the axis" if real == 0 else ""
        text = f"{real:+.5g}" + (f" ± {z.imag:.5g}i" if z.imag > limit else "")
        table.add_row(text, mark, words)
    print_table(table)


def _print_result(
    plant: Plant, point: Trim, linear: LinearModel, zeros: Zeros, gramians: Gramians, horizon: float, is_chosen: bool
) -> None:
    print_point(plant, point)
    print_modes(linear)
    if len(linear.outputs) < len(linear.states) or zeros.zeros.size:
        print_zeros(zeros, linear)
    known = {*plant.model.states, *linear.outputs}
    left = [n for n in plant.model.outputs if n not in known and not is_chosen]
    if left:
        click.echo(
            f"left out: {', '.join(left)}, not differentiable here; change the point with --at speed=VALUE --at climb=0"
        )
    for what, weak in (("controllable", gramians.hardly_moved), ("observable", gramians.hardly_seen)):
        click.echo(f"hardly {what} within {horizon:g} s: {weak.words}, {weak.size:.3g} of the strongest direction")


def print_modes(linear: LinearModel) -> None:
    """Print a table of poles and their participating states. A multiple pole takes one row."""
    table = new_table(">pole [1/s]", ">rad/s", ">damping", ">time [s]", "states, by participation")
    rows: list[tuple[str, ...]] = []
    for m in linear.modes(least=0.05):
        pole = f"{m.pole.real:+.5g}" + (f" ± {m.pole.imag:.5g}i" if m.pole.imag else "")
        damping = "-" if np.isnan(m.damping) else f"{m.damping:.4f}"
        time = "-" if np.isinf(m.time_constant) else f"{m.time_constant:.4g}"
        names = ", ".join(f"{n} {s:.2f}" for n, s in m.states)
        rows.append((pole, f"{m.frequency:.4g}", damping, time, names))
    for (pole, *rest), same in itertools.groupby(rows):  # a multiple pole, e.g. six at 0
        count = len(list(same))
        table.add_row(pole if count == 1 else f"{count} × {pole}", *rest)
    print_table(table)

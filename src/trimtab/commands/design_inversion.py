"""`trimtab design VEHICLE --inversion`: find states and inputs with which the outputs follow a trajectory exactly."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.options import PLOT, FiniteRange
from trimtab.commands.output import (
    check_out,
    check_picture,
    draw_plot,
    new_table,
    print_files,
    print_json,
    print_table,
    write_text,
)
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.design.normal_form import normal_form
from trimtab.design.output_inversion import InternalMode, Inversion, internal_modes, invert_output, smooth_course
from trimtab.run.design_point import find_point, format_value, parse_amount
from trimtab.run.plant import load_plant

OPTIONS = ("outputs", "inputs", "to", "seconds_long", "picture")
FADES = math.log(1e4)
"""Time computed before and after the output change, in time constants of an internal mode: a decay to 1/10000."""
LONGEST = 10.0
"""Maximum time computed before and after the change of the outputs, as a multiple of the duration of the change."""
SLOW = 0.1
"""Ratio of the duration of the output change to a mode's time constant, below which the mode counts as slow. No time is
added before or after the change for a slow mode."""
NODES = 1200


def INVERSION(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--inversion`` and its options to a command."""
    options = (
        click.option(
            "--inversion",
            is_flag=True,
            help="Compute states and inputs that move outputs smoothly to new values; see --output, --to and --in.",
        ),
        click.option(
            "--output",
            "outputs",
            multiple=True,
            metavar="NAME",
            help="Output that changes to the value in --to. Only with --inversion. May be repeated.",
        ),
        click.option(
            "--input",
            "inputs",
            multiple=True,
            metavar="NAME",
            help="Input to use. Others keep their trim values. Only with --inversion. May be repeated.  [default: all]",
        ),
        click.option(
            "--to",
            multiple=True,
            metavar="VALUE",
            help="With --inversion: final value of each --output, in the same order.",
        ),
        click.option(
            "--in",
            "seconds_long",
            type=FiniteRange(),
            metavar="SECONDS",
            help="With --inversion: duration of the change.",
        ),
        PLOT("Draw states, inputs and outputs to this picture. Only with --inversion.", "picture"),
    )
    for option in reversed(options):
        function = option(function)
    return function


def refuse_inversion_options(words: Mapping[str, Any]) -> None:
    """Raise InputError for options that need ``--inversion``, if ``--inversion`` is missing."""
    shown = {"seconds_long": "in", "picture": "plot", "outputs": "output", "inputs": "input"}
    for name in OPTIONS:
        if words[name]:
            option = f"--{shown.get(name, name)}"
            raise InputError(option, "needs --inversion", fix=f"add --inversion, or leave {option} out")


def invert_vehicle(
    vehicle: str | None, words: Mapping[str, Any], settings: Mapping[str, str], out: Path | None, as_json: bool
) -> None:
    """Compute the states and inputs for which the outputs follow a trajectory, and print, write or draw the result.

    words: values of the options of --lqr and of --inversion, as typed.  settings: settings of the scenario.
    """
    for name in ("lqr", "limit", "integrate"):
        if words[name]:
            raise InputError(f"--{name}", "cannot be combined with --inversion", fix=f"leave --{name} out")
    outputs, to, length = words["outputs"], words["to"], words["seconds_long"]
    if vehicle is None or not outputs or len(to) != len(outputs) or not length or length <= 0:
        fix = "trimtab design examples/my_cart.py --inversion --output position --to 0.5 --in 2"
        raise InputError("--inversion", "needs a vehicle, one --to for each --output, and --in above 0 s", fix=fix)
    check_picture(words["picture"], None)
    if out is not None:
        check_out("--out", out)
    assumed = dict(text.split("=", 1) for text in words["assume"] if "=" in text)
    plant = load_plant(vehicle, settings, assumed)
    start = find_point(plant, words["at"]).require_trim("--inversion, before the change of the outputs")
    held = [w for w in words["at"] if w.partition("=")[0].strip() not in outputs]
    held += _hold_inputs(plant.model.inputs, start.u, words["inputs"])
    ends = [f"{n}={v}" for n, v in zip(outputs, to, strict=True)]
    end = find_point(plant, (*held, *ends)).require_trim("--inversion, after the change of the outputs")
    kept = [plant.model.inputs.index(n) for n in words["inputs"]] or slice(None)
    model = plant.model._replace(x0=start.x, u0=start.u).keep(inputs=words["inputs"], outputs=outputs)
    first = dict(zip(model.outputs, model.evaluate(start.x, model.u0)[1].tolist(), strict=True))
    last = {n: parse_amount(plant, "--to", v, n) for n, v in zip(outputs, to, strict=True)}
    form = normal_form(model)
    places, modes = internal_modes(form)
    before, after = find_lead_times(modes, length)
    times = np.linspace(0.0, before + length + after, NODES + 1)
    order = max(r or 0 for r in form.degree.degrees.values())
    changes = {n: (first[n], last[n]) for n in outputs}
    course = smooth_course(times, changes, before, before + length, order)
    found = invert_output(model, course, end=(end.x, end.u[kept]))
    names = {"states": model.states, "inputs": model.inputs}
    data = {"vehicle": vehicle, **names, "begin": before, "end": before + length, "degrees": form.degree.degrees}
    data |= {"zeros": [[p.real, p.imag] for p in found.internal.poles.tolist()], "unstable": found.internal.unstable}
    data |= {"places": places, "slow": [m.states for m in modes if _is_slow(m, length)]}
    data |= {"iterations": found.internal.iterations, "times": times.tolist(), "x": found.x.tolist()}
    data |= {"u": found.u.tolist()}
    files = [write_text(out, json.dumps(data) + "\n")] if out is not None else []
    if words["picture"] is not None:
        from trimtab.plots.inversion import plot_inversion  # matplotlib is imported only to draw a picture

        span = (before, before + length)
        shown = {"outputs": outputs, "title": vehicle, "units": plant.units}
        files += draw_plot(words["picture"], plot_inversion, found, model.states, model.inputs, span, **shown)
    if as_json:
        print_json(data, files)
        return
    _print_inversion(plant, found, model.states, model.inputs, (before, before + length))
    print_files(files)


def find_lead_times(modes: tuple[InternalMode, ...], length: float) -> tuple[float, float]:
    """Return the times (s) to compute before the output change, for unstable modes, and after, for stable modes."""
    real = np.array([m.pole.real for m in modes if not _is_slow(m, length)])
    right, left = real[real > 0], -real[real < 0]
    times = [FADES / side.min() if len(side) else 0.1 * length for side in (right, left)]
    return min(times[0], LONGEST * length), min(times[1], LONGEST * length)


def _is_slow(mode: InternalMode, length: float) -> bool:
    return abs(mode.pole.real) * length < SLOW


def _hold_inputs(inputs: tuple[str, ...], u: Any, kept: tuple[str, ...]) -> list[str]:
    """Return conditions for ``--at`` that hold the unused inputs at their initial values."""
    unknown = [n for n in kept if n not in inputs]
    if unknown:
        near = closest(unknown[0], inputs, 1) or list(inputs)[:1]
        raise InputError(f"--input {unknown[0]}", "no such input", choices=inputs, fix=f"--input {near[0]}")
    return [f"{n}={v!r}" for n, v in zip(inputs, u.tolist(), strict=True) if kept and n not in kept]


def _print_inversion(plant: Any, found: Inversion, states: Any, inputs: Any, span: tuple[float, float]) -> None:
    degrees = ", ".join(f"{n} {r}" for n, r in found.form.degree.degrees.items())
    click.echo(f"{plant.name}: relative degree {degrees}; internal states: {', '.join(found.form.internals) or 'none'}")
    poles = [f"{p.real:+.4g}{f' ± {p.imag:.4g}i' if p.imag else ''}" for p in found.internal.poles if p.imag >= 0]
    click.echo(
        f"zeros (1/s): {', '.join(poles) or 'none'}; {found.internal.unstable} unstable ones, solved backwards in time"
    )
    places, modes = internal_modes(found.form)
    if places:
        click.echo(f"positions, integrated from their initial values: {', '.join(places)}")
    for mode in modes:
        if _is_slow(mode, span[1] - span[0]) and mode.pole.imag >= 0:
            side = "stable, solved forwards" if mode.pole.real < 0 else "unstable, solved backwards"
            click.echo(f"slow internal mode: {mode.pole.real:+.4g} 1/s in {mode.states}; {side}")
    click.echo(
        f"outputs change from {span[0]:.3g} to {span[1]:.3g} s; converged after {found.internal.iterations} iterations"
    )
    table = new_table("", ">first", ">least", ">most", ">last", ">at change start")
    begin = int(np.abs(found.times - span[0]).argmin())
    for name, column in zip((*states, *inputs), np.column_stack([found.x, found.u]).T, strict=True):
        picks = (column[0], column.min(), column.max(), column[-1], column[begin])
        table.add_row(name, *(format_value(plant, name, float(v)) for v in picks))
    print_table(table)

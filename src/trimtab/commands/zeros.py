"""`trimtab zeros`: transmission zeros, relative degree and internal dynamics of a vehicle."""

import click

from trimtab.commands.linearise import INPUT, OUTPUT, print_zeros, zeros_json
from trimtab.commands.options import AT, JSON, SET, VEHICLE
from trimtab.commands.output import print_json
from trimtab.core.errors import InputError
from trimtab.design.linearise import linearise
from trimtab.design.model import StateSpaceModel
from trimtab.design.trim import idle_states
from trimtab.design.zero_dynamics import ZeroDynamics, transmission_zeros, zero_dynamics
from trimtab.run.design_point import find_point, smooth_model
from trimtab.run.plant import load_plant


@click.command()
@VEHICLE
@AT
@INPUT
@OUTPUT
@SET
@JSON
def command(
    vehicle: str,
    at: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    settings: dict[str, str],
    as_json: bool,
) -> None:
    """Find the zeros between inputs and outputs of a vehicle.

    The command also prints what the zeros mean for tracking.

    VEHICLE and --at are as in `trimtab trim`. If there are as many inputs as outputs, a verdict is printed too: minimum
    phase, or not minimum phase, with the states that diverge while the outputs are held constant.

    \b
    trimtab zeros hypersonic --output h --output V
    trimtab zeros my_cart.py --input force --output position
    """
    plant = load_plant(vehicle, settings)
    point = find_point(plant, at).require_trim("trim")
    model = smooth_model(plant, point, outputs).keep(inputs, outputs)
    linear = linearise(model)
    zeros, found = transmission_zeros(linear), _find_dynamics(model)
    if as_json:
        verdict = {} if isinstance(found, str) else {"verdict": found.verdict, "internals": found.internals}
        why = [found] if isinstance(found, str) else list(found.why)
        names = {"inputs": linear.inputs, "outputs": linear.outputs}
        print_json({"vehicle": vehicle, **names, "zeros": zeros_json(zeros), **verdict, "why": why})
        return
    print_zeros(zeros, linear)
    if isinstance(found, str):
        click.echo(f"no verdict: {found}")
        return
    inside = f", internal states: {', '.join(found.internals)}" if found.internals else ""
    click.echo(f"{found.verdict}{inside}")
    for reason in found.why:
        click.echo(f"  {reason}")


def _find_dynamics(model: StateSpaceModel) -> ZeroDynamics | str:
    """Return the zero dynamics of a model, or the reason why they cannot be computed."""
    if len(model.inputs) != len(model.outputs):
        return f"inputs: {len(model.inputs)}, outputs: {len(model.outputs)}; name as many --input as --output"
    try:
        return zero_dynamics(model, loose=idle_states(model))
    except InputError as error:
        return error.problem

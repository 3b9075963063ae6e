"""`trimtab design VEHICLE --stabilisability`: test if smooth feedback can stabilise, and where the inputs can steer."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab import scenarios
from trimtab.commands.output import print_json
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.design.accessibility import Accessibility, LieBracket, check_rest, find_accessibility
from trimtab.design.linearise import linearise
from trimtab.design.model import StateSpaceModel, format_combination
from trimtab.design.stabilisability import SmoothFeedback, smooth_feedback
from trimtab.scenarios.catalogue import load_function

FUNCTION = "system"
UNSTABLE = 1e-9
"""Real part (1/s) above which a pole counts as unstable, chosen above the rounding errors of a double pole at zero."""
EXCLUDES = "EXCLUDED: no continuously differentiable feedback of the state makes this point asymptotically stable"


def model_names() -> tuple[str, ...]:
    """Return the names of the package's vehicles: the folders of scenarios that contain a model."""
    files = sorted(Path(scenarios.__file__).parent.glob("*/_models.py"))
    return tuple(file.parent.name for file in files)


def print_stabilisability(system: str | None, as_json: bool) -> None:
    """Print the results of three tests of a model: Brockett's, Byrnes and Isidori's, and that by Lie brackets."""
    model = _find_model(system)()
    if not isinstance(model, StateSpaceModel):
        problem = f"{system} returns a {type(model).__name__}, not a model"
        fix = "return trimtab.design.model.model_of_vehicle(…), or model_of_functions(…)"
        raise InputError("--stabilisability", problem, fix=fix)
    check_rest(model, *model.point())
    smooth, reach = smooth_feedback(model), find_accessibility(model)
    if as_json:
        print_json(_verdict_json(system, model, smooth, reach))
        return
    click.echo(f"{system}: states {', '.join(model.states)}; inputs {', '.join(model.inputs)}")
    click.echo("at " + _format_point(model))
    _print_smooth(model, smooth)
    fast = sum(pole.real > UNSTABLE for pole in np.linalg.eigvals(linearise(model).A))
    rank, poles = smooth.brockett.controllability_rank, f"{fast} unstable pole{'' if fast == 1 else 's'}"
    click.echo(f"linear model at this point: {rank} of {len(model.states)} directions controllable; {poles}")
    _print_reach(model, reach)


def _find_model(system: str | None) -> Callable[[], Any]:
    if system is not None and ".py" in system:
        return load_function(system if ".py:" in system else f"{system}:{FUNCTION}")
    if system not in model_names():
        near = closest(system or "", model_names(), 1) or model_names()[:1]
        problem = "the argument VEHICLE is missing" if system is None else f"no model of {system!r}"
        fix = f"trimtab design {near[0]} --stabilisability; your own:  my_boat.py:{FUNCTION} (returns a model)"
        raise InputError("--stabilisability", problem, choices=model_names(), fix=fix)
    return importlib.import_module(f"trimtab.scenarios.{system}._models").model


def _format_point(model: StateSpaceModel) -> str:
    names, values = (*model.states, *model.inputs), (*model.x0, *model.u0)
    moved = [f"{n} = {float(v):.6g}" for n, v in zip(names, values, strict=True) if v != 0]
    return ", ".join(moved) + ("; all other states and inputs are 0" if moved else "rest, all zero")


def _print_smooth(model: StateSpaceModel, smooth: SmoothFeedback) -> None:
    b, ranks, cascade = smooth.brockett, smooth.byrnes_isidori, smooth.cascade
    click.echo("tests for smooth state feedback")
    click.echo(f"  Brockett: {EXCLUDES if b.is_excluded else 'not excluded'}")
    for s in b.uncontrollable_unstable:
        click.echo(f"    no input controls the unstable eigenvalue {s:.4g}")
    if not b.is_onto:
        for target in b.missed_targets[:1]:
            way = format_combination(target / np.linalg.norm(target), model.states)
            click.echo(f"    no state and input near this point produce state derivatives along {way}, however small")
    elif not b.is_excluded:
        click.echo("    each small state derivative can be produced by a state and input near this point")
    if ranks is None or cascade is None:
        click.echo("  Byrnes, Isidori: does not apply: no subset of the states depends only on itself and the inputs")
        return
    x1, x2 = (", ".join(model.states[i] for i in places) for places in cascade)
    click.echo(f"  Byrnes, Isidori: {EXCLUDES if ranks.is_excluded else 'not excluded'}")
    click.echo(f"    x1 = ({x1}), x2 = ({x2})")
    click.echo(
        f"    {ranks.rank_inputs} independent inputs for the {ranks.n1} states x1; rank of df2/dx1: {ranks.rank_f2}; "
        f"condition H1 {'holds' if ranks.h1 else 'fails'}, condition H2 {'holds' if ranks.h2 else 'fails'}"
    )


def _print_reach(model: StateSpaceModel, reach: Accessibility) -> None:
    if reach.curved:
        click.echo(f"not affine in {', '.join(reach.curved)}: the brackets use the part that is linear in the inputs")
    click.echo("Lie brackets of the drift f and the input vector fields at this point; each adds a new direction")
    for bracket in reach.basis:
        click.echo(f"  {bracket.degree}  {_format_bracket(model, bracket)}")
    verdict = "accessible" if reach.is_accessible else "not shown to be accessible"
    click.echo(f"{verdict}: {reach.rank} of {reach.n} directions")
    for bracket in reach.bad:
        blocked = any(bracket is o for o in reach.obstructions)
        word = "not in the span of lower brackets" if blocked else "in the span of lower brackets"
        click.echo(f"  bad bracket: {_format_bracket(model, bracket)}: {word}")
    if reach.is_linear:
        click.echo("small-time locally controllable, because the linear model is controllable")
    elif reach.is_stlc:
        click.echo(
            "small-time locally controllable: every nearby state is reached in arbitrarily short time (Sussmann)"
        )
    elif reach.is_accessible:
        click.echo("small-time local controllability is undecided: a bad bracket is not neutralised (Sussmann)")


def _format_bracket(model: StateSpaceModel, bracket: LieBracket) -> str:
    return f"{bracket.name} = {_format_vector(bracket.value, model.states)}"


def _format_vector(v: Any, names: tuple[str, ...]) -> str:
    parts = [(float(c), n) for c, n in zip(v, names, strict=True) if abs(c) > 0]
    text = "".join(f" {'-' if c < 0 else '+'} {abs(c):.4g} {n}" for c, n in parts)
    return text.removeprefix(" + ").replace(" - ", "-", 1) if text.startswith(" - ") else text.removeprefix(" + ")


def _verdict_json(
    system: str | None, model: StateSpaceModel, smooth: SmoothFeedback, reach: Accessibility
) -> dict[str, Any]:
    b = smooth.brockett
    image = b._replace(
        uncontrollable_unstable=tuple([s.real, s.imag] for s in b.uncontrollable_unstable),
        missed_targets=b.missed_targets.tolist(),
    )
    ranks, cascade = smooth.byrnes_isidori, smooth.cascade
    split = None if cascade is None else {n: [model.states[i] for i in p] for n, p in cascade._asdict().items()}
    lists = {n: [_bracket_json(b) for b in getattr(reach, n)] for n in ("basis", "bad", "obstructions")}
    return {
        "system": system,
        "states": model.states,
        "inputs": model.inputs,
        "is_excluded": smooth.is_excluded,
        "brockett": image._asdict(),
        "byrnes_isidori": None if ranks is None else ranks._asdict() | {"cascade": split},
        "accessibility": reach._asdict() | lists,
    }


def _bracket_json(bracket: LieBracket) -> dict[str, Any]:
    return bracket._asdict() | {"value": bracket.value.tolist()}

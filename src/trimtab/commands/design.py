"""`trimtab design`: a gain with its certificate, and the proof of a certificate."""

import importlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from trimtab import scenarios
from trimtab.core.errors import InputError, closest

if TYPE_CHECKING:  # what a proof does not need is not imported for it
    from trimtab.design.certificate import Certificate
    from trimtab.design.certificate_check import CertificateProof, ProofCondition

SAME = 1e-6
"""How far the model in a certificate may be from the system's, in parts of its largest entry, scaled."""


class DesignRequest(NamedTuple):
    """What was asked for on the command line."""

    system: str | None
    method: str | None = None
    filter_: str | None = None
    integral: bool = False
    out: Path | None = None
    check: Path | None = None
    as_json: bool = False


def design(request: DesignRequest) -> bool:
    """Design and prove, or prove what a file holds; whether every condition holds."""
    made, found = _prove_file(request) if request.check else _design_certificate(request)
    written = []
    if request.out is not None and found.holds:
        written = [_write_certificate(made, request.out)]
    if request.as_json:
        _print_json(made, found, written)
        return found.holds
    _print_proof(made, found, request)
    for file in written:
        click.echo(f"wrote {file}")
    if request.out is not None and not found.holds:
        click.echo(f"not written: {request.out}, since a condition fails")
    return found.holds


def design_systems() -> tuple[str, ...]:
    """What gains can be designed for: the folders of scenarios that have a design."""
    found = sorted(Path(scenarios.__file__).parent.glob("*/_design.py"))
    return tuple(file.parent.name for file in found)


def _import_builder(system: str) -> Any:
    if system not in design_systems():
        near = closest(system, design_systems(), 1) or design_systems()[:1]
        problem = f"there is no design for {system!r}"
        raise InputError("design", problem, choices=design_systems(), fix=f"trimtab design {near[0]}")
    return importlib.import_module(f"trimtab.scenarios.{system}._design")


def _design_certificate(request: DesignRequest) -> tuple["Certificate", "CertificateProof"]:
    if request.system is None:
        fix = f"trimtab design {design_systems()[0]}, or trimtab design --check FILE"
        raise InputError("design", "no system and no file", choices=design_systems(), fix=fix)
    if request.out is not None:
        _check_file(request.out)
    from trimtab.design.certificate_check import prove_certificate

    builder, given = _import_builder(request.system), {}
    if request.method is not None:
        given["method"] = request.method
    if request.filter_ is not None:
        given["filter"] = request.filter_
    made = builder.certificate(integral=request.integral, **given)
    return made, prove_certificate(made)


def _prove_file(request: DesignRequest) -> tuple["Certificate", "CertificateProof"]:
    """The certificate of a file, proved again; compared with the system where one is named."""
    for name, value in (("--out", request.out), ("--method", request.method), ("--filter", request.filter_)):
        if value is not None or request.integral:
            name = "--integral" if value is None else name
            raise InputError(name, "a file is checked as it is", fix=f"leave {name} out, or leave --check out")
    from trimtab.design.certificate import read_certificate
    from trimtab.design.certificate_check import prove_certificate

    assert request.check is not None
    made, written = read_certificate(request.check)
    found = prove_certificate(made, written)
    if request.system is None:
        return made, found
    more = _compare_with_system(made, request.system)
    return made, found._replace(conditions=(*found.conditions, *more), holds=found.holds and all(c.holds for c in more))


def _compare_with_system(made: "Certificate", system: str) -> list["ProofCondition"]:
    """A and B in the certificate beside those of the system as it is now."""
    from trimtab.design.certificate_check import ProofCondition

    builder = _import_builder(system)
    if made.system != system:
        problem = f"it is a certificate for {made.system!r}"
        raise InputError("--check", problem, fix=f"trimtab design {made.system} --check FILE")
    lines = []
    d, e = made.scale, 1 / np.sqrt(np.diag(made.Re))
    pairs = zip(("A", "B"), (made.A, made.B), builder.again(made), (d, e), (made.states, made.inputs), strict=True)
    for name, there, now, size, columns in pairs:
        name = f"{name} is that of {system}"
        if there.shape != now.shape:
            lines.append(
                ProofCondition(name, False, float("nan"), "deviation", "floats", f"{there.shape}, {now.shape}")
            )
            continue
        apart, whole = (there - now) * size / d[:, None], now * size / d[:, None]
        off = float(np.abs(apart).max() / np.abs(whole).max())
        i, j = np.unravel_index(int(np.abs(apart).argmax()), apart.shape)
        why = "" if off <= SAME else f"at {made.states[i]}, {columns[j]}: {there[i, j]!r}, now {now[i, j]!r}"
        lines.append(ProofCondition(name, off <= SAME, off, "deviation, scaled", "computed anew, floats", why))
    return lines


def _check_file(file: Path) -> None:
    from trimtab.commands.fly_scenario import check_folder

    check_folder("--out", file.parent)
    if file.is_dir():
        raise InputError("--out", f"{str(file)!r} is a folder", fix=f"--out {file / 'certificate.json'}")


def _write_certificate(made: "Certificate", file: Path) -> Path:
    from trimtab.design.certificate import certificate_json
    from trimtab.logs.mcap import replace_file

    file.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(file) as stream:
        stream.write(certificate_json(made).encode())
    return file


def _print_json(made: "Certificate", found: "CertificateProof", written: list[Path]) -> None:
    rows = [c._asdict() | {"number": c.number if np.isfinite(c.number) else None} for c in found.conditions]
    about = {"system": made.system, "method": made.method, "about": made.about, "holds": found.holds}
    about |= {"K": made.K.tolist(), "poles": [[p.real, p.imag] for p in made.poles.tolist()], "conditions": rows}
    if made.observer is not None:
        about["least_weight"] = made.observer.least_weight
    click.echo(json.dumps(about | ({"files": [str(f) for f in written]} if written else {}), allow_nan=False))


def _print_proof(made: "Certificate", found: "CertificateProof", request: DesignRequest) -> None:
    from trimtab.commands.tables import print_conditions
    from trimtab.design.certificate import SCOPE
    from trimtab.design.lqr import format_pole

    settings = ", ".join(f"{n} {v:.7g}" if isinstance(v, float) else f"{n} {v}" for n, v in made.about.items())
    click.echo(f"{made.system}: {settings}")
    if not request.check:
        click.echo("gain, v = +K e:")
        width = max(len(n) for n in (*made.states, *made.inputs))
        click.echo(" " * (width + 2) + " ".join(f"{n:>13}" for n in made.states))
        for name, row in zip(made.inputs, made.K, strict=True):
            click.echo(f"  {name:<{width}}" + " ".join(f"{v:13.7g}" for v in row))
    click.echo("poles of A + B K: " + ", ".join(format_pole(p) for p in made.poles if p.imag >= 0))
    if made.observer is not None:
        o = made.observer
        click.echo(f"least weight of the filter, lambda*: {o.least_weight:.6g}; taken {o.weight:.6g}")
    print_conditions(f"{request.check or made.system}: {'proved' if found.holds else 'NOT proved'}", found)
    click.echo("what it says: " + "; ".join(SCOPE) + " (docs, Certificate)")

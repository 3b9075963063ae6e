"""`trimtab design`: a gain with its certificate, and the proof of a certificate."""

import importlib
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab import scenarios
from trimtab.commands.options import FILE, JSON
from trimtab.commands.output import check_folder, console, new_table, print_files, print_json, write_text
from trimtab.core.errors import InputError, closest
from trimtab.design.certificate import SCOPE, Certificate, certificate_json, read_certificate
from trimtab.design.certificate_check import CertificateProof, ProofCondition, prove_certificate
from trimtab.design.poles import format_pole

SAME = 1e-6
"""How far the model in a certificate may be from the system's, in parts of its largest entry, scaled."""


@click.command()
@click.argument("system", metavar="[SYSTEM]", required=False)
@click.option("--method", type=click.Choice(("lqr", "lmi")), help="Riccati equation, or a solver.  [default: lqr]")
@click.option("--filter", "filter_", metavar="KIND", help="Filter of the unmeasured states.  [default: tuned]")
@click.option("--integral", is_flag=True, help="With integral action.")
@click.option("--out", type=FILE, metavar="FILE", help="Write the certificate (JSON).")
@click.option("--check", type=FILE, metavar="FILE", help="Prove a certificate again.")
@JSON
def command(
    system: str | None,
    method: str | None,
    filter_: str | None,
    integral: bool,
    out: Path | None,
    check: Path | None,
    as_json: bool,
) -> None:
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
    if check is None:
        certificate = _design_certificate(system, method, filter_, integral, out)
        proof = prove_certificate(certificate)
    else:
        _refuse_with_check({"--out": out, "--method": method, "--filter": filter_, "--integral": integral or None})
        certificate, proof = _prove_file(check, system)
    files = [write_text(out, certificate_json(certificate))] if out is not None and proof.holds else []
    if as_json:
        print_json(_proof_json(certificate, proof), files)
    else:
        _print_design(certificate, proof, check)
        print_files(files)
        if out is not None and not proof.holds:
            click.echo(f"not written: {out}, since a condition fails")
    sys.exit(0 if proof.holds else 1)


def design_systems() -> tuple[str, ...]:
    """What gains can be designed for: the folders of scenarios that have a design."""
    files = sorted(Path(scenarios.__file__).parent.glob("*/_design.py"))
    return tuple(file.parent.name for file in files)


def _import_builder(system: str) -> Any:
    if system not in design_systems():
        near = closest(system, design_systems(), 1) or design_systems()[:1]
        problem = f"there is no design for {system!r}"
        raise InputError("design", problem, choices=design_systems(), fix=f"trimtab design {near[0]}")
    return importlib.import_module(f"trimtab.scenarios.{system}._design")


def _design_certificate(
    system: str | None, method: str | None, filter_: str | None, integral: bool, out: Path | None
) -> Certificate:
    if system is None:
        fix = f"trimtab design {design_systems()[0]}, or trimtab design --check FILE"
        raise InputError("design", "no system and no file", choices=design_systems(), fix=fix)
    if out is not None:
        check_folder("--out", out.parent)
        if out.is_dir():
            raise InputError("--out", f"{str(out)!r} is a folder", fix=f"--out {out / 'certificate.json'}")
    choices = {"method": method, "filter": filter_}
    builder = _import_builder(system)
    return builder.certificate(integral=integral, **{n: choice for n, choice in choices.items() if choice is not None})


def _refuse_with_check(options: dict[str, Any]) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(name, "a file is checked as it is", fix=f"leave {name} out, or leave --check out")


def _prove_file(file: Path, system: str | None) -> tuple[Certificate, CertificateProof]:
    """The certificate of a file, proved again; compared with the system where one is named."""
    certificate, text = read_certificate(file)
    proof = prove_certificate(certificate, text)
    if system is None:
        return certificate, proof
    more = _compare_with_system(certificate, system)
    holds = proof.holds and all(c.holds for c in more)
    return certificate, proof._replace(conditions=(*proof.conditions, *more), holds=holds)


def _compare_with_system(certificate: Certificate, system: str) -> list[ProofCondition]:
    """A and B in the certificate beside those of the system as it is now."""
    builder = _import_builder(system)
    if certificate.system != system:
        problem = f"it is a certificate for {certificate.system!r}"
        raise InputError("--check", problem, fix=f"trimtab design {certificate.system} --check FILE")
    lines = []
    d, e = certificate.scale, 1 / np.sqrt(np.diag(certificate.Re))
    pairs = zip(
        ("A", "B"),
        (certificate.A, certificate.B),
        builder.recompute_matrices(certificate),
        (d, e),
        (certificate.states, certificate.inputs),
        strict=True,
    )
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
        why = "" if off <= SAME else f"at {certificate.states[i]}, {columns[j]}: {there[i, j]!r}, now {now[i, j]!r}"
        lines.append(ProofCondition(name, off <= SAME, off, "deviation, scaled", "computed anew, floats", why))
    return lines


def _proof_json(certificate: Certificate, proof: CertificateProof) -> dict[str, Any]:
    about = {"system": certificate.system, "method": certificate.method, "about": certificate.about}
    about |= {"holds": proof.holds, "K": certificate.K.tolist()}
    about |= {"poles": [[p.real, p.imag] for p in certificate.poles.tolist()]}
    about |= {"conditions": [c._asdict() for c in proof.conditions]}
    return about | ({} if certificate.observer is None else {"least_weight": certificate.observer.least_weight})


def _print_design(certificate: Certificate, proof: CertificateProof, file: Path | None) -> None:
    settings = ", ".join(f"{n} {v:.7g}" if isinstance(v, float) else f"{n} {v}" for n, v in certificate.about.items())
    click.echo(f"{certificate.system}: {settings}")
    if file is None:
        click.echo("gain, v = +K e:")
        width = max(len(n) for n in (*certificate.states, *certificate.inputs))
        click.echo(" " * (width + 2) + " ".join(f"{n:>13}" for n in certificate.states))
        for name, row in zip(certificate.inputs, certificate.K, strict=True):
            click.echo(f"  {name:<{width}}" + " ".join(f"{v:13.7g}" for v in row))
    click.echo("poles of A + B K: " + ", ".join(format_pole(p) for p in certificate.poles if p.imag >= 0))
    if certificate.observer is not None:
        o = certificate.observer
        click.echo(f"least weight of the filter, lambda*: {o.least_weight:.6g}; taken {o.weight:.6g}")
    _print_conditions(f"{file or certificate.system}: {'proved' if proof.holds else 'NOT proved'}", proof)
    click.echo("what it says: " + "; ".join(SCOPE) + " (docs, Certificate)")


def _print_conditions(title: str, proof: CertificateProof) -> None:
    """Each condition of a certificate with its number and verdict."""
    table = new_table("condition", "verdict", ">number", "of", "by", title=title)
    for c in proof.conditions:
        number = f"{c.number:.4g}" if c.number == c.number else "-"
        cells = (c.name, "holds" if c.holds else "FAILS", number, c.meaning, c.how)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style="" if c.holds else "bold red")
    console().print(table)
    for c in proof.conditions:
        if c.why:
            click.echo(f"{'' if c.holds else 'FAILS  '}{c.name}: {c.why}")

"""`trimtab design` for a control law: derive, write and check a theorem about the law's closed loop."""

import importlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from trimtab import scenarios
from trimtab.commands.output import new_table, print_files, print_json, print_table, write_text
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.design.attraction import find_region
from trimtab.design.certified_system import system_settings
from trimtab.design.proof import CertificateProof
from trimtab.design.squares import GramForm, SquaresProof
from trimtab.design.theorem import FALLS, LawTheorem, TheoremCertificate, prove_theorem
from trimtab.design.theorem_file import (
    FORMAT,
    SCOPE,
    design_theorem,
    parse_theorem,
    read_text,
    theorem_digest,
    theorem_json,
)
from trimtab.scenarios.catalogue import load_function

TheoremFunction = Callable[..., LawTheorem]


def theorem_functions() -> dict[str, TheoremFunction]:
    """Return the functions that build theorems, by name, from all folders of scenarios."""
    functions: dict[str, TheoremFunction] = {}
    for file in sorted(Path(scenarios.__file__).parent.glob("*/_theorems.py")):
        functions |= importlib.import_module(f"trimtab.scenarios.{file.parent.name}._theorems").THEOREMS
    return functions


def is_theorem(system: str | None, check: Path | None) -> bool:
    """Return True if the certificate file contains a theorem, not a gain. Without a file, the system's name decides."""
    if check is not None:
        return check.is_file() and f'"format": "{FORMAT}"' in check.read_bytes()[:200].decode(errors="replace")
    return system is not None and (".py:" in system or system in theorem_functions())


def run_theorem(
    system: str | None, settings: Mapping[str, str], out: Path | None, check: Path | None, as_json: bool
) -> bool:
    """Make or check the certificate of a theorem. Print and write the certificate.

    Return True if every condition holds.
    """
    if check is None:
        theorem = _build_theorem(system or "", settings)
        certificate = _make_certificate(theorem)
        proof = prove_theorem(certificate, theorem)
    else:
        refuse_options({"--out": out, "--set": settings or None}, "--check")
        certificate, written = parse_theorem(read_text(check), str(check))
        theorem = _build_theorem(system or certificate.theorem, certificate.about)
        proof = prove_theorem(certificate, theorem, (written, theorem_digest(certificate)))
    files = [write_text(out, theorem_json(certificate))] if out is not None and proof.holds else []
    if as_json:
        about = {"theorem": theorem.name, "about": dict(theorem.about), "says": theorem.says, "holds": proof.holds}
        level = None if certificate.level is None else float(certificate.level)
        about |= {"lyapunov": str(certificate.lyapunov), "level": level}
        print_json(about | {"conditions": [c._asdict() for c in proof.conditions]}, files)
        return proof.holds
    _print_theorem(theorem, certificate)
    print_conditions(f"{check or theorem.name}: {'proved' if proof.holds else 'NOT proved'}", proof)
    click.echo("scope of the proof: " + "; ".join(SCOPE) + " (docs, Theorem)")
    print_files(files)
    print_unwritten((out,), proof)
    return proof.holds


def refuse_options(options: Mapping[str, Any], beside: str) -> None:
    """Raise InputError if an option is given that cannot be combined with the option or object `beside`."""
    for name, value in options.items():
        if value is not None:
            raise InputError(name, f"cannot be combined with {beside}", fix=f"leave {name} out")


def print_unwritten(files: Iterable[Path | None], proof: CertificateProof) -> None:
    """Print the names of the files that were not written because the proof fails."""
    for file in files:
        if file is not None and not proof.holds:
            click.echo(f"not written: {file}, because a condition fails")


def print_conditions(title: str, proof: CertificateProof) -> None:
    """Print each condition of a certificate: verdict, number, meaning and method of proof."""
    table = new_table("condition", "verdict", ">number", "meaning", "method", title=title)
    for c in proof.conditions:
        number = f"{c.number:.4g}" if c.number == c.number else "-"
        cells = (c.name, "holds" if c.holds else "FAILS", number, c.meaning, c.how)
        table.add_row(*(cell.replace("[", r"\[") for cell in cells), style="" if c.holds else "bold red")
    print_table(table)
    for c in proof.conditions:
        if c.why:
            click.echo(show_controls(f"{'' if c.holds else 'FAILS  '}{c.name}: {c.why}"))


def _build_theorem(name: str, settings: Mapping[str, Any]) -> LawTheorem:
    functions = theorem_functions()
    if name not in functions and ".py:" not in name:
        problem, fix = f"unknown theorem {name!r}", "name the file:  trimtab design my_law.py:theorem --check FILE"
        raise InputError("design", problem, choices=tuple(functions), fix=fix)
    function = functions.get(name) or load_function(name)
    theorem = function(**system_settings(function, settings, f"trimtab design {name}"))
    if not isinstance(theorem, LawTheorem):
        problem = f"{name} returns a {type(theorem).__name__}, not a LawTheorem"
        raise InputError("design", problem, fix="return a trimtab.design.theorem.LawTheorem, or leave the function out")
    return theorem


def _make_certificate(theorem: LawTheorem) -> TheoremCertificate:
    """Make a certificate with the law's Lyapunov function, or search for the function with the largest region."""
    if not theorem.field or theorem.lyapunov is not None:
        return design_theorem(theorem)
    region = find_region(theorem)
    return design_theorem(theorem, region.lyapunov, region.level, **region.proofs)


def _print_theorem(theorem: LawTheorem, certificate: TheoremCertificate) -> None:
    about = ", ".join(f"{n} {v:.7g}" if isinstance(v, float) else f"{n} {v}" for n, v in theorem.about.items())
    click.echo(theorem.name + (f": {about}" if about else ""))
    click.echo(theorem.says)
    for name, rate in theorem.field.items():
        click.echo(f"  {name}' = {rate}")
    if certificate.lyapunov is not None:
        click.echo(show_controls(f"  V = {certificate.lyapunov}"))
    if certificate.level is not None:
        click.echo(f"  c = {certificate.level}")
    proof = certificate.proofs.get(FALLS)
    if proof is not None:
        click.echo(show_controls(f"  -dV/dt = {_sum_in_words(proof)}"))


def _sum_in_words(proof: SquaresProof) -> str:
    parts = []
    for term in proof.terms:
        after = f" ({term.times})" if term.times else ""
        if isinstance(term, GramForm):
            parts.append(f"z'G z{after}, {len(term.forms)} forms z")
        else:
            parts += [f"({w}) ({f})^2{after}" for w, f in zip(term.weights, term.forms, strict=True)]
    return " + ".join(parts)

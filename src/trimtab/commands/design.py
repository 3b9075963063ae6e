"""`trimtab design`: design a feedback gain with a stability certificate, and prove the certificate again."""

import importlib
import sys
from pathlib import Path
from typing import Any

import click

from trimtab import scenarios
from trimtab.commands.design_inversion import INVERSION, invert_vehicle, refuse_inversion_options
from trimtab.commands.design_lqr import GAIN, design_gain, gain_vehicle, refuse_gain_options
from trimtab.commands.design_stabilisability import print_stabilisability
from trimtab.commands.design_theorem import (
    is_theorem,
    print_conditions,
    print_unwritten,
    refuse_options,
    run_theorem,
    theorem_functions,
)
from trimtab.commands.options import FILE, JSON, OUT, parse_settings
from trimtab.commands.output import check_out, print_files, print_json, write_text
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.design.certificate import Certificate, design_certificate
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.certificate_file import SCOPE, certificate_json, read_certificate
from trimtab.design.certified_system import CertifiedSystem, SystemFunction, system_settings
from trimtab.design.coq import coq_text
from trimtab.design.poles import format_pole
from trimtab.design.proof import CertificateProof
from trimtab.scenarios.catalogue import load_function, scenario_names

FUNCTION = "certified_system"


@click.command()
@click.argument("system", metavar="[SYSTEM]", required=False)
@click.option(
    "--method",
    type=click.Choice(("lqr", "lmi")),
    help="Method: Riccati equation (lqr), or a solver for matrix inequalities (lmi).  [default: lqr]",
)
@click.option(
    "--filter",
    "filter_",
    metavar="KIND",
    help="Kind of filter that estimates the unmeasured states, for `hypersonic`: tuned, equal, accurate, printed or "
    "none.  [default: tuned]",
)
@click.option("--integral", is_flag=True, help="Add integral action to the feedback.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    callback=parse_settings,
    help="Change a setting of the system, e.g. h_ft=90000. May be repeated.",
)
@OUT("FILE", "Write the certificate to this file (JSON).")
@click.option("--check", type=FILE, metavar="FILE", help="Prove the certificate in this existing file again.")
@click.option(
    "--stabilisability",
    is_flag=True,
    help="Find out if smooth feedback can stabilise SYSTEM, and in which directions the inputs can steer SYSTEM.",
)
@GAIN
@INVERSION
@click.option("--export-coq", "coq", type=FILE, metavar="FILE.v", help="Write the proof to this file for Coq (coqc).")
@JSON
def command(
    system: str | None,
    method: str | None,
    filter_: str | None,
    integral: bool,
    settings: dict[str, str],
    out: Path | None,
    check: Path | None,
    coq: Path | None,
    stabilisability: bool,
    as_json: bool,
    **gain: Any,
) -> None:
    """Design a gain, and a certificate that proves its stability. With --check: prove an existing certificate again.

    A certificate belongs to a named system with settings. --check rebuilds that system from scratch, compares it with
    every matrix, weight and number in the file, and proves each condition in exact arithmetic, without the solver that
    found the gain. If a condition fails, the violating number is printed and the exit code is 1. SYSTEM is a system of
    the package, or a file or folder of your own (docs, Certificate).

    For a law of the package, the result is a theorem instead of a gain: the set to which the loop converges, the region
    of attraction, and a Lyapunov function (docs, Theorem). The theorem is derived from the code of the law, evaluated
    on polynomials. --stabilisability tests if smooth feedback can stabilise a vehicle (Brockett; Byrnes and Isidori),
    and finds by Lie brackets the directions in which the inputs can steer it (docs, Stabilisability).

    \b
    trimtab design hypersonic                        gain, poles and every condition
    trimtab design hypersonic --out gain.json
    trimtab design hypersonic --set h_ft=90000 --set uncertainty=0.5 --out gain.json
    trimtab design --check gain.json
    trimtab design hypersonic --method lmi --json
    trimtab design --check gain.json --export-coq gain.v     then: coqc gain.v
    trimtab design my_boat.py --check gain.json              for a system in your own file
    trimtab design hovercraft/forward --out law.json         a theorem about a law; --check law.json proves it again
    trimtab design hovercraft/reverse --set k1=2             the region from which the craft comes to rest
    trimtab design my_law.py:theorem                         for your own law
    trimtab design hovercraft --stabilisability              test if smooth feedback can stabilise the craft
    trimtab design my_boat.py:system --stabilisability       for your own model
    trimtab design examples/my_cart.py --lqr --limit lean='6 deg' …   a gain from a limit of each state and input
    trimtab design vessel/path --lqr --fast rudder …         then:  trimtab run vessel/path --set gain=gain.json
    trimtab design my_cart.py --inversion --output position --to 0.5 --in 2 --plot course.png     exact inputs
    """
    given = {"--method": method, "--filter": filter_, "--integral": integral or None, "--export-coq": coq}
    if gain["inversion"]:
        refuse_options(given | {"--check": check, "--stabilisability": stabilisability or None}, "--inversion")
        invert_vehicle(system, gain, settings, out, as_json)
        return
    refuse_inversion_options(gain)
    _check_files({"--out": out, "--export-coq": coq})
    of_gain = gain_vehicle(system, check)
    if gain["lqr"] or of_gain:
        refuse_options(given | {"--stabilisability": stabilisability or None}, "--lqr")
        sys.exit(0 if design_gain(of_gain or system, gain, settings, out, check, as_json) else 1)
    refuse_gain_options(gain)
    if stabilisability:
        refuse_options(given | {"--set": settings or None, "--out": out, "--check": check}, "--stabilisability")
        print_stabilisability(system, as_json)
        return
    if is_theorem(system, check):
        refuse_options(given, "a theorem")
        sys.exit(0 if run_theorem(system, settings, out, check, as_json) else 1)
    choices = {"method": method, "filter": filter_, "integral": "true" if integral else None}
    if check is None:
        certified = _build_system(system, settings | {n: c for n, c in choices.items() if c is not None})
        certificate = design_certificate(certified)
        proof = prove_certificate(certificate, certified)
    else:
        _refuse_with_check({"--out": out, "--set": settings or None} | {f"--{n}": c for n, c in choices.items()})
        certificate, written = read_certificate(check)
        proof = prove_certificate(certificate, _rebuild_system(certificate, system), written)
    texts = {out: certificate_json, coq: coq_text}
    files = [write_text(file, text(certificate)) for file, text in texts.items() if file is not None and proof.holds]
    if as_json:
        print_json(_proof_json(certificate, proof), files)
    else:
        _print_design(certificate, proof, check)
        print_files(files)
        print_unwritten(texts, proof)
    sys.exit(0 if proof.holds else 1)


def design_systems() -> tuple[str, ...]:
    """Return the names of the systems with a built-in design: the folders of scenarios that contain one."""
    files = sorted(Path(scenarios.__file__).parent.glob("*/_design.py"))
    return tuple(file.parent.name for file in files)


def _find_function(system: str | None) -> SystemFunction:
    """Return the function that builds a system of the package, or of the user's file or folder."""
    if system is None:
        fix = f"trimtab design {design_systems()[0]}, or trimtab design --check FILE"
        raise InputError("design", "the argument SYSTEM is missing", choices=design_systems(), fix=fix)
    file = Path(system) / "_design.py" if Path(system).is_dir() else Path(system)
    if system not in design_systems() and file.suffix == ".py":
        try:
            return load_function(f"{file}:{FUNCTION}")
        except InputError as error:
            if "scenario" not in error.choices:
                raise
            fix = f"for a scenario's vehicle:  trimtab design {file} --lqr --limit NAME=NUMBER …"
            raise InputError(error.part, error.problem, choices=error.choices, fix=fix) from None
    if system not in design_systems():
        if system in scenario_names():
            problem = f"no built-in design for scenario {system!r}"
            fix = f"trimtab design {system} --lqr --limit NAME=NUMBER … --out gain.json  designs a gain from limits"
            raise InputError("design", problem, choices=(*design_systems(), *theorem_functions()), fix=fix)
        near = closest(system, (*design_systems(), *theorem_functions()), 1) or design_systems()[:1]
        problem = f"no built-in design for {system!r}"
        fix = f"trimtab design {near[0]}; for your own system, name the Python file:  trimtab design my_boat.py"
        raise InputError("design", problem, choices=(*design_systems(), *theorem_functions()), fix=fix)
    return getattr(importlib.import_module(f"trimtab.scenarios.{system}._design"), FUNCTION)


def _build_system(system: str | None, settings: dict[str, str]) -> CertifiedSystem:
    function = _find_function(system)
    return function(**system_settings(function, settings, f"trimtab design {system}"))


def _rebuild_system(certificate: Certificate, system: str | None) -> CertifiedSystem:
    """Rebuild the system that a certificate names, with the settings in the certificate."""
    if system is None and certificate.system not in design_systems():
        problem = f"the certificate is for {certificate.system!r}, which is not in the package"
        fix = "name the Python file of the system:  trimtab design my_boat.py --check FILE"
        raise InputError("--check", problem, choices=design_systems(), fix=fix)
    if system in design_systems() and certificate.system != system:
        problem = f"the certificate is for {certificate.system!r}"
        raise InputError("--check", problem, fix=f"trimtab design {certificate.system} --check FILE")
    function = _find_function(certificate.system if system is None else system)
    wanted = system_settings(function, {}, "--check")
    lacking = [name for name in wanted if name not in certificate.about]
    if lacking:
        fix = f"trimtab design {certificate.system} --out FILE  writes a new certificate"
        raise InputError("--check", f"the certificate file lacks the key about.{lacking[0]}", fix=fix)
    given = {name: certificate.about[name] for name in wanted}
    return function(**system_settings(function, given, "--check"))


def _check_files(files: dict[str, Path | None]) -> None:
    for option, file in files.items():
        if file is not None:
            check_out(option, file, "certificate.v" if option == "--export-coq" else "certificate.json")


def _refuse_with_check(options: dict[str, Any]) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(name, "cannot be combined with --check", fix=f"leave {name} out, or leave --check out")


def _proof_json(certificate: Certificate, proof: CertificateProof) -> dict[str, Any]:
    about = {"system": certificate.system, "method": certificate.method, "about": certificate.about}
    about |= {"holds": proof.holds, "K": certificate.K.tolist()}
    about |= {"poles": [[p.real, p.imag] for p in certificate.poles.tolist()]}
    about |= {"conditions": [c._asdict() for c in proof.conditions]}
    return about | ({} if certificate.observer is None else {"least_weight": certificate.observer.least_weight})


def _print_design(certificate: Certificate, proof: CertificateProof, file: Path | None) -> None:
    settings = ", ".join(f"{n} {v:.7g}" if isinstance(v, float) else f"{n} {v}" for n, v in certificate.about.items())
    click.echo(show_controls(f"{certificate.system}: {settings}"))
    if file is None:
        click.echo("gain, v = +K e:")
        width = max(len(n) for n in (*certificate.states, *certificate.inputs))
        click.echo(" " * (width + 2) + " ".join(f"{n:>13}" for n in map(show_controls, certificate.states)))
        for name, row in zip(certificate.inputs, certificate.K, strict=True):
            click.echo(f"  {show_controls(name):<{width}}" + " ".join(f"{v:13.7g}" for v in row))
    click.echo("poles of A + B K: " + ", ".join(format_pole(p) for p in certificate.poles if p.imag >= 0))
    if certificate.observer is not None:
        o = certificate.observer
        click.echo(f"smallest weight of the filter, lambda*: {o.least_weight:.6g}; weight used: {o.weight:.6g}")
    print_conditions(f"{file or certificate.system}: {'proved' if proof.holds else 'NOT proved'}", proof)
    click.echo("scope of the proof: " + "; ".join(SCOPE) + " (docs, Certificate)")

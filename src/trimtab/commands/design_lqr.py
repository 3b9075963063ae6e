"""`trimtab design VEHICLE --lqr`: design a gain from limits of states and inputs, with a stability certificate."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.commands.options import AT
from trimtab.commands.output import new_table, print_files, print_json, print_table, write_text
from trimtab.core.control_characters import show_controls
from trimtab.core.errors import InputError
from trimtab.design.bryson import fed_back_states, weigh_by_limits
from trimtab.design.certificate import Certificate, design_certificate
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.certificate_file import certificate_json, read_certificate
from trimtab.design.certified_system import CertifiedSystem, LimitedNumber, Setting
from trimtab.design.linearise import LinearModel
from trimtab.design.lqr import augment_integrals
from trimtab.design.proof import CertificateProof
from trimtab.design.trim import idle_states
from trimtab.loop.linear_laws import INPUT, STATE
from trimtab.run.design_point import ZERO, find_point, linearise_at, parse_amount
from trimtab.run.plant import Plant, load_plant
from trimtab.scenarios import catalogue
from trimtab.scenarios.gain_file import vehicle_settings

LISTS = ("at", "limit", "integrate", "assume", "fast")
"""Options of ``--lqr`` that may be repeated. A certificate stores the values of each as a list."""


def GAIN(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--lqr`` and the options in LISTS to a command."""
    options = (
        click.option(
            "--lqr",
            is_flag=True,
            help="Design a gain for any vehicle or scenario, from a --limit for each state and input.",
        ),
        click.option(
            "--limit",
            multiple=True,
            metavar="NAME=VALUE",
            help="With --lqr: largest acceptable value of a state or input. May be repeated.",
        ),
        click.option(
            "--integrate",
            multiple=True,
            metavar="NAME=VALUE",
            help="With --lqr: state whose error is integrated, and the largest acceptable integral. May be repeated.",
        ),
        click.option(
            "--assume",
            multiple=True,
            metavar="NAME=VALUE",
            help="With --lqr: setting of the vehicle model used for the design. May be repeated.",
        ),
        click.option(
            "--fast",
            multiple=True,
            metavar="NAME",
            help="With --lqr: fast state that the control law does not feed back. May be repeated.",
        ),
        AT,
    )
    for option in reversed(options):
        function = option(function)
    return function


def refuse_gain_options(gain: Mapping[str, Any]) -> None:
    """Raise InputError for options that need ``--lqr``, if ``--lqr`` is missing."""
    for name in LISTS:
        if gain[name]:
            raise InputError(f"--{name}", "needs --lqr", fix=f"add --lqr, or leave --{name} out")


def design_gain(
    vehicle: str | None,
    words: Mapping[str, Any],
    settings: Mapping[str, str],
    out: Path | None,
    check: Path | None,
    as_json: bool,
) -> bool:
    """Design a gain and prove the certificate, or check an existing gain file. Return True if every condition holds.

    words: values of the options in LISTS, as typed.  settings: settings of the scenario.
    """
    if vehicle is None:
        raise InputError(
            "design --lqr", "the argument VEHICLE is missing", fix="trimtab design hovercraft/forward --lqr …"
        )
    if check is None:
        system = build_gain_system(vehicle, words, settings)
        certificate = design_certificate(system)
        proof = prove_certificate(certificate, system)
    else:
        given = [
            name
            for name, value in (("out", out), ("set", settings), *words.items())
            if value and name not in ("lqr", "inversion")
        ]
        if given:
            fix = f"leave --{given[0]} out, or leave --check out"
            raise InputError(f"--{given[0]}", "cannot be combined with --check", fix=fix)
        certificate, written = read_certificate(check)
        about = {n: _split(certificate.about.get(n, "")) for n in (*LISTS, "set")}
        own = dict(text.split("=", 1) for text in about.pop("set"))
        proof = prove_certificate(certificate, build_gain_system(vehicle, about, own), written)
    files = [write_text(out, certificate_json(certificate))] if out is not None and proof.holds else []
    if as_json:
        print_json(_gain_json(certificate, proof), files)
    else:
        _print_gain(certificate, proof)
        print_files(files)
    return proof.holds


def gain_vehicle(system: str | None, check: Path | None) -> str | None:
    """Return the typed vehicle, or else the scenario named in the gain file; None if `check` is not a gain file."""
    try:
        certificate = None if check is None else read_certificate(check)[0]
    except InputError:
        return None
    if certificate is None or "vehicle" not in certificate.about:
        return None
    named = certificate.system
    if system is None and named not in catalogue.scenario_names():
        problem = f"the gain is for {named!r}, which is not in the catalogue"
        raise InputError(
            "--check", problem, fix=f"if it is your own, name its file:  trimtab design {named} --check FILE"
        )
    return system or named


def build_gain_system(vehicle: str, words: Mapping[str, Iterable[str]], settings: Mapping[str, str]) -> CertifiedSystem:
    """Return the certified system of a vehicle at a trim, with weights from limits.

    words: "at", conditions of the trim; "limit", largest acceptable values of states and inputs; "integrate", largest
    acceptable integrals of errors; "assume", settings of the vehicle model for the design; "fast", fast states that
    are not fed back.  settings: settings of the scenario.
    """
    lists = {n: tuple(words.get(n, ())) for n in LISTS}
    plant = load_plant(vehicle, dict(settings), assumed=vehicle_settings(_pairs("--assume", lists["assume"])))
    point = find_point(plant, lists["at"]).require_trim("trim")
    whole = linearise_at(plant, point)
    fast = _expand(whole.states, "--fast", lists["fast"])
    linear = whole.settle(fast) if fast else whole
    limits = _amounts(plant, linear.states, linear.inputs, "--limit", lists["limit"])
    integrals = _amounts(plant, linear.states, (), "--integrate", lists["integrate"])
    named = [n for n in (*limits, *integrals) if n in linear.states]
    idle = idle_states(plant.error(point.x, point.u), plant.units) | plant.places
    linear = linear.part(states=fed_back_states(linear, idle, named))
    _refuse_lacking_limits((*linear.inputs, *linear.states), limits)
    about: dict[str, Setting] = {n: "; ".join(lists[n]) for n in LISTS}
    about["set"] = "; ".join(f"{path}={text}" for path, text in settings.items())
    about |= plant.about
    numbers = zip((*plant.model.states, *plant.model.inputs), (*point.x, *point.u), strict=True)
    kinds = (STATE,) * len(point.x) + (INPUT,) * len(point.u)
    for kind, (name, value) in zip(kinds, numbers, strict=True):
        about[f"{kind}{name}"] = 0.0 if abs(value) < ZERO else float(value)
    system = weigh_by_limits(vehicle, linear, limits, integrals, about)
    return system._replace(numbers=lambda K: fast_numbers(whole, linear.states, fast, integrals, K)) if fast else system


def fast_numbers(
    whole: LinearModel, slow: Sequence[str], fast: Sequence[str], integrals: Iterable[str], K: Any
) -> dict[str, LimitedNumber]:
    """Return the slowest pole of the loop, including the fast states, which the gain K (m, n) does not feed back."""
    linear = whole.part(states=[*slow, *fast])
    A, B = augment_integrals(linear.A, linear.B, [linear.states.index(n) for n in integrals])
    gain = np.hstack([K[:, : len(slow)], np.zeros((len(K), len(fast))), K[:, len(slow) :]])
    largest = float(np.linalg.eigvals(A + B @ gain).real.max())
    how = f"largest real part (1/s) of A + B K, including the fast states {', '.join(fast)}"
    return {"loop with fast states": LimitedNumber(largest, -np.inf, 0.0, how, 1e-6)}


def _amounts(
    plant: Plant, states: Iterable[str], inputs: Iterable[str], option: str, words: Iterable[str]
) -> dict[str, float]:
    known = (*states, *inputs)
    amounts: dict[str, float] = {}
    for field, text in _pairs(option, words):
        for name in _expand(known, option, (field,)):
            amounts[name] = parse_amount(plant, f"{option} {field}", text, name)
    return amounts


def _refuse_lacking_limits(names: Iterable[str], limits: Mapping[str, float]) -> None:
    """Raise InputError for states and inputs without a limit. An array without any limit is named once."""
    names = tuple(names)
    fields = {n: re.sub(r"(\[\d+\]|\.\w+)$", "", n) for n in names if not n.startswith("u.")}
    lacking: list[str] = []
    for name in [n for n in names if n not in limits]:
        field = fields.get(name, name)
        whole = [n for n in names if fields.get(n, n) == field]
        word = name if any(n in limits for n in whole) else field
        lacking += [] if word in lacking else [word]
    if lacking:
        words = " ".join(f"--limit {n}=NUMBER" for n in lacking)
        fix = f"{words}  (largest acceptable value); or --fast NAME for a fast, unmeasured state"
        raise InputError("--limit", f"every state and input needs a limit; missing: {', '.join(lacking)}", fix=fix)


def _expand(known: Iterable[str], option: str, words: Iterable[str]) -> list[str]:
    """Return the states and inputs with the typed names. An array's name, e.g. ``rate``, stands for all elements."""
    names: list[str] = []
    for word in words:
        meant = [n for n in known if n == word] or [n for n in known if n.startswith((f"{word}[", f"{word}."))]
        if not meant:
            fix = f"{option} NAME=…" if option != "--fast" else "--fast NAME"
            raise InputError(f"{option} {word}", "no such state or input", choices=tuple(known), fix=fix)
        names += meant
    return names


def _pairs(option: str, words: Iterable[str]) -> list[tuple[str, str]]:
    pairs = []
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not text.strip():
            raise InputError(option, f"{word!r} is not NAME=VALUE", fix=f"{option} NAME=VALUE")
        pairs.append((name.strip(), text.strip()))
    return pairs


def _split(text: Setting) -> tuple[str, ...]:
    return tuple(word for word in str(text).split("; ") if word)


def _gain_json(certificate: Certificate, proof: CertificateProof) -> dict[str, Any]:
    return {
        "vehicle": certificate.system,
        "about": certificate.about,
        "states": certificate.states,
        "inputs": certificate.inputs,
        "K": certificate.K.tolist(),
        "poles": [[p.real, p.imag] for p in certificate.poles.tolist()],
        "holds": proof.holds,
        "conditions": [c._asdict() for c in proof.conditions],
    }


def _print_gain(certificate: Certificate, proof: CertificateProof) -> None:
    table = new_table("gain, u = u0 + K e", *(f">{n}" for n in certificate.inputs))
    click.echo(show_controls(certificate.system))
    for name, column in zip(certificate.states, certificate.K.T, strict=True):
        table.add_row(name, *(f"{v:.6g}" for v in column))
    print_table(table)
    poles = [p for p in certificate.poles if p.imag >= 0]
    texts = [f"{p.real:.4g}" + (f" ± {p.imag:.4g}i" if p.imag else "") for p in poles]
    click.echo("poles of A + B K (1/s): " + ", ".join(texts))
    failed = [c for c in proof.conditions if not c.holds]
    click.echo(f"{len(proof.conditions) - len(failed)} of {len(proof.conditions)} conditions proved exactly")
    for c in failed:
        click.echo(show_controls(f"  NOT proved: {c.name}: {c.number:.6g} {c.meaning}; {c.why}"))

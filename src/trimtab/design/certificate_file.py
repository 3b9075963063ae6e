"""Certificate files: JSON text that contains only data. Each float is written so that it is read back exactly.

Missing, duplicate or unknown keys, values that are not numbers, and implausibly large numbers are rejected.
`certified_system` compares a certificate with its system.

Source: this module.
"""

import hashlib
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text
from trimtab.design.certificate import METHODS, Certificate, ObserverPart

FORMAT = "trimtab certificate 2"
SCOPE = (
    "local: the proof is about the linear model of the named system at its trim point",
    "continuous time, except where a condition says sampled",
    "not valid while an input saturates",
)
LARGEST = 1e50
"""Largest accepted absolute value of a number in a certificate file."""
FIX = (
    "trimtab design hypersonic --out certificate.json  writes a certificate, "
    "trimtab design VEHICLE --lqr … --out gain.json  writes a gain"
)


def certificate_json(certificate: Certificate) -> str:
    """Return the certificate as JSON text. Each float has the fewest digits that are read back as the same float."""
    content = {"format": FORMAT, "scope": SCOPE} | _as_plain(certificate) | {"digest": certificate_digest(certificate)}
    return _join_matrix_rows(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)) + "\n"


def certificate_digest(certificate: Certificate) -> str:
    """Return the SHA-256 of the certificate, which reveals accidental changes. The proof does not depend on the
    digest."""
    text = json.dumps(_as_plain(certificate), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _as_plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):
        return {n: _as_plain(v) for n, v in value._asdict().items()}
    if isinstance(value, dict):
        return {n: _as_plain(v) for n, v in value.items()}
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return [[float(v.real), float(v.imag)] for v in value]
        return value.tolist()
    return value


def _join_matrix_rows(text: str) -> str:
    """Return JSON text with each row of a matrix on one line, for readability."""
    lines, row = [], ""
    for line in text.split("\n"):
        inner = line.strip()
        if inner == "[" or inner.endswith(": ["):
            if row:
                lines.append(row)
            row = line
        elif row and inner in ("]", "],"):
            lines.append(row + inner)
            row = ""
        elif row:
            row += inner + (" " if inner.endswith(",") else "")
        else:
            lines.append(line)
    return "\n".join(lines)


def read_certificate(path: str | Path) -> tuple[Certificate, str]:
    """Return the certificate in a file, and the digest stored with the certificate."""
    try:
        text = read_user_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"file '{path}'", f"cannot be read: {reason}", fix=FIX) from error
    return parse_certificate(text, str(path))


def parse_json(text: str, name: str) -> Any:
    """Parse JSON text in which every key occurs once and every number is finite.

    Args:
        text: content of the file.
        name: name of the file, for errors.
    """
    try:
        return json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_refuse_doubles)
    except (ValueError, RecursionError) as error:
        raise InputError(f"file '{name}'", f"is not valid JSON: {error}", fix=FIX) from error


def parse_certificate(text: str, name: str) -> tuple[Certificate, str]:
    """Return the certificate in a text, and the digest stored with the certificate.

    Args:
        text: content of the file.
        name: name of the file, for errors.
    """
    content = parse_json(text, name)
    form = content.get("format") if isinstance(content, dict) else type(content).__name__
    if form != FORMAT:
        older = form == "trimtab certificate 1"  # a file of this older format contained its own conditions and limits
        fix = f"trimtab design hypersonic --out {name}  writes a new one" if older else FIX
        raise InputError(f"file '{name}'", f"is not a certificate; its format is {form!r}", choices=(FORMAT,), fix=fix)
    try:
        _check_keys(content, ("format", "scope", "digest", *Certificate._fields), "", name)
        if content["scope"] != list(SCOPE):
            raise InputError(f"file '{name}', scope", f"must be {list(SCOPE)}, got {content['scope']}", fix=FIX)
        return _parse_fields(content, name), _parse_text(content["digest"], "digest", name)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"file '{name}'", f"is not a valid certificate: {error}", fix=FIX) from error


def _parse_fields(c: dict[str, Any], name: str) -> Certificate:
    states, inputs = _parse_names(c["states"], "states", name), _parse_names(c["inputs"], "inputs", name)
    n, m = len(states), len(inputs)
    if c["method"] not in METHODS or (c["method"] == "lqr") != (c["Q"] is not None):
        raise InputError(
            f"file '{name}', method",
            f"must be 'lqr' with a matrix Q, or 'lmi' with Q = null, got {c['method']!r} "
            f"with Q {'= null' if c['Q'] is None else 'given'}",
            choices=METHODS,
            fix=FIX,
        )
    shapes = {"A": (n, n), "B": (n, m), "K": (m, n), "P": (n, n), "Qe": (n, n), "Re": (m, m), "scale": (n,)}
    if c["Q"] is not None:
        shapes["Q"] = (n, n)
    arrays = {key: _parse_array(c[key], shape, key, name) for key, shape in shapes.items()}
    if not (arrays["scale"] > 0).all():
        raise InputError(
            f"file '{name}', scale", f"all sizes of the states must be above 0, got {arrays['scale']}", fix=FIX
        )
    about = {k: v if isinstance(v, str) else _parse_number(v, f"about.{k}", name) for k, v in c["about"].items()}
    version = _parse_text(c["version"], "version", name)
    if not re.fullmatch(r"\d+\.\d+[\w.+]*", version):
        raise InputError(f"file '{name}', version", f"must be a version such as 0.1.0, got {version!r}", fix=FIX)
    return Certificate(
        system=_parse_text(c["system"], "system", name),
        about=about,
        method=c["method"],
        states=states,
        inputs=inputs,
        poles=_parse_poles(c["poles"], n, "poles", name),
        observer=None if c["observer"] is None else _parse_observer(c["observer"], states, name),
        recorded={k: _parse_number(v, f"recorded.{k}", name) for k, v in c["recorded"].items()},
        version=version,
        **({"Q": None} | arrays),
    )


def _parse_observer(o: dict[str, Any], states: tuple[str, ...], name: str) -> ObserverPart:
    _check_keys(o, ObserverPart._fields, "observer.", name)
    estimated = _parse_names(o["estimated"], "observer.estimated", name)
    unknown = [s for s in estimated if s not in states]
    if unknown:
        raise InputError(f"file '{name}', observer.estimated", f"unknown states {unknown}", choices=states, fix=FIX)
    k, p = len(estimated), len(o["C"])
    shapes = {"A": (k, k), "C": (p, k), "Q": (k, k), "R": (p, p), "P": (k, k), "L": (k, p)}
    arrays = {key: _parse_array(o[key], shape, f"observer.{key}", name) for key, shape in shapes.items()}
    weight, least = (_parse_number(o[key], f"observer.{key}", name) for key in ("weight", "least_weight"))
    poles = _parse_poles(o["poles"], k, "observer.poles", name)
    return ObserverPart(estimated=estimated, weight=weight, least_weight=least, poles=poles, **arrays)


def _check_keys(value: Any, wanted: Iterable[str], where: str, name: str) -> None:
    """Raise InputError if a required key is missing or a key is unknown. An unknown key would be an unchecked claim."""
    wanted = tuple(wanted)
    lacking = [key for key in wanted if key not in value]
    if lacking:
        raise InputError(f"file '{name}'", "lacks " + ", ".join(f"'{where}{k}'" for k in lacking), fix=FIX)
    unknown = [key for key in value if key not in wanted]
    if unknown:
        raise InputError(f"file '{name}'", f"has the unknown key {where}{unknown[0]!r}", choices=wanted, fix=FIX)


def _parse_text(value: Any, key: str, name: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"file '{name}', {key}", f"must be text, got {value!r}", fix=FIX)
    return value


def _parse_names(value: Any, key: str, name: str) -> tuple[str, ...]:
    names = tuple(value) if isinstance(value, list) else ()
    if not names or len(set(names)) != len(names) or not all(isinstance(v, str) for v in names):
        raise InputError(f"file '{name}', {key}", f"must be a list of different names, got {value}", fix=FIX)
    return names


def _parse_number(value: Any, key: str, name: str) -> float:
    return float(_parse_array(value, (), key, name))


def _parse_array(value: Any, shape: tuple[int, ...], key: str, name: str) -> Any:
    """Convert a list of JSON numbers to an array; raise InputError for a text, a boolean or a wrong shape."""
    array = np.array(value, object)
    if array.shape != shape or not all(type(v) in (int, float) for v in array.ravel()):
        raise InputError(f"file '{name}', {key}", f"must be numbers of shape {shape}, got shape {array.shape}", fix=FIX)
    array = array.astype(float)
    if not (np.abs(array) <= LARGEST).all():
        raise InputError(f"file '{name}', {key}", f"the magnitude of a number is larger than {LARGEST:g}", fix=FIX)
    return array


def _parse_poles(value: Any, n: int, key: str, name: str) -> Any:
    parts = _parse_array(value, (n, 2), key, name)
    return parts[:, 0] + 1j * parts[:, 1]


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a number")


def _refuse_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(k for k in keys if keys.count(k) > 1)!r} appears twice")
    return content

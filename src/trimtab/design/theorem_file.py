"""Files of theorem certificates: JSON text that contains only data. Polynomials are stored as text, and numbers as
fractions.

The content of a file is never executed. Missing, duplicate or unknown keys are rejected.

Source: this module.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from trimtab import __version__
from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text
from trimtab.design.certificate_file import parse_json
from trimtab.design.certified_system import Setting
from trimtab.design.gram_search import find_gram_proof
from trimtab.design.polynomial import Polynomial, constant, parse_polynomial
from trimtab.design.squares import Claim, GramForm, SquaresProof, Term, WeightedSquares, complete_squares
from trimtab.design.theorem import LawTheorem, TheoremCertificate, claims_of

FORMAT = "trimtab theorem 1"
SCOPE = (
    "the code of the vehicle and of the law, in an ideal loop: no delay, no noise, no saturation",
    "continuous time",
    "each number has exactly the decimals in which it is written",
)
FIX = "trimtab design hovercraft/forward --out certificate.json  writes a certificate"
KEYS = ("format", "scope", "theorem", "about", "says", "lyapunov", "level", "proofs", "version", "digest")
FRACTION = re.compile(r"-?\d{1,400}(/\d{1,400})?")


def design_theorem(
    theorem: LawTheorem, lyapunov: Polynomial | None = None, level: Fraction | None = None, **proofs: SquaresProof
) -> TheoremCertificate:
    """Create a certificate of a theorem. Proofs that are not given are searched for.

    Args:
        theorem: the theorem to prove.
        lyapunov: Lyapunov function V, if the law does not provide it.
        level: level of V at the edge of the region, if the theorem is about a region.
        proofs: known proofs, by name of the claim.
    """
    V = theorem.lyapunov if lyapunov is None else lyapunov
    known = {**theorem.proofs, **proofs}
    for claim in claims_of(theorem, V, level):
        if claim.name not in known:
            with suppress(ArithmeticError):  # prove_theorem then reports that the proof is missing
                known[claim.name] = _complete_proof(claim, theorem)
    return TheoremCertificate(theorem.name, theorem.about, theorem.says, V, level, known, __version__)


def _complete_proof(claim: Claim, theorem: LawTheorem) -> SquaresProof:
    """Prove a claim by Gram matrices, if the theorem has a search for this claim, or by completing squares.

    Raises: ArithmeticError if no proof is found.
    """
    if claim.name in theorem.searches:
        return find_gram_proof(claim, theorem.searches[claim.name])
    weights = theorem.multipliers.get(claim.name, {})
    held = tuple(WeightedSquares(name, (weight,), (constant(1),)) for name, weight in weights.items())
    left = sum((-weight * claim.hypotheses[name] for name, weight in weights.items()), claim.conclusion)
    return SquaresProof(constant(1), (*held, complete_squares(left, theorem.region)))


def theorem_json(certificate: TheoremCertificate) -> str:
    """Return a theorem's certificate as JSON text."""
    content = {"format": FORMAT, "scope": SCOPE} | _as_plain(certificate) | {"digest": theorem_digest(certificate)}
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def theorem_digest(certificate: TheoremCertificate) -> str:
    """Return the SHA-256 of a theorem's certificate, which reveals accidental changes. No proof depends on the
    digest."""
    return hashlib.sha256(json.dumps(_as_plain(certificate), sort_keys=True).encode()).hexdigest()


def parse_theorem(text: str, name: str) -> tuple[TheoremCertificate, str]:
    """Return the certificate in a text, and the digest stored with the certificate; raise InputError for any other
    text."""
    content = parse_json(text, name)
    form = content.get("format") if isinstance(content, dict) else type(content).__name__
    if form != FORMAT:
        raise InputError(
            f"file '{name}'", f"is not a theorem's certificate; its format is {form!r}", choices=(FORMAT,), fix=FIX
        )
    _check_keys(content, KEYS, name)
    if content["scope"] != list(SCOPE):
        raise InputError(f"file '{name}', scope", f"must be {list(SCOPE)}, got {content['scope']}", fix=FIX)
    V, level, proofs = content["lyapunov"], content["level"], content["proofs"]
    if not isinstance(proofs, dict):
        raise InputError(f"file '{name}', proofs", f"must be a JSON object with the proofs, got {proofs!r}", fix=FIX)
    certificate = TheoremCertificate(
        _parse_text(content["theorem"], f"file '{name}', theorem"),
        _parse_about(content["about"], f"file '{name}', about"),
        _parse_text(content["says"], f"file '{name}', says"),
        None if V is None else _parse_polynomial(V, f"file '{name}', lyapunov"),
        None if level is None else _parse_fraction(level, f"file '{name}', level"),
        {claim: _parse_proof(proof, f"file '{name}', proofs, {claim}") for claim, proof in proofs.items()},
        _parse_text(content["version"], f"file '{name}', version"),
    )
    return certificate, _parse_text(content["digest"], f"file '{name}', digest")


def read_text(path: Path) -> str:
    """Return the text of a file; raise InputError if it can't be read."""
    try:
        return read_user_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"file '{path}'", f"cannot be read: {reason}", fix=FIX) from error


def _as_plain(value: Any) -> Any:
    if isinstance(value, GramForm):
        return {"times": value.times, "forms": _as_plain(value.forms), "gram": _as_plain(value.matrix.tolist())}
    if isinstance(value, WeightedSquares):
        pairs = zip(value.weights, value.forms, strict=True)
        return {"times": value.times, "squares": [[str(w), str(f)] for w, f in pairs]}
    if isinstance(value, Polynomial | Fraction):
        return str(value)
    if hasattr(value, "_asdict"):
        return {n: _as_plain(v) for n, v in value._asdict().items()}
    if isinstance(value, Mapping):
        return {n: _as_plain(v) for n, v in value.items()}
    if isinstance(value, list | tuple):
        return [_as_plain(v) for v in value]
    return value


def _parse_proof(value: Any, part: str) -> SquaresProof:
    _check_keys(value, ("scale", "terms"), part)
    if not isinstance(value["terms"], list):
        raise InputError(part, "the proof's terms must be a list", fix=FIX)
    return SquaresProof(_parse_polynomial(value["scale"], part), tuple(_parse_term(t, part) for t in value["terms"]))


def _parse_term(value: Any, part: str) -> Term:
    if not isinstance(value, dict):
        raise InputError(part, f"must be a term (a JSON object), got {value!r}", fix=FIX)
    if "gram" not in value:
        _check_keys(value, ("times", "squares"), part)
        pairs = [tuple(_parse_polynomial(p, part) for p in _parse_list(pair, part, 2)) for pair in value["squares"]]
        weights, forms = zip(*pairs, strict=True) if pairs else ((), ())
        return WeightedSquares(_parse_text(value["times"], part), weights, forms)
    _check_keys(value, ("times", "forms", "gram"), part)
    forms = tuple(_parse_polynomial(p, part) for p in _parse_list(value["forms"], part))
    rows = [
        [_parse_fraction(v, part) for v in _parse_list(row, part, len(forms))]
        for row in _parse_list(value["gram"], part, len(forms))
    ]
    matrix = np.empty((len(forms),) * 2, object)
    for i, row in enumerate(rows):
        matrix[i] = row
    return GramForm(_parse_text(value["times"], part), forms, matrix)


def _parse_list(value: Any, part: str, length: int | None = None) -> list[Any]:
    if not isinstance(value, list) or not value or (length is not None and len(value) != length):
        wanted = "at least 1 entry" if length is None else f"{length} entries"
        raise InputError(part, f"must be a list of {wanted}, got {str(value)[:60]}", fix=FIX)
    return value


def _parse_polynomial(text: Any, part: str) -> Polynomial:
    names = re.findall(r"[A-Za-z_]\w*", text) if isinstance(text, str) else ()
    return parse_polynomial(text, part, sorted(set(names)))


def _parse_fraction(text: Any, part: str) -> Fraction:
    if not isinstance(text, str) or not FRACTION.fullmatch(text) or re.search(r"/0+$", text):
        raise InputError(part, f"must be a fraction such as '13/5', got {str(text)[:60]!r}", fix=FIX)
    return Fraction(text)


def _parse_text(value: Any, part: str) -> str:
    if not isinstance(value, str):
        raise InputError(part, f"must be text, got {value!r}", fix=FIX)
    return value


def _parse_about(value: Any, part: str) -> dict[str, Setting]:
    if not isinstance(value, dict) or not all(type(v) in (int, float, str) for v in value.values()):
        raise InputError(part, f"must map names of settings to numbers or texts, got {value!r}", fix=FIX)
    return value


def _check_keys(value: Any, wanted: Iterable[str], part: str) -> None:
    """Raise InputError if a required key is missing or a key is unknown. An unknown key would be an unchecked claim."""
    wanted = tuple(wanted)
    if not isinstance(value, dict) or set(value) != set(wanted):
        there = sorted(value) if isinstance(value, dict) else type(value).__name__
        raise InputError(f"file '{part}'", f"must have exactly the listed keys, got {there}", choices=wanted, fix=FIX)

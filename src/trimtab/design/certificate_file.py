"""From the text of a certificate to the certificate: everything in it is data, and is refused where it does not fit.

Source: this module.
"""

import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from trimtab.core.errors import InputError
from trimtab.design.certificate import FORMAT, Certificate, ObserverPart, Recorded

METHODS = ("lqr", "lmi")
FIX = "trimtab design hypersonic --out certificate.json  writes one"


def read(path: str | Path) -> tuple[Certificate, str]:
    """A certificate, and the digest that is written beside it."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise InputError(f"file '{path}'", f"cannot be read: {reason}", fix=FIX) from error
    return parsed(text, str(path))


def parsed(text: str, name: str) -> tuple[Certificate, str]:
    """The certificate, and the digest that is written beside it.

    Args:
        text: of the file.
        name: of the file, for errors.
    """
    try:
        content = json.loads(text, parse_constant=_refuse_constant)
    except ValueError as error:
        raise InputError(f"file '{name}'", f"is no JSON: {error}", fix=FIX) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise InputError(f"file '{name}'", f"is no certificate: format {found!r}", choices=(FORMAT,), fix=FIX)
    try:
        return _certificate(content, name), str(content["digest"])
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        what = f"lacks {error}" if isinstance(error, KeyError) else f"holds what is no certificate: {error}"
        raise InputError(f"file '{name}'", what, fix=FIX) from error


def _certificate(c: dict[str, Any], name: str) -> Certificate:
    states, inputs = _names(c["states"], "states", name), _names(c["inputs"], "inputs", name)
    n, m = len(states), len(inputs)
    if c["method"] not in METHODS or (c["method"] == "lqr") != (c["Q"] is not None):
        raise InputError(f"file '{name}', method", f"{c['method']!r}", choices=METHODS, fix=FIX)
    shapes = {"A": (n, n), "B": (n, m), "K": (m, n), "P": (n, n), "Qe": (n, n), "Re": (m, m), "scale": (n,)}
    if c["Q"] is not None:
        shapes["Q"] = (n, n)
    arrays = {key: _array(c[key], shape, key, name) for key, shape in shapes.items()}
    if not (arrays["scale"] > 0).all():
        raise InputError(f"file '{name}', scale", f"{arrays['scale']}", fix="sizes are above 0; " + FIX)
    return Certificate(
        system=str(c["system"]),
        about=dict(c["about"]),
        method=c["method"],
        states=states,
        inputs=inputs,
        poles=_poles(c["poles"], n, "poles", name),
        observer=None if c["observer"] is None else _observer(c["observer"], states, name),
        recorded={k: _recorded(v, k, name) for k, v in c["recorded"].items()},
        version=str(c["version"]),
        **({"Q": None} | arrays),
    )


def _observer(o: dict[str, Any], states: tuple[str, ...], name: str) -> ObserverPart:
    estimated = _names(o["estimated"], "observer.estimated", name)
    unknown = [s for s in estimated if s not in states]
    if unknown:
        raise InputError(f"file '{name}', observer.estimated", f"{unknown}", choices=states, fix=FIX)
    k, p = len(estimated), len(o["C"])
    shapes = {"A": (k, k), "C": (p, k), "Q": (k, k), "R": (p, p), "P": (k, k), "L": (k, p)}
    arrays = {key: _array(o[key], shape, f"observer.{key}", name) for key, shape in shapes.items()}
    weight, least = (float(_array(o[key], (), f"observer.{key}", name)) for key in ("weight", "least_weight"))
    poles = _poles(o["poles"], k, "observer.poles", name)
    return ObserverPart(estimated=estimated, weight=weight, least_weight=least, poles=poles, **arrays)


def _recorded(value: dict[str, Any], key: str, name: str) -> Recorded:
    v, low, high = (float(_array(value[n], (), f"recorded.{key}.{n}", name)) for n in ("value", "low", "high"))
    return Recorded(v, low, high, str(value["how"]))


def _names(value: Any, key: str, name: str) -> tuple[str, ...]:
    made = tuple(str(v) for v in value)
    if not made or len(set(made)) != len(made) or isinstance(value, str):
        raise InputError(f"file '{name}', {key}", f"{value}", fix="names, each once; " + FIX)
    return made


def _array(value: Any, shape: tuple[int, ...], key: str, name: str) -> Any:
    made = np.array(value, float)
    if made.shape != shape or not np.isfinite(made).all():
        raise InputError(f"file '{name}', {key}", f"shape {made.shape}, wanted {shape}, finite", fix=FIX)
    return made


def _poles(value: Any, n: int, key: str, name: str) -> Any:
    made = _array(value, (n, 2), key, name)
    return made[:, 0] + 1j * made[:, 1]


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")

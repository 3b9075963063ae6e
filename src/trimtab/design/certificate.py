"""A gain with all that is needed to prove it again: matrices, weights, what is claimed, and how it was found.

`build_certificate` makes one, `certificate_json` and `read_certificate` keep it in a file of text without losing a
digit, and `certificate_check.prove_certificate` proves it, without the solver that found it. A certificate speaks of
the linear model that is in it: near the point, in continuous time, and not while an input saturates. All in a file is
data, and is refused where it does not fit.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 14, 15, corrected as in `composite`.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from trimtab import __version__
from trimtab.core.errors import InputError
from trimtab.design import composite
from trimtab.design.lqr import KalmanBucy
from trimtab.design.poles import sorted_poles

FORMAT = "trimtab certificate 1"
ABOVE = 1.01
"""The weight of the Lyapunov function is this many times the least one."""
SCOPE = (
    "local: the linear model in it, at its point",
    "continuous time: not the sampled loop",
    "void while an input saturates",
)
METHODS = ("lqr", "lmi")
FIX = "trimtab design hypersonic --out certificate.json  writes one"


class RecordedNumber(NamedTuple):
    """A number that was computed when the certificate was made, and is not computed again.

    value: must be at least low, and below high.  how: over which grid, by what.
    """

    value: float
    low: float
    high: float
    how: str


class ObserverPart(NamedTuple):
    """The filter of some of the states.

    estimated: names of these states.  A: A_eta (k, k).  C: (p, k).  Q: Q_eta (k, k).  R: (p, p).  P: P_eta (k, k).
    L: (k, p).  weight: of the observer's part of the Lyapunov function.  least_weight: lambda*, above which (15) holds.
    poles: of A - L C (k,).
    """

    estimated: tuple[str, ...]
    A: Any
    C: Any
    Q: Any
    R: Any
    P: Any
    L: Any
    weight: float
    least_weight: float
    poles: Any


class Certificate(NamedTuple):
    """v = +K e, and its proof.

    system: what it is for, as `trimtab design SYSTEM` names it.  about: settings and point, name -> number or text.
    method: "lqr" or "lmi".  states, inputs: names.  A: (n, n).  B: (n, m).  K: (m, n).  P: (n, n).  Qe: (n, n) and
    Re: (m, m), the weights in (14).  Q: weight of the regulator (n, n), None for other methods.  scale: sizes of the
    states (n,).  poles: of A + B K (n,).  observer: None where the whole state is measured.  recorded: name ->
    RecordedNumber.  version: of this package.
    """

    system: str
    about: dict[str, float | str]
    method: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    A: Any
    B: Any
    K: Any
    P: Any
    Qe: Any
    Re: Any
    Q: Any
    scale: Any
    poles: Any
    observer: ObserverPart | None
    recorded: dict[str, RecordedNumber]
    version: str = __version__

    def feedback_matrices(self) -> composite.Feedback:
        """What the conditions are made of, in floats."""
        return composite.Feedback(self.A, self.B, self.K, self.P, self.Qe, np.linalg.inv(self.Re))

    def estimated_indices(self) -> Any:
        """Where the estimated states are in e (k,)."""
        return np.array([self.states.index(n) for n in self.observer.estimated] if self.observer else [], int)

    def observer_matrices(self, o: ObserverPart) -> composite.Observer:
        """The same of the observer."""
        return composite.Observer(o.A, o.C, o.Q, o.P, o.L, np.linalg.inv(o.R), self.estimated_indices())


def build_certificate(
    system: str,
    matrices: tuple[Any, Any],
    gain: tuple[Any, Any],
    weights: tuple[Any, Any],
    *,
    states: Sequence[str],
    inputs: Sequence[str],
    method: str,
    Q: Any = None,
    scale: Any = None,
    observer: tuple[Sequence[str], Any, Any, Any, Any, KalmanBucy] | None = None,
    recorded: Mapping[str, RecordedNumber] | None = None,
    about: Mapping[str, float | str] | None = None,
) -> Certificate:
    """Put a certificate together; nothing is proved yet, see `certificate_check.prove_certificate`.

    Args:
        system: what it is for.
        matrices: A (n, n), B (n, m).
        gain: K (m, n) and P (n, n), of `lqr` or `lmi_gain`.
        weights: Q_e (n, n), R_e (m, m), of (14).
        states: n names.
        inputs: m names.
        method: "lqr" or "lmi".
        Q: the regulator's weight (n, n), for "lqr".
        scale: sizes of the states (n,), 1 where not given.
        observer: names of the estimated states, A_eta, C, Q_eta, R, and the filter.
        recorded: further numbers, each with limits.
        about: settings and point.
    """
    A, B, K, P, Qe, Re = (np.atleast_2d(np.asarray(M, float)) for M in (*matrices, *gain, *weights))
    d = np.ones(len(A)) if scale is None else np.asarray(scale, float)
    certificate = Certificate(
        system=system,
        about=dict(about or {}),
        method=method,
        states=tuple(states),
        inputs=tuple(inputs),
        A=A,
        B=B,
        K=K,
        P=(P + P.T) / 2,
        Qe=Qe,
        Re=Re,
        Q=None if Q is None else np.atleast_2d(np.asarray(Q, float)),
        scale=d,
        poles=sorted_poles((A + B @ K) * d / d[:, None]),
        observer=None,
        recorded=dict(recorded or {}),
    )
    return certificate if observer is None else _add_observer(certificate, *observer)


def _add_observer(
    certificate: Certificate, estimated: Sequence[str], A: Any, C: Any, Q: Any, R: Any, kalman: KalmanBucy
) -> Certificate:
    """With the filter, and the weight that suits the feedback."""
    A, C, Q, R = (np.atleast_2d(np.asarray(M, float)) for M in (A, C, Q, R))
    part = ObserverPart(tuple(estimated), A, C, Q, R, kalman.P, kalman.L, 1.0, 0.0, kalman.poles)
    certificate = certificate._replace(observer=part)
    feedback, observer = certificate.feedback_matrices(), certificate.observer_matrices(part)
    least = composite.least_weight(feedback, observer)
    falls = [composite.least_decrease_weight(feedback, observer, r) for r in (0.0, 0.5, -0.5)]
    finite = [w for w in (least, *falls) if np.isfinite(w)]
    weight = ABOVE * max(finite) if finite else 1.0
    return certificate._replace(observer=part._replace(weight=weight, least_weight=least))


def certificate_json(certificate: Certificate) -> str:
    """The certificate as text; floats by their shortest digits that give the same float again."""
    content = {"format": FORMAT, "scope": SCOPE} | _as_plain(certificate) | {"digest": certificate_digest(certificate)}
    return _join_matrix_rows(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)) + "\n"


def certificate_digest(certificate: Certificate) -> str:
    """SHA-256 of all that the certificate says, against changes by accident; the proof does not rest on it."""
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
    """Rows of numbers on one line each, for reading."""
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
    """A certificate, and the digest that is written beside it."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise InputError(f"file '{path}'", f"cannot be read: {reason}", fix=FIX) from error
    return parse_certificate(text, str(path))


def parse_certificate(text: str, name: str) -> tuple[Certificate, str]:
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
        form = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise InputError(f"file '{name}'", f"is no certificate: format {form!r}", choices=(FORMAT,), fix=FIX)
    try:
        return _parse_fields(content, name), str(content["digest"])
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        what = f"lacks {error}" if isinstance(error, KeyError) else f"holds what is no certificate: {error}"
        raise InputError(f"file '{name}'", what, fix=FIX) from error


def _parse_fields(c: dict[str, Any], name: str) -> Certificate:
    states, inputs = _parse_names(c["states"], "states", name), _parse_names(c["inputs"], "inputs", name)
    n, m = len(states), len(inputs)
    if c["method"] not in METHODS or (c["method"] == "lqr") != (c["Q"] is not None):
        raise InputError(f"file '{name}', method", f"{c['method']!r}", choices=METHODS, fix=FIX)
    shapes = {"A": (n, n), "B": (n, m), "K": (m, n), "P": (n, n), "Qe": (n, n), "Re": (m, m), "scale": (n,)}
    if c["Q"] is not None:
        shapes["Q"] = (n, n)
    arrays = {key: _parse_array(c[key], shape, key, name) for key, shape in shapes.items()}
    if not (arrays["scale"] > 0).all():
        raise InputError(f"file '{name}', scale", f"{arrays['scale']}", fix="sizes are above 0; " + FIX)
    return Certificate(
        system=str(c["system"]),
        about=dict(c["about"]),
        method=c["method"],
        states=states,
        inputs=inputs,
        poles=_parse_poles(c["poles"], n, "poles", name),
        observer=None if c["observer"] is None else _parse_observer(c["observer"], states, name),
        recorded={k: _parse_recorded_number(v, k, name) for k, v in c["recorded"].items()},
        version=str(c["version"]),
        **({"Q": None} | arrays),
    )


def _parse_observer(o: dict[str, Any], states: tuple[str, ...], name: str) -> ObserverPart:
    estimated = _parse_names(o["estimated"], "observer.estimated", name)
    unknown = [s for s in estimated if s not in states]
    if unknown:
        raise InputError(f"file '{name}', observer.estimated", f"{unknown}", choices=states, fix=FIX)
    k, p = len(estimated), len(o["C"])
    shapes = {"A": (k, k), "C": (p, k), "Q": (k, k), "R": (p, p), "P": (k, k), "L": (k, p)}
    arrays = {key: _parse_array(o[key], shape, f"observer.{key}", name) for key, shape in shapes.items()}
    weight, least = (float(_parse_array(o[key], (), f"observer.{key}", name)) for key in ("weight", "least_weight"))
    poles = _parse_poles(o["poles"], k, "observer.poles", name)
    return ObserverPart(estimated=estimated, weight=weight, least_weight=least, poles=poles, **arrays)


def _parse_recorded_number(value: dict[str, Any], key: str, name: str) -> RecordedNumber:
    v, low, high = (float(_parse_array(value[n], (), f"recorded.{key}.{n}", name)) for n in ("value", "low", "high"))
    return RecordedNumber(v, low, high, str(value["how"]))


def _parse_names(value: Any, key: str, name: str) -> tuple[str, ...]:
    names = tuple(str(v) for v in value)
    if not names or len(set(names)) != len(names) or isinstance(value, str):
        raise InputError(f"file '{name}', {key}", f"{value}", fix="names, each once; " + FIX)
    return names


def _parse_array(value: Any, shape: tuple[int, ...], key: str, name: str) -> Any:
    array = np.array(value, float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"file '{name}', {key}", f"shape {array.shape}, wanted {shape}, finite", fix=FIX)
    return array


def _parse_poles(value: Any, n: int, key: str, name: str) -> Any:
    parts = _parse_array(value, (n, 2), key, name)
    return parts[:, 0] + 1j * parts[:, 1]


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")

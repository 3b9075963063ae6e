"""Certified system: a named linear system whose matrices, weights, sizes and limits all come from code.

A certificate file contains the name of its system and the settings. The system is built again from code, and the file's
content is compared with the system entry by entry. Therefore a file can't introduce a plant, a weight, a size or a
limit of its own.

Source: this module.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument
from trimtab.core.suggestions import closest
from trimtab.design.proof import Line, ProofCondition

SAME = 1e-9
"""Largest accepted relative deviation of a matrix entry in a file from the same entry of the system."""
SMALL = 1e-4
"""Smallest divisor in the relative deviation of a matrix element, as a fraction of the largest element in the scaled
row. This limit allows for rounding errors of small elements."""
ANEW = "computed again, in floats"
Setting = float | str


class LimitedNumber(NamedTuple):
    """Computed figure of a system, e.g. a maximum over a grid, with its limits.

    value: the figure, which must be at least low and below high.  how: grid and method of the computation.  near:
    largest accepted difference between value and the figure in a certificate file.
    """

    value: float
    low: float
    high: float
    how: str
    near: float

    @property
    def is_inside(self) -> bool:
        """Return True if the number is within its limits."""
        return self.low <= self.value < self.high


LoopLines = Callable[[Any], Iterable[Line]]
"""Function that takes a certificate with a filter and yields proof conditions on the whole loop."""


class CertifiedSystem(NamedTuple):
    """Linear plant with weights, and optionally a filter of some of its states.

    name: as in `trimtab design NAME`.  about: settings and operating point by name.  method: "lqr" or "lmi".  states
    (n), inputs (m): names.  A: (n, n).  B: (n, m).  Qe: (n, n) and Re: (m, m), the weights in (14).  Q: weight of the
    regulator (n, n), None for "lmi".  scale: sizes of the states (n,).  estimated: names of the k estimated states.  C:
    (p, k), Q_eta: (k, k), R: (p, p): matrices of the filter of these states, None without a filter.  numbers: function
    from the gain K (m, n) to the system's computed figures, by name.  loop_lines: function from a certificate with a
    filter to conditions on the whole loop.
    """

    name: str
    about: dict[str, Setting]
    method: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    A: Any
    B: Any
    Qe: Any
    Re: Any
    Q: Any
    scale: Any
    estimated: tuple[str, ...] = ()
    C: Any = None
    Q_eta: Any = None
    R: Any = None
    numbers: Callable[[Any], Mapping[str, LimitedNumber]] = lambda K: {}
    loop_lines: LoopLines = lambda certificate: ()

    @property
    def A_eta(self) -> Any:
        """Return the block A_eta (k, k) of A for the estimated states. Other effects on these states are known to the
        filter."""
        at = self.estimated_indices()
        return self.A[np.ix_(at, at)]

    def estimated_indices(self) -> Any:
        """Return the indices of the estimated states in e (k,)."""
        return np.array([self.states.index(name) for name in self.estimated], int)


SystemFunction = Callable[..., CertifiedSystem]
"""Function that builds a system from settings. Every setting is a keyword argument with a default."""


def system_settings(function: Callable[..., Any], given: Mapping[str, object], part: str) -> dict[str, Setting]:
    """Return all settings of a system or theorem: the given values, and defaults for the other settings.

    Args:
        function: function that builds the system or theorem from settings.
        given: name -> number or text; numbers may be given as text.
        part: name used in errors.
    """
    settings: dict[str, Setting] = {n: p.default for n, p in inspect.signature(function).parameters.items()}
    for name, value in given.items():
        if name not in settings:
            near = closest(name, settings, 1) or list(settings)[:1]
            fix = argument("settings", "…", near[0]) if near else "remove it; this system has no settings"
            raise InputError(part, f"unknown setting {name!r}", choices=settings, fix=fix)
        settings[name] = _as_setting(value, settings[name], f"{part}, {name}")
    return settings


def _as_setting(value: object, default: Setting, part: str) -> Setting:
    if isinstance(default, str):
        if not isinstance(value, str):
            raise InputError(part, f"must be text, got {value!r}", fix=f"the default is {default!r}")
        return value
    try:
        number = float(value) if isinstance(value, str | float | int) and not isinstance(value, bool) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(part, f"must be a finite number, got {value!r}", fix=f"the default is {default!r}")
    return number


def compare_with_system(certificate: Any, system: CertifiedSystem) -> Iterator[Line]:
    """Yield the conditions that every entry of a certificate's data equals the same entry of the system.

    Args:
        certificate: a `certificate.Certificate`.
        system: the system that the certificate names, built again from code.
    """
    c, s, o = certificate, system, certificate.observer
    estimated = () if o is None else o.estimated
    words = {
        "system": (c.system, s.name),
        "method": (c.method, s.method),
        "states": (c.states, s.states),
        "inputs": (c.inputs, s.inputs),
        "estimated states": (estimated, s.estimated),
    }
    for name, (there, now) in words.items():
        yield _name_line(name, s.name), lambda a=there, b=now: _compare_words(a, b)
    yield _name_line("settings and point", s.name), lambda: _compare_about(c.about, s.about)
    units = 1 / np.sqrt(np.abs(np.diag(s.Re)))
    matrices = {
        "A": (c.A, s.A, s.scale, s.states, s.states),
        "B": (c.B, s.B, units, s.states, s.inputs),
        "Q_e": (c.Qe, s.Qe, s.scale, s.states, s.states),
        "R_e": (c.Re, s.Re, units, s.inputs, s.inputs),
        "Q": (c.Q, s.Q, s.scale, s.states, s.states),
        "scale": (_as_column(c.scale), _as_column(s.scale), np.ones(1), s.states, ("size",)),
    }
    if s.estimated or o is not None:
        size = s.scale[s.estimated_indices()]
        rows = [f"measurement {i + 1}" for i in range(0 if s.C is None else len(s.C))]
        matrices |= {
            "A_eta": (None if o is None else o.A, s.A_eta, size, s.estimated, s.estimated),
            "C": (None if o is None else o.C, s.C, size, rows, s.estimated),
            "Q_eta": (None if o is None else o.Q, s.Q_eta, 1 / size, s.estimated, s.estimated),
            "R": (None if o is None else o.R, s.R, np.ones(len(rows)), rows, rows),
        }
    for name, (there, now, size, rows, columns) in matrices.items():
        line = _name_line(name, s.name)
        yield line, lambda a=there, b=now, d=size, r=rows, k=columns: _compare_matrix(a, b, d, (r, k))


def number_lines(certificate: Any, system: CertifiedSystem) -> Iterator[Line]:
    """Yield the conditions that the system's figures are within limits and equal to the figures in a certificate."""
    written, wanted = certificate.recorded, (len(system.inputs), len(system.states))
    if certificate.K.shape != wanted:
        why = f"the gain must have shape {wanted}, got {certificate.K.shape}"
        yield "numbers of the system", lambda: ProofCondition("", False, math.nan, "not computable", ANEW, why)
        return
    numbers = system.numbers(certificate.K)
    for name, number in numbers.items():
        yield name, lambda n=number: _limits_condition(n)
        yield f"{name}, as recorded", lambda n=number, k=name: _compare_number(n, written.get(k))
    unknown = sorted(set(written) - set(numbers))
    why = "" if not unknown else "unknown: " + ", ".join(unknown)
    yield (
        "no other number recorded",
        lambda: ProofCondition("", not unknown, float(len(unknown)), "unknown numbers", ANEW, why),
    )


def _name_line(name: str, system: str) -> str:
    return f"{name} {'are those' if name.endswith(('states', 'inputs', 'point')) else 'is that'} of {system}"


def _as_column(v: Any) -> Any:
    return np.asarray(v, float)[:, None]


def _compare_words(there: Any, now: Any) -> ProofCondition:
    same = there == now
    return ProofCondition("", same, float(not same), "differences", "text", "" if same else f"{there}, must be {now}")


def _compare_about(there: Mapping[str, Setting], now: Mapping[str, Setting]) -> ProofCondition:
    def is_same(name: str) -> bool:
        if name not in there or name not in now or isinstance(there[name], str) or isinstance(now[name], str):
            return there.get(name) == now.get(name)
        return math.isclose(float(there[name]), float(now[name]), rel_tol=SAME, abs_tol=1e-15)

    apart = [f"{n}: {there.get(n)!r}, must be {now.get(n)!r}" for n in sorted({*there, *now}) if not is_same(n)]
    return ProofCondition("", not apart, float(len(apart)), "differences", ANEW, "; ".join(apart))


def _compare_matrix(there: Any, now: Any, size: Any, names: tuple[Any, Any]) -> ProofCondition:
    """Compare two matrices by the largest relative deviation of an entry.

    The deviation of an element is divided by the element, but at least by SMALL times the largest in its scaled row.
    """
    meaning = "largest relative deviation of an entry"
    if (there is None) != (now is None) or (now is not None and there.shape != now.shape):
        shapes = ["nothing" if M is None else f"shape {M.shape}" for M in (there, now)]
        return ProofCondition("", False, float("nan"), meaning, ANEW, f"{shapes[0]}, must be {shapes[1]}")
    if now is None:
        return ProofCondition("", True, 0.0, meaning, ANEW, "the method has no such matrix")
    apart, whole = np.abs(there - now) * size, np.abs(now) * size
    unit = np.maximum(whole, SMALL * whole.max(axis=1, keepdims=True))
    off = np.where(apart == 0, 0.0, apart / np.where(unit > 0, unit, np.finfo(float).tiny))
    i, j = np.unravel_index(int(np.nan_to_num(off, nan=np.inf).argmax()), off.shape)
    worst = float(off[i, j])
    why = "" if worst <= SAME else f"at {names[0][i]}, {names[1][j]}: {float(there[i, j])!r}, not {float(now[i, j])!r}"
    return ProofCondition("", worst <= SAME, worst, meaning, ANEW, why)


def _limits_condition(number: LimitedNumber) -> ProofCondition:
    limits = f"at least {number.low:g}, below {number.high:g}; {number.how}"
    return ProofCondition("", number.is_inside, number.value, "value", ANEW, limits)


def _compare_number(number: LimitedNumber, written: float | None) -> ProofCondition:
    if written is None:
        return ProofCondition("", False, float("nan"), "difference", ANEW, "the number is not in the file")
    off = abs(written - number.value)
    why = "" if off <= number.near else f"computed {number.value!r}, recorded {written!r}"
    return ProofCondition("", off <= number.near, off, "difference", ANEW, why)

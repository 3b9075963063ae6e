"""Distributions of varied parameters. Each distribution is written as text and defined by its quantile function Q.

    value = Q(u),   u uniform in (0, 1)

Points u of any design (random, Latin, Sobol) can therefore be mapped to values of any distribution. A number in the
text that ends in % is a percentage of the value in the scenario, as in normal(100%, 5%). STD_OF_LOG is a pure number:
5% is 0.05.

Source: inverse transform sampling, e.g. Devroye, "Non-uniform random variate generation", Springer 1986, chapter II.
"""

import csv
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trimtab.core.errors import InputError, argument_name
from trimtab.core.suggestions import closest

ALONG = "along"
"""Kind of distribution for an array: a fixed array, times a standard normal number, is added to the parameter."""


FAR = 1e3
"""Distance from the mean, in standard deviations, beyond which a normal tail is computed from an asymptotic series."""


class Amount(NamedTuple):
    """Number in the text of a distribution.

    share: True for a percentage. `number` is then a fraction of the parameter's value in the scenario.
    """

    number: float
    share: bool

    def of(self, nominal: float) -> float:
        """Return the number. A percentage is multiplied by the nominal value."""
        return self.number * nominal if self.share else self.number


class Distribution(NamedTuple):
    """Distribution of a parameter. text: distribution as typed, e.g. ``normal(2.6, 0.1)``.  kind: e.g. "normal".

    amounts: the numbers in brackets, e.g. 2.6 and 0.1.  choices: the values A, B of ``choice(A, B)``, as text.
    column: sorted values of ``file(…)``.
    """

    text: str
    kind: str
    amounts: tuple[Amount, ...] = ()
    choices: tuple[str, ...] = ()
    column: tuple[float, ...] = ()

    @property
    def is_relative(self) -> bool:
        """Return True if all numbers are percentages. The distribution can then scale a whole array."""
        return bool(self.amounts) and all(a.share for a in self._sizes)

    @property
    def _sizes(self) -> tuple[Amount, ...]:
        """Return the numbers in the distribution's text that have the parameter's unit, not pure numbers."""
        pure = KINDS[self.kind].pure if self.kind in KINDS else ()
        return tuple(a for i, a in enumerate(self.amounts) if i not in pure)

    @property
    def has_shares(self) -> bool:
        """Return True if at least one number is a percentage of the value in the scenario."""
        return any(a.share for a in self._sizes)

    def numbers(self, nominal: float) -> list[float]:
        """Return the numbers in the distribution's text. A percentage is multiplied by the nominal value."""
        pure = KINDS[self.kind].pure
        return [a.number if i in pure else a.of(nominal) for i, a in enumerate(self.amounts)]

    def quantile(self, u: Any, nominal: float) -> Any:
        """Return the quantiles at probabilities u (n,) of a parameter with the given nominal value."""
        if self.kind == "file":
            return np.asarray(self.column)[_index(u, len(self.column))]
        if self.kind == "choice":
            return np.array([a.of(nominal) for a in self.amounts])[_index(u, len(self.amounts))]
        of = KINDS[self.kind].quantile
        if self.is_relative:
            return nominal * of(u, *self.numbers(1.0))
        return of(u, *self.numbers(nominal))

    def pick(self, u: Any) -> Any:
        """Return the index (n,) of the choice, from 0, at each probability u (n,)."""
        return _index(u, len(self.choices))


class Kind(NamedTuple):
    """Kind of distribution. usage: form of the text, e.g. "normal(MEAN, STD)".  quantile: quantile function.

    check: function that returns a text on what is wrong with the numbers, or an empty text.  pure: indices of numbers
    without unit; the other numbers have the parameter's unit.
    """

    usage: str
    quantile: Callable[..., Any]
    check: Callable[..., str]
    pure: tuple[int, ...] = ()


def _index(u: Any, n: int) -> Any:
    return np.minimum((np.asarray(u) * n).astype(np.int64), n - 1)


def _truncated_normal(u: Any, mean: Any, std: Any, low: Any, high: Any) -> Any:
    """Return quantiles of a truncated normal distribution.

    Probabilities near 1 lose digits. Bounds above the mean are therefore reflected to the lower tail. There the
    computation uses logarithms of probabilities.
    """
    u = np.asarray(u, np.float64)
    a, b = (low - mean) / std, (high - mean) / std
    if a > 0:
        return -_truncated_normal(1 - u, -mean, std, -high, -low)
    if b < -FAR:
        return np.clip(high - std * _depth_in_tail(1 - u, -b, b - a), low, high)
    if b < 0:
        tails = special.log_ndtr(a), special.log_ndtr(b)
        z = special.ndtri_exp(tails[1] + np.log(u + (1 - u) * np.exp(tails[0] - tails[1])))
    else:
        tails = special.ndtr(a), special.ndtr(b)
        z = special.ndtri(tails[0] + u * (tails[1] - tails[0]))
    return np.clip(mean + std * z, low, high)


def _depth_in_tail(u: Any, a: Any, width: Any) -> Any:
    """Return quantiles t of z - a for a standard normal z between a and a + width, where a is above FAR.

    t satisfies a t + t^2/2 + log(1 + t/a) = E with an exponentially distributed E, because sf(a + t)/sf(a) equals
    exp(-E) up to a relative error of 1/a^4.
    """
    E = -np.log1p(u * np.expm1(-(a * width + width * width / 2 + np.log1p(width / a))))
    t = 2 * E / (a + np.sqrt(a * a + 2 * E))
    return t - np.log1p(t / a) / (a + t + 1 / (a + t))


def _check_positive(*names: str) -> Callable[..., str]:
    return lambda *values: next(
        (f"{n} must be above 0, got {v:g}" for n, v in zip(names, values, strict=True) if v <= 0), ""
    )


KINDS: Mapping[str, Kind] = {
    "normal": Kind(
        "normal(MEAN, STD)",
        lambda u, mean, std: mean + std * special.ndtri(u),
        lambda mean, std: _check_positive("STD")(std),
    ),
    "truncated": Kind(
        "truncated(MEAN, STD, LOW, HIGH)",
        _truncated_normal,
        lambda mean, std, low, high: (
            _check_positive("STD")(std) or ("" if low < high else f"LOW {low:g} must be below HIGH {high:g}")
        ),
    ),
    "lognormal": Kind(
        "lognormal(MEDIAN, STD_OF_LOG)",
        lambda u, median, spread: median * np.exp(spread * special.ndtri(u)),
        _check_positive("MEDIAN", "STD_OF_LOG"),
        pure=(1,),
    ),
    "uniform": Kind(
        "uniform(LOW, HIGH)",
        lambda u, low, high: low + (high - low) * u,
        lambda low, high: "" if low < high else f"LOW {low:g} must be below HIGH {high:g}",
    ),
    "loguniform": Kind(
        "loguniform(LOW, HIGH)",
        lambda u, low, high: low * np.exp(u * (np.log(high) - np.log(low))),
        lambda low, high: (
            _check_positive("LOW")(low) or ("" if low < high else f"LOW {low:g} must be below HIGH {high:g}")
        ),
    ),
    ALONG: Kind("along(V1, V2, …)", lambda u, *direction: special.ndtri(u), lambda *direction: ""),
}
USAGE = [*(k.usage for k in KINDS.values()), "choice(A, B, …)", "file(NAME.csv:COLUMN)"]


def parse_distribution(text: str, part: str = "") -> Distribution:
    """Read a distribution from text. part: name in error messages; by default that of the argument for the spread."""
    part = part or argument_name("spread")
    match = re.fullmatch(r"\s*([a-z]+)\s*\((.*)\)\s*", text)
    name = match[1] if match else text.partition("(")[0].strip()
    if not match or name not in (*KINDS, "choice", "file"):
        near = closest(name, [*KINDS, "choice", "file"], 1)
        usage = next((u for u in USAGE if near and u.startswith(near[0] + "(")), "normal(100%, 5%)")
        raise InputError(part, f"unknown distribution {text!r}", choices=USAGE, fix=f"write e.g. {usage}")
    inside = [piece.strip() for piece in match[2].split(",")]
    if name == "file":
        return Distribution(text, "file", column=_read_column(part, match[2].strip()))
    if name == "choice":
        return _parse_choice(part, text, inside)
    amounts = tuple(_parse_amount(part, text, piece) for piece in inside)
    kind = KINDS[name]
    if name != ALONG and len(amounts) != kind.usage.count(",") + 1:
        raise InputError(part, f"{text!r} has the wrong number of arguments: {len(amounts)}", fix=f"write {kind.usage}")
    distribution = Distribution(text, name, amounts)
    if not distribution.has_shares or distribution.is_relative:
        _check_numbers(part, distribution, [a.number for a in amounts])
    return distribution


def check_nominal(part: str, distribution: Distribution, nominal: float) -> None:
    """Raise InputError if the distribution's numbers are not valid for a parameter with this nominal value."""
    if distribution.kind not in KINDS:
        return
    if distribution.has_shares and nominal == 0:
        problem = f"{distribution.text}: the scenario's own value is 0, and a percentage of 0 is always 0"
        raise InputError(part, problem, fix="give numbers without %")
    if not distribution.is_relative:
        _check_numbers(part, distribution, distribution.numbers(nominal))


def _check_numbers(part: str, distribution: Distribution, numbers: list[float]) -> None:
    wrong = KINDS[distribution.kind].check(*numbers)
    if wrong:
        raise InputError(part, f"{distribution.text}: {wrong}", fix=f"write {KINDS[distribution.kind].usage}")


def _parse_amount(part: str, text: str, piece: str) -> Amount:
    share = piece.endswith("%")
    try:
        number = float(piece.removesuffix("%"))
    except ValueError:
        raise InputError(part, f"{piece!r} in {text!r} is not a number", fix="write e.g. 2.6 or 110%") from None
    if not np.isfinite(number):
        raise InputError(part, f"{piece!r} in {text!r} is not finite", fix="write e.g. 2.6 or 110%")
    return Amount(number / 100 if share else number, share)


def _parse_choice(part: str, text: str, inside: list[str]) -> Distribution:
    if inside == [""]:
        raise InputError(part, f"{text!r} offers no choices", fix="write e.g. choice(1, 2, 3)")
    try:
        amounts = tuple(_parse_amount(part, text, piece) for piece in inside)
    except InputError:
        amounts = ()  # the choices of an option are words
    return Distribution(text, "choice", amounts, tuple(inside))


def _read_column(part: str, place: str) -> tuple[float, ...]:
    """Read the numbers of one column of a CSV file that has a header."""
    name, _, column = place.rpartition(":")
    usage = "write file(measured.csv:mass), with a CSV file whose first line names the columns"
    if not name or not column:
        raise InputError(part, f"file({place}) names no column", fix=usage)
    try:
        with Path(name).open(newline="", encoding="utf-8") as lines:
            rows = list(csv.DictReader(lines))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(part, f"cannot read {name!r}: {error}", fix=usage) from None
    known = list(rows[0]) if rows else []
    if column not in known:
        raise InputError(part, f"{name!r} has no column {column!r}", choices=map(str, known), fix=usage)
    try:
        numbers = tuple(float(row[column]) for row in rows)
    except (TypeError, ValueError):
        raise InputError(part, f"column {column!r} of {name!r} contains text that is not a number", fix=usage) from None
    if not np.isfinite(numbers).all():
        raise InputError(part, f"column {column!r} of {name!r} contains values that are not finite", fix=usage)
    return tuple(sorted(numbers))

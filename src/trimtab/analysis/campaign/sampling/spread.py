"""Spread of a campaign: the parameters that vary from run to run, their distributions and their correlations.

A path is the name of a parameter, as in ``--set`` and in a log. ``path[1]`` or ``path[0,2]`` is one element of an
array. An array without an index is scaled as a whole, by a distribution with percentages only: ``normal(100%, 5%)``.
``path:1`` with ``along(0.1, 0.2)`` adds the array (0.1, 0.2), multiplied by a standard normal number, to the array at
the path. ``path:2`` adds another such direction.

Source: Nelsen, "An introduction to copulas", Springer 2006, section 2.3, for correlation by a Gaussian copula.
"""

import itertools
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trimtab.analysis.campaign.sampling.distributions import ALONG, Distribution, check_nominal
from trimtab.core.errors import InputError, argument, argument_name
from trimtab.core.quantity import first_number, has_index, split_index
from trimtab.core.record import Option, Quantity, leaves
from trimtab.core.suggestions import closest
from trimtab.loop.calibrated_spread import follow_tables
from trimtab.loop.scenario import Scenario

SPREAD_ROOTS = ("world.", "autopilot.", "initial.")
SCALED = "normal(100%, 5%)"
"""Example of a distribution, shown in error messages."""


class Factor(NamedTuple):
    """Parameter that varies from run to run, with its distribution.

    text: path and index as typed.  path: path without the index.  at: index of the varied element of an array, or None.
    """

    text: str
    path: str
    at: tuple[int, ...] | None
    distribution: Distribution


class Spread(NamedTuple):
    """All parameters that vary.

    mixing: matrix (d, d) that correlates independent normal numbers; None for no correlation.
    """

    factors: tuple[Factor, ...]
    mixing: Any = None

    def correlate(self, u: Any) -> Any:
        """Apply the correlations to sampling points u (n, d). Each column of u stays uniformly distributed."""
        if self.mixing is None:
            return u
        return special.ndtr(special.ndtri(u) @ self.mixing.T)


def parse_factors(spread: Iterable[tuple[str, Distribution]]) -> tuple[Factor, ...]:
    """Return the varied parameters, sorted by text, so that the order on the command line does not matter."""
    factors = []
    for text, distribution in spread:
        path, at = split_index(text.strip())
        match = re.fullmatch(r"([^\[\]:]+)(?::\d+)?" if at is None else r"([^\[\]:]+)", path)
        along = distribution.kind == ALONG
        if match and along != (":" in text):
            problem = (
                f"{distribution.text!r} moves an array along a direction; "
                "the path must end in the number of the direction, e.g. :1"
                if along
                else "ends in the number of a direction, but only along(…) has a direction"
            )
            fix = (
                argument("spread", "along(V1, V2, …)", f"{match[1]}:1")
                if along
                else argument("spread", distribution.text, match[1])
            )
            raise InputError(argument_name("spread", text), problem, fix=fix)
        if not match:
            fix = "write e.g. world.vehicle.mass or autopilot.law.K[0,1]"
            raise InputError(argument_name("spread", text), "is not a path of a parameter", fix=fix)
        factors.append(Factor(text.strip(), match[1], at, distribution))
    factors.sort(key=lambda f: f.text)
    for one, other in itertools.pairwise(factors):
        both = one.distribution.kind == other.distribution.kind == ALONG
        whole = one.at is None or other.at is None
        if one.text == other.text or (one.path == other.path and whole and not both):
            raise InputError(argument_name("spread", other.text), "is named twice", fix="list each parameter only once")
    return tuple(factors)


def resolve_spread(
    scenario: Scenario, factors: tuple[Factor, ...], correlate: Iterable[tuple[str, str, float]] = ()
) -> Spread:
    """Match the varied parameters with a scenario's parameters.

    Raise InputError for an invalid path, index or distribution.
    """
    known = {path: (value, declared) for path, value, declared in leaves(scenario) if path.startswith(SPREAD_ROOTS)}
    for factor in factors:
        part = argument_name("spread", factor.text)
        if factor.path not in known:
            near = closest(factor.path, known, 6) or list(known)[:6]
            fix = argument("spread", SCALED, near[0])
            raise InputError(part, "unknown parameter", choices=near, fix=fix)
        value, declared = known[factor.path]
        if isinstance(declared, Option):
            _check_option(part, factor, declared)
        else:
            _check_number(part, factor, np.asarray(value), declared)
    return Spread(factors, _correlation_factor([f.text for f in factors], list(correlate)))


def _check_option(part: str, factor: Factor, declared: Option) -> None:
    if factor.distribution.kind == "choice" and factor.at is None:
        return
    offer = ", ".join(map(str, declared.choices)) or "10 ms, 20 ms"
    problem = f"this option changes the program, so it can't be drawn from {factor.distribution.text!r}"
    raise InputError(part, problem, fix=argument("spread", f"choice({offer})", factor.path))


def _check_number(part: str, factor: Factor, value: Any, declared: Quantity) -> None:
    if factor.distribution.kind == ALONG:
        if value.ndim == 0 or len(factor.distribution.amounts) != value.size:
            problem = (
                f"must have one number for each element of the parameter, got {len(factor.distribution.amounts)}; "
                f"the parameter has shape {value.shape}"
            )
            raise InputError(part, problem, fix=f"give {value.size} numbers" if value.ndim else SCALED)
        return
    if factor.at is not None:
        if not has_index(value.shape, factor.at):
            fix = argument("spread", SCALED, first_number(factor.path, value.shape))
            raise InputError(part, f"the index does not fit the parameter, which has shape {value.shape}", fix=fix)
        value = value[factor.at]
    elif value.ndim and not factor.distribution.is_relative:
        problem = f"the parameter has shape {value.shape}, but {factor.distribution.text} gives one number"
        one = argument("spread", SCALED, first_number(factor.path, value.shape))
        fix = f"scale the whole array, {argument('spread', SCALED, factor.path)}, or vary one element, {one}"
        raise InputError(part, problem, fix=fix)
    if factor.distribution.kind == "choice" and not factor.distribution.amounts:
        problem = f"{factor.distribution.text!r} must contain only numbers"
        raise InputError(part, problem, fix=argument("spread", "choice(90%, 100%, 110%)", factor.path))
    if declared.kind not in ("real", "angle", "time") and factor.distribution.kind not in ("choice", "file"):
        problem = f"the parameter is a whole number ({declared.kind}), but {factor.distribution.text} yields fractions"
        raise InputError(part, problem, fix=argument("spread", "choice(1, 2)", factor.path))
    if value.ndim == 0:
        check_nominal(part, factor.distribution, float(value))


def _correlation_factor(names: list[str], correlate: list[tuple[str, str, float]]) -> Any:
    """Return the lower Cholesky factor of the required correlation matrix."""
    if not correlate:
        return None
    R = np.eye(len(names))
    for a, b, rho in correlate:
        for name in (a, b):
            if name not in names:
                fix = f"add {argument('spread', '…', name)}"
                raise InputError(argument_name("correlate"), f"{name!r} does not vary", choices=names, fix=fix)
        if a == b or not -1 < rho < 1:
            raise InputError(
                argument_name("correlate"),
                f"{a}, {b} = {rho:g}",
                fix="write two different paths, and a correlation between -1 and 1",
            )
        R[names.index(a), names.index(b)] = R[names.index(b), names.index(a)] = rho
    if np.linalg.eigvalsh(R).min() < 1e-9:
        problem = f"the correlation matrix of these {len(names)} parameters "
        problem += "is not positive definite"
        raise InputError(argument_name("correlate"), problem, fix="weaken some of the correlations")
    return np.linalg.cholesky(R)


def spread_values(spread: Spread, scenario: Scenario, u: Any) -> dict[str, Any]:
    """Return varied parameter -> value in each run (n,).

    For an array that is scaled or moved along a direction, the value is the factor. For an option, the value is the
    index of the choice.

    Args:
        spread: varied parameters that were matched with the scenario.
        scenario: scenario with the nominal values.
        u: sampling points (n, d).
    """
    known = {path: (value, declared) for path, value, declared in leaves(scenario)}
    values: dict[str, Any] = {}
    for factor, level in zip(spread.factors, spread.correlate(u).T, strict=True):
        value, declared = known[factor.path]
        if isinstance(declared, Option):
            values[factor.text] = factor.distribution.pick(level)
            continue
        nominal = np.asarray(value, np.float64)
        whole = nominal.ndim > 0 and factor.at is None  # array that is scaled, or moved along a direction
        own = 1.0 if whole else float(nominal[factor.at or ()])
        drawn = factor.distribution.quantile(level, own)
        values[factor.text] = drawn if declared.kind in ("real", "angle") else np.round(drawn)
    return values


def spread_arrays(spread: Spread, scenario: Scenario, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return path -> values (n, …) of the varied parameters, and of the tables that depend on these parameters.

    values: result of `spread_values`. Options are left out.
    """
    known = {path: (value, declared) for path, value, declared in leaves(scenario)}
    arrays: dict[str, Any] = {}
    for factor in spread.factors:
        value, declared = known[factor.path]
        if isinstance(declared, Option):
            continue
        nominal, drawn = np.asarray(value, np.float64), np.asarray(values[factor.text])
        if factor.at is not None:
            array = arrays.setdefault(factor.path, np.repeat(nominal[None], len(drawn), axis=0))
            array[(slice(None), *factor.at)] = drawn
        elif factor.distribution.kind == ALONG:
            array = arrays.setdefault(factor.path, np.repeat(nominal[None], len(drawn), axis=0))
            each = zip(factor.distribution.amounts, nominal.ravel().tolist(), strict=True)
            direction = np.array([a.of(own) for a, own in each]).reshape(nominal.shape)
            array += drawn.reshape(-1, *[1] * nominal.ndim) * direction
        elif nominal.ndim:
            arrays[factor.path] = drawn.reshape(-1, *[1] * nominal.ndim) * nominal
        else:
            arrays[factor.path] = drawn
    return follow_tables(scenario, arrays)

"""Gains that tuning may move: a parameter and its range, ``autopilot.law.k1=0.5:3``, as a place x in [0, 1].

A range that is ``loguniform(LOW, HIGH)`` is moved in by ratio; a number may end in %, of the scenario's own value.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.campaign.sampling.distributions import Distribution, parse_distribution
from trimtab.campaign.sampling.spread import Factor, Spread
from trimtab.campaign.workers.ready import Ready, drawn, parameters_at
from trimtab.core.errors import InputError
from trimtab.core.record import leaves

RANGES = ("uniform", "loguniform")


def parse_gain(path: str, text: str) -> Distribution:
    """A range from its text."""
    part, fix = f"--gain {path}", f"--gain {path}=0.5:3, or '{path}=loguniform(0.01, 10)'"
    low, colon, high = text.partition(":")
    if colon:
        return parse_distribution(f"uniform({low}, {high})", part)
    made = parse_distribution(text, part) if "(" in text else None
    if made is None or made.kind not in RANGES:
        raise InputError(part, f"{text!r} is no range", choices=("LOW:HIGH", "loguniform(LOW, HIGH)"), fix=fix)
    return made


class Gains(NamedTuple):
    """The gains among the factors of a campaign. at: their columns.  start: (d,), where the scenario's own lie."""

    ready: Ready
    at: Any
    start: Any

    @property
    def factors(self) -> tuple[Factor, ...]:
        """The gains."""
        return tuple(self.ready.spread.factors[i] for i in self.at)

    def points(self, x: Any, first: int) -> Any:
        """u (n, all): gains at x (n, d), and what is dispersed as in runs first … first + n - 1."""
        u = drawn(self.ready, first, first + len(x))[0].u.copy()
        u[:, self.at] = np.clip(x, 2.0**-54, 1 - 2.0**-53)
        return u

    def slope(self, x: Any) -> Any:
        """How fast each gain changes with its place x (n, d): d gain/d x, of the same shape."""
        columns = []
        for factor, place, own in zip(self.factors, np.asarray(x).T, self.own(), strict=True):
            low, high = (a.of(own) for a in factor.distribution.amounts)
            ratio = np.log(high / low) * low * (high / low) ** place if factor.distribution.kind == RANGES[1] else None
            columns.append(np.full(len(place), high - low) if ratio is None else ratio)
        return np.stack(columns, axis=1)

    def own(self) -> list[float]:
        """The scenario's own values."""
        return [_own(self.ready, f) for f in self.factors]

    def numbers(self, x: Any) -> dict[str, float]:
        """Gain, as it was written -> its value at x (d,)."""
        clipped = np.clip(x, 2.0**-54, 1 - 2.0**-53)
        each = zip(self.factors, clipped, self.own(), strict=True)
        return {f.text: float(f.distribution.quantile(np.array([u]), own)[0]) for f, u, own in each}

    def values(self, x: Any) -> dict[str, Any]:
        """Path -> parameter with the gains at x (d,) in it, all else the scenario's own."""
        alone = self.ready._replace(spread=Spread(self.factors))
        return parameters_at(alone, np.clip(x, 2.0**-54, 1 - 2.0**-53))


def gains_of(ready: Ready, names: tuple[str, ...]) -> Gains:
    """The gains of a campaign; refuses a range that the scenario's own value is not in."""
    texts = [f.text for f in ready.spread.factors]
    at = np.array([i for i, text in enumerate(texts) if text in names])
    start = []
    for i in at:
        factor = ready.spread.factors[i]
        part = f"--gain {factor.text}"
        shape = np.shape(next(v for p, v, _ in leaves(ready.scenario) if p == factor.path))
        if shape and factor.at is None:
            zeros = ",".join("0" * len(shape))
            fix = f"--gain '{factor.path}[{zeros}]=LOW:HIGH'"
            raise InputError(part, f"has shape {shape}: a gain is one number", fix=fix)
        own = _own(ready, factor)
        low, high = (a.of(own) for a in factor.distribution.amounts)
        if not low <= own <= high:
            problem = f"the scenario's own value, {own:g}, is not in {low:g} … {high:g}"
            raise InputError(part, problem, fix=f"a range around it, or another start: --set {factor.path}={low:g}")
        log = factor.distribution.kind == RANGES[1]
        start.append(np.log(own / low) / np.log(high / low) if log else (own - low) / (high - low))
    return Gains(ready, at, np.array(start))


def _own(ready: Ready, factor: Factor) -> float:
    value = next(v for p, v, _ in leaves(ready.scenario) if p == factor.path)
    return float(np.asarray(value)[factor.at or ()])

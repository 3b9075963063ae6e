"""Ratios that compare.py reports, with their targets."""

from typing import NamedTuple

import numpy as np
from paired import Ratio, Timed, row
from references import HAND_C, HAND_SLP

TRIMTAB, WALK, SCAN, NUMPY = "trimtab C", "trimtab on JAX", "JAX scan", "numpy loop"
CAMPAIGN, VMAP = "trimtab with lanes and threads", "JAX vmap"
TITLES = {"single": "one run", "python": "one run", "log": "one run with a log of 11 signals", "campaign": "campaign"}
COMMAND = "python benchmarks/compare.py"


class Figure(NamedTuple):
    """Ratio of two programs' times, or CPU times, in one table, with or without a target."""

    table: str
    over: str
    under: str
    most: float | None = None
    least: float | None = None
    cpu: bool = False

    @property
    def name(self) -> str:
        return f"{TITLES[self.table]}: time of {self.over} / time of {self.under}{', CPU time' if self.cpu else ''}"

    @property
    def target(self) -> str:
        if self.most is not None:
            return f"≤ {self.most:g}"
        return f"≥ {self.least:g}" if self.least is not None else ""

    def verdict(self, found: Ratio | None) -> str:
        """Return the verdict on the median: "met", "MISSED" or "not measured"; "" without a target."""
        if found is None:
            return "not measured"
        if not self.target:
            return ""
        fits = (self.most is None or found.median <= self.most) and (self.least is None or found.median >= self.least)
        return "met" if fits else "MISSED"


def figures(simd: str) -> list[Figure]:
    """Return all ratios that are reported, first the ratios with a target."""
    return [
        Figure("single", TRIMTAB, HAND_C, most=1.1),
        Figure("campaign", simd, CAMPAIGN, least=0.95),
        Figure("campaign", simd, CAMPAIGN, least=0.95, cpu=True),
        Figure("python", SCAN, TRIMTAB, least=8),
        Figure("campaign", VMAP, CAMPAIGN, least=20),
        Figure("python", WALK, SCAN, most=1.3),
        Figure("single", HAND_SLP, HAND_C),
        Figure("python", NUMPY, TRIMTAB),
        Figure("campaign", HAND_C, CAMPAIGN),
        Figure("log", TRIMTAB, HAND_C, most=1.1),
        Figure("log", WALK, SCAN),
    ]


def report(found: dict[Figure, Ratio | None]) -> bool:
    """Print ratios and targets. Return True if all targets are met."""
    print(f"\n{'ratios within a round':88}{'median (min..max)':>24}{'target':>9}")
    for figure, x in found.items():
        print(f"{figure.name:88}{x or '-'!s:>24}{figure.target:>9}  {figure.verdict(x)}")
    return all(figure.verdict(x) == "met" for figure, x in found.items() if figure.target)


def markdown(found: dict[Figure, Ratio | None], tables: dict[str, Timed]) -> None:
    """Print rows of the documentation's table: two times for orientation, then the ratios."""
    ms = 1e3 * np.array(tables["single"].times[TRIMTAB])
    per_s = 1 / np.array(tables["campaign"].times[CAMPAIGN])
    alone = f"{np.median(ms):.2f} ms ({ms.min():.2f}..{ms.max():.2f})"
    print("\n" + row(f"one run of 15 s: time of {TRIMTAB}", alone, "", COMMAND))
    many = f"{np.median(per_s):.0f} runs/s ({per_s.min():.0f}..{per_s.max():.0f})"
    print(row(f"campaign: rate of {CAMPAIGN}", many, "", COMMAND))
    for figure, x in found.items():
        print(row(figure.name, x or "not measured", figure.target, COMMAND))

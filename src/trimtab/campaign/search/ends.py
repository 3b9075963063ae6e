"""What a search may move, and how far: refused before anything flies."""

from typing import Any

from trimtab.campaign.workers.prepare import PreparedCampaign, program_options, scenario_at
from trimtab.core.errors import InputError


def refuse_options(ready: PreparedCampaign, part: str) -> None:
    """Refuse a spread of what shapes the program: a search moves numbers."""
    for text, factor in program_options(ready).items():
        problem = f"{factor.path} shapes the program, and a search moves numbers"
        fix = f"one search each, e.g. --set '{factor.path}={factor.distribution.choices[0]}'"
        raise InputError(f"{part} {text}", problem, fix=fix)


def check_bounds(ready: PreparedCampaign, ends: Any, part: str) -> None:
    """Refuse bounds beyond what a part can be flown with: each parameter at its ends, and all at once.

    Args:
        ready: the campaign.
        ends: (2, d), the least and the largest point.
        part: what the refusal names.
    """
    middle, names = ends.mean(axis=0), [f.text for f in ready.spread.factors]
    corners = [(ends[side], "all at one end") for side in (0, 1)]
    for i, name in enumerate(names):
        for side in (0, 1):
            point = middle.copy()
            point[i] = ends[side, i]
            corners.insert(0, (point, name))
    for point, name in corners:
        try:
            scenario_at(ready, point).check()
        except InputError as error:
            problem = f"can't be flown at its end: {error.part}: {error.problem}"
            raise InputError(f"{part} {name}", problem, choices=error.choices, fix="narrower bounds") from None

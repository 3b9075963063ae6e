"""The campaign: every case once, some side by side.

The ends of a flight are scheduled before ordinary processes where that is allowed, and all is judged by logged times;
so cases that start and end beside a flight do not disturb it.
"""

import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from trimtab.core.errors import InputError, closest
from trimtab.loop.scenario import Scenario
from trimtab.studies.live_faults.case import Case, Outcome, fly_case
from trimtab.studies.live_faults.cases import cases
from trimtab.studies.live_faults.flight import ground


def chosen(names: Sequence[str]) -> list[Case]:
    """The cases of these names, or all; refused where there is no such case."""
    known = {case.name: case for case in cases()}
    for name in names:
        if name not in known:
            near = closest(name, known, 6) or list(known)[:6]
            raise InputError("--only", f"there is no case {name!r}", choices=near, fix=f"--only {near[0]}")
    return [known[name] for name in names] or list(known.values())


def fly_cases(
    wanted: Sequence[Case],
    scenario: Scenario,
    *,
    out: Path | None = None,
    jobs: int = 2,
    environment: dict[str, str] | None = None,
    tell: Callable[[Outcome], None] = lambda _: None,
) -> list[Outcome]:
    """Fly cases of the campaign.

    Args:
        wanted: which.
        scenario: as the processes fly it.
        out: a folder that gets one of each case, with both logs and all that was said; kept nowhere when None.
        jobs: how many at a time.
        environment: of the processes, besides this one's.
        tell: is given each outcome as it comes.
    """
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(jobs) as pool:
        where, known = out or Path(scratch), ground(scenario)

        def one(case: Case) -> Outcome:
            outcome = fly_case(case, known, where / case.name, environment or {})
            tell(outcome)
            return outcome

        return list(pool.map(one, wanted))

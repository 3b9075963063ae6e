"""The campaign: every case once, some side by side, each in a process that has nothing else to do.

The ends of a flight, and the line between them, are scheduled before ordinary processes where that is allowed, and all
is judged by logged times; so cases that start and end beside a flight do not disturb it.
"""

import functools
import multiprocessing
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from studies.live_faults.case import Case, CaseOutcome, fly_case
from studies.live_faults.cases import all_cases
from studies.live_faults.draw import DRAWN, flight_case, read_name
from studies.live_faults.flight import NAME, VehicleKnowledge, collect_knowledge
from studies.live_faults.processes_at_0_1 import NOT_FLOWN, try_process_case
from trimtab.core.errors import InputError, closest
from trimtab.scenarios import catalogue


def select_cases(names: Sequence[str]) -> list[str]:
    """The names of these cases, or of all; refused where there is no such case."""
    known = [case.name for case in (*all_cases(), *NOT_FLOWN)]
    for name in names:
        if name.startswith(DRAWN):
            read_name(name)
            continue
        if name not in known:
            near = closest(name, known, 6) or known[:6]
            raise InputError("--only", f"there is no case {name!r}", choices=near, fix=f"--only {near[0]}")
    return list(names) or known


def fly_cases(
    names: Sequence[str],
    *,
    out: Path | None = None,
    jobs: int = 2,
    tell: Callable[[CaseOutcome], None] = lambda _: None,
) -> list[CaseOutcome]:
    """Fly cases of the campaign.

    Args:
        names: which.
        out: a folder that gets one of each case, with both logs and all that was said; kept nowhere when None.
        jobs: how many at a time.
        tell: is given each outcome as it comes.
    """
    apart = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as scratch, ProcessPoolExecutor(jobs, apart) as pool:
        where = out or Path(scratch)
        flown = {pool.submit(_fly_named_case, name, where / name): name for name in names}
        for one in as_completed(flown):
            tell(one.result())
        found = {name: one.result() for one, name in flown.items()}
    return [found[name] for name in names]


def _fly_named_case(name: str, folder: Path) -> CaseOutcome:
    """In a process of the pool."""
    if name.startswith(DRAWN):
        return fly_twice(flight_case(read_name(name)), folder)
    if name in (apart := {case.name: case for case in NOT_FLOWN}):
        return try_process_case(apart[name], folder)
    return fly_twice(next(case for case in all_cases() if case.name == name), folder)


def fly_twice(case: Case, folder: Path) -> CaseOutcome:
    """A case; once more where it failed while something was kept waiting, for that alone may be why."""
    outcome = fly_case(case, _cached_ground(), folder)
    if outcome.verdict != "kept waiting":
        return outcome
    return fly_case(case, _cached_ground(), folder.with_name(f"{folder.name}-second-flight"))._replace(repeated=True)


@functools.cache
def _cached_ground() -> VehicleKnowledge:
    scenario, _ = catalogue.load_scenario(NAME)
    return collect_knowledge(scenario)

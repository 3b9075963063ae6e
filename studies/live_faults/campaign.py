"""Campaign: every case once, several at a time, each in a process of its own.

Vehicle, autopilot and the link between them have priority over ordinary processes where that is allowed. All verdicts
are based on logged times, so cases that start and end during a flight do not disturb it.
"""

import contextlib
import functools
import multiprocessing
import os
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from studies.live_faults.case import Case, CaseOutcome, fly_case
from studies.live_faults.cases import all_cases
from studies.live_faults.cases_without_flight import NOT_FLOWN, try_process_case
from studies.live_faults.draw import DRAWN, flight_case, read_name
from studies.live_faults.flight import NAME, VehicleKnowledge, collect_knowledge
from trimtab.core.errors import InputError
from trimtab.core.suggestions import closest
from trimtab.scenarios import catalogue

SHARE_FLOWN_TWICE = 0.05
"""Share of the flights in virtual time that are flown twice. Both must be equal, bit for bit."""


def select_cases(names: Sequence[str]) -> list[str]:
    """Return the names of these cases, or of all. Raise InputError for an unknown case."""
    known = [case.name for case in (*all_cases(), *NOT_FLOWN)]
    for name in names:
        if name.startswith(DRAWN):
            read_name(name)
            continue
        if name not in known:
            near = closest(name, known, 6) or known[:6]
            raise InputError("--only", f"unknown case {name!r}", choices=near, fix=f"--only {near[0]}")
    return list(names) or known


def fly_cases(
    names: Sequence[str],
    *,
    out: Path | None = None,
    jobs: int = 2,
    is_real: bool = False,
    seed: int = 1,
    tell: Callable[[CaseOutcome], None] = lambda _: None,
) -> list[CaseOutcome]:
    """Fly cases of the campaign.

    Args:
        names: names of the cases.
        out: a folder that gets one folder per case, with both logs and all output; None: nothing is kept.
        jobs: number of cases at a time.
        is_real: True flies real processes in real time; False flies in virtual time.
        seed: seed of virtual time.
        tell: function that is called with each outcome.
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch, _open_pool(jobs) as pool:
        where = out or Path(scratch)
        virtual = functools.partial(_fly_virtual_case, seed)
        fly = _fly_named_case if is_real else functools.partial(virtual, keeps_logs=out is not None)
        flown = {pool.submit(explain_crash, fly, name, where / name): name for name in names}
        again = [] if is_real else names[:: round(1 / SHARE_FLOWN_TWICE)]
        twins = {name: pool.submit(explain_crash, virtual, name, Path(scratch) / f"{name}-again") for name in again}
        for one in as_completed(flown):
            tell(one.result())
        found = {name: one.result() for one, name in flown.items()}
        for name, twin in twins.items():
            if twin.result().digest != found[name].digest:
                both = f"{found[name].digest[:12]} and {twin.result().digest[:12]}"
                problem = f"two flights of this case differ: {both}"
                found[name] = found[name]._replace(problems=(*found[name].problems, problem))
                tell(found[name])
    return [found[name] for name in names]


@contextlib.contextmanager
def _open_pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes. After an error or Ctrl-C, no further case begins, and the caller does not wait."""
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), initializer=_end_with_parent)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _end_with_parent() -> None:
    """Let this process of the pool end as soon as its parent has ended, even if the parent was killed."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def explain_crash(fly: Callable[[str, Path], CaseOutcome], name: str, folder: Path) -> CaseOutcome:
    """Fly a case. An error of the study itself becomes the problem of this case, so that the other cases are flown."""
    try:
        return fly(name, folder)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        problem = f"the study itself failed, at {where}: {type(error).__name__}: {error}"
        return CaseOutcome(name, "", "", (), (problem,))


def _find_case(name: str) -> Case:
    if name.startswith(DRAWN):
        return flight_case(read_name(name))
    return next(case for case in all_cases() if case.name == name)


def _fly_named_case(name: str, folder: Path) -> CaseOutcome:
    """Fly a case in a process of the pool."""
    if name in (apart := {case.name: case for case in NOT_FLOWN}):
        return try_process_case(apart[name], folder)
    return fly_twice(_find_case(name), folder)


def _fly_virtual_case(seed: int, name: str, folder: Path, *, keeps_logs: bool = False) -> CaseOutcome:
    """Fly a case in a process of the pool, in virtual time."""
    if name in (apart := {case.name: case for case in NOT_FLOWN}):
        return CaseOutcome(name, apart[name].does, "", (), (), "not a flight: needs --real-time")
    from studies.live_faults.virtual_flight import fly_in_virtual_time

    return fly_in_virtual_time(_find_case(name), _cached_ground(), folder, seed, keeps_logs=keeps_logs)


def fly_twice(case: Case, folder: Path) -> CaseOutcome:
    """Fly a case. Repeat it if it failed while a process was kept waiting, since that alone may be the reason."""
    outcome = fly_case(case, _cached_ground(), folder)
    if outcome.verdict != "kept waiting":
        return outcome
    return fly_case(case, _cached_ground(), folder.with_name(f"{folder.name}-second-flight"))._replace(repeated=True)


@functools.cache
def _cached_ground() -> VehicleKnowledge:
    scenario, _ = catalogue.load_scenario(NAME)
    return collect_knowledge(scenario)

"""Random flights with one or two disturbances at random times, or with two parts that stall.

The required ending, and the required and allowed lines of the logs, follow from what was drawn.
"""

import random
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from studies.live_faults import acts
from studies.live_faults.acts import Prepare
from studies.live_faults.case import AUTOPILOT, CAUSE, EITHER, FLIES, STOPS, UNEXPLAINED, VEHICLE, Case, CaseOutcome
from studies.live_faults.disturbances import LAST, PASSING, SENT_ONCE, STARTS, Disturbance
from studies.live_faults.flight import FaultFlight
from studies.live_faults.stalls import SINGLE, STALLS, combine_stalls
from studies.live_faults.words import EvidenceCheck, exit_status
from trimtab.core.errors import InputError

DRAWN = "drawn-"
"""Prefix of the names of drawn flights."""
FIRST_S, LAST_S = (0.3, 0.9), (1.4, 2.0)
"""Ranges of start times (s after arming) of passing disturbances, and of disturbances that end the flight."""
GAP_S = 0.0, 1.0
"""Range of the time between the starts of two stalls (s)."""
KINDS = (*LAST, *STARTS, *PASSING, *SINGLE)
"""Functions that draw the main disturbance of a flight. Each of them is used equally often."""


class DrawnFlight(NamedTuple):
    """Drawn flight.  times: start times (s after arming).  is_pair: True for two stalls, in order of their starts."""

    name: str
    disturbances: tuple[Disturbance, ...]
    times: tuple[float, ...]
    is_pair: bool = False

    @property
    def does(self) -> str:
        """Description of the disturbances."""
        return "; ".join(f"{d.does} (at {t} s)" for d, t in zip(self.disturbances, self.times, strict=True))

    @property
    def kind(self) -> str:
        """Kind of the main disturbance."""
        return "two stalls" if self.is_pair else self.disturbances[-1].kind


def draw_flight(seed: int, number: int) -> DrawnFlight:
    """Return the drawn flight of a seed and a number, the same at every call and on every machine."""
    draw = random.Random(f"{seed}/{number}")
    main, name = KINDS[number % len(KINDS)], f"{DRAWN}{seed}-{number}"
    if main in STALLS and draw.random() < 0.5:
        return _draw_pair(draw, name, main)
    others = tuple(m for m in PASSING if m is not main)
    chosen = [draw.choice(others), main] if draw.random() < 0.5 else [main]
    disturbances = tuple(make(draw) for make in chosen)
    times = tuple(round(draw.uniform(*(LAST_S if d.is_last else FIRST_S)), 2) for d in disturbances)
    return DrawnFlight(name, disturbances, times)


def _draw_pair(draw: random.Random, name: str, main: Callable[[random.Random], Disturbance]) -> DrawnFlight:
    """Draw a second stall, the order of both, and their times."""
    pair = [main, draw.choice([m for m in STALLS if m is not main])]
    draw.shuffle(pair)
    start = draw.uniform(*FIRST_S)
    times = round(start, 2), round(start + draw.uniform(*GAP_S), 2)
    return DrawnFlight(name, tuple(make(draw) for make in pair), times, is_pair=True)


def read_name(name: str) -> DrawnFlight:
    """Return a drawn flight by its name, ``drawn-SEED-NUMBER``."""
    found = re.fullmatch(rf"{DRAWN}(\d+)-(\d+)", name)
    if found is None:
        raise InputError("--only", f"{name!r} is not a drawn flight; must be drawn-SEED-NUMBER", fix="--only drawn-1-0")
    return draw_flight(int(found[1]), int(found[2]))


def flight_case(flight: DrawnFlight) -> Case:
    """Return the case of a flight: acts, required ending, and required lines of the logs."""
    several = flight.disturbances
    if flight.is_pair:
        case = Case(flight.name, flight.does, _act_in_order(flight), prepare=_prepare_all(several))
        return combine_stalls(case, (several[0], several[1]), flight.times[1] - flight.times[0])
    last, first = several[-1], several[0]
    is_cut_short = last.is_last and len(several) > 1
    evidence = [*last.evidence, *(_early_evidence(first) if is_cut_short else first.evidence if first != last else ())]
    if len(several) > 1:
        evidence = [check for check in evidence if check not in SENT_ONCE]
    if (given_up := next((d for d in several if d.kind == "disk hangs" and d.partial), None)) is not None:
        evidence = list(given_up.evidence)  # the abandoned log may lack the other evidence
    ending = _expected_ending(several)
    if ending == FLIES and not last.is_last:
        partial = {who for d in several for who in d.partial}
        evidence += [exit_status(who, 0) for who in (VEHICLE, AUTOPILOT) if who not in partial]
    explains = tuple(pattern for d in several for pattern in d.explains)
    stopped = {who: s for d in several for who, s in d.stopped_s.items()}
    statuses = {who: s for d in several for who, s in d.statuses.items()}
    start = next((d.refused_start for d in several if d.refused_start is not None), None)
    return Case(
        flight.name,
        flight.does,
        _act_in_order(flight),
        ending,
        tuple(evidence),
        actuator_fault_s=max(d.actuator_fault_s for d in several),
        command_delay_s=max(d.command_delay_s for d in several),
        statuses=statuses,
        fly=max(d.fly for d in several),
        prepare=_prepare_all(several),
        stopped_s=stopped,
        refused_start=start,
        partial=tuple(who for d in several for who in d.partial),
        missing_requirement=lambda: next((why for d in several if (why := d.missing_requirement())), ""),
        explains=explains,
    )


def _early_evidence(passing: Disturbance) -> tuple[EvidenceCheck, ...]:
    """Return evidence that the passing disturbance was done, even if it was cut short."""
    return passing.evidence[:1] if "fault." in "".join(passing.explains) else ()


def _expected_ending(several: Sequence[Disturbance]) -> str:
    """Return the required ending: one disturbance that stops is enough, unless another may end the flight first."""
    endings = {d.ends for d in several}
    if several[-1].is_last and several[-1].ends != STOPS and len(several) > 1:
        return EITHER if endings != {FLIES} else FLIES
    return STOPS if STOPS in endings else EITHER if EITHER in endings else FLIES


def _prepare_all(several: Sequence[Disturbance]) -> Prepare:
    def prepare(flight: FaultFlight) -> dict[str, dict[str, str]]:
        given: dict[str, dict[str, str]] = {}
        for disturbance in several:
            given |= disturbance.prepare(flight)
        return given

    return prepare


def _act_in_order(drawn: DrawnFlight) -> acts.Act:
    """Return an act that starts each disturbance at its time, even if an earlier one still lasts."""

    def act(flight: FaultFlight) -> None:
        flight.undisturbed_s = 0.0

        def run(disturbance: Disturbance, time: float) -> None:
            flight.let_fly(time)
            disturbance.act(flight)

        pairs = zip(drawn.disturbances, drawn.times, strict=True)
        flight.act_together([partial(run, *pair) for pair in pairs])

    return act


class KindCount(NamedTuple):
    """Counts of the drawn flights of one kind.  waited: failed twice while a process waited. repeated: flown twice."""

    flights: int
    safe: int
    cause_right: int
    unexplained: int
    replays: int
    replays_equal: int
    waited: int
    repeated: int


def count_kinds(outcomes: Mapping[str, CaseOutcome]) -> dict[str, KindCount]:
    """Return the counts of each kind. outcomes: flight name -> outcome."""
    kinds: dict[str, list[CaseOutcome]] = {}
    for name, outcome in outcomes.items():
        kinds.setdefault(read_name(name).kind, []).append(outcome)
    return {
        kind: KindCount(
            len(ones),
            sum(not o.has_problem(None) for o in ones),
            sum(not o.has_problem(CAUSE) for o in ones),
            sum(o.has_problem(UNEXPLAINED) for o in ones),
            sum(len(o.replays) for o in ones),
            sum(sum(o.replays) for o in ones),
            sum(o.verdict == "kept waiting" for o in ones),
            sum(o.repeated for o in ones),
        )
        for kind, ones in kinds.items()
    }

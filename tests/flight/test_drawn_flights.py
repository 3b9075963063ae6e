"""Random fault flights, stalls in pairs, and the check of the values applied by the outputs' driver."""

import random
import re
from pathlib import Path

import numpy as np
import pytest

from studies.live_faults.acts import delay_packets, repeat_packets
from studies.live_faults.campaign import _fly_virtual_case, explain_crash
from studies.live_faults.case import FLIES, STOPS, CaseOutcome
from studies.live_faults.draw import KINDS, count_kinds, draw_flight, flight_case, read_name
from studies.live_faults.driver import PROCESS_S, RADIO_S, OutputsCheck, longest_times
from studies.live_faults.relay import bend_packet
from studies.live_faults.stalls import CAUSES, STALLS, UNSEEN
from trimtab.flight.output_port import DRIVEN, OutputPort, OutputRow
from trimtab.flight.virtual_time import VirtualTime

KINDS_OF_FLIGHTS = {
    *("autopilot killed", "autopilot frozen", "autopilot starved", "autopilot replaced"),
    *("autopilot mis-clocked", "autopilot mis-configured", "autopilot impersonated"),
    *("vehicle killed", "vehicle frozen", "vehicle starved", "vehicle restarted"),
    *("outputs killed", "outputs frozen", "outputs starved"),
    *("sensor or downlink", "uplink", "actuators", "line", "bad network"),
    *("disk full", "disk hangs", "terminal hangs", "two stalls"),
}


def test_drawn_flights_are_reproducible_and_balanced_over_kinds():
    drawn = [draw_flight(1, k) for k in range(220)]
    assert [f.does for f in drawn] == [read_name(f.name).does for f in drawn]
    assert len({f.does for f in drawn}) > 210
    assert len({f.does for f in drawn} & {draw_flight(2, k).does for k in range(220)}) < 10
    kinds = [f.kind for f in drawn]
    assert set(kinds) == KINDS_OF_FLIGHTS
    assert {kinds.count(kind) for kind in ("uplink", "line", "vehicle restarted", "autopilot replaced")} == {10}
    assert 40 < kinds.count("two stalls") < 80
    assert {len(f.disturbances) for f in drawn} == {1, 2}


def test_1000_drawn_flights_contain_500_stalls_and_most_pairs():
    drawn = [draw_flight(1, k) for k in range(1000)]
    stalls = [f for f in drawn if f.is_pair or f.kind in CAUSES or f.kind in UNSEEN]
    assert len(stalls) >= 500
    pairs = {frozenset(d.kind for d in f.disturbances) for f in drawn if f.is_pair}
    assert len(pairs) > 0.9 * len(STALLS) * (len(STALLS) - 1) / 2
    for flight in drawn:
        if flight.is_pair:
            assert flight.times[0] <= flight.times[1]


def test_expected_ending_of_a_drawn_flight_is_predefined():
    for k in range(220):
        flight = draw_flight(3, k)
        case, endings = flight_case(flight), [d.ends for d in flight.disturbances]
        if len(endings) == 1:
            assert case.expected_ending == endings[0]
        if case.expected_ending == FLIES:
            assert set(endings) == {FLIES}
        if flight.kind in ("autopilot killed", "autopilot frozen", "autopilot starved"):
            assert case.expected_ending == STOPS
        assert case.explains is not None
        assert case.evidence_checks or any(d.kind in UNSEEN for d in flight.disturbances)


def test_drawn_flights_are_counted_by_kind():
    names = [f"drawn-1-{k}" for k in range(2 * len(KINDS))]
    ones = {n: CaseOutcome(n, "", "", (), (), replays=(True,)) for n in names}
    ones["drawn-1-0"] = ones["drawn-1-0"]._replace(problems=("unexplained: x", "cause: y"), replays=(False,))
    ones["drawn-1-22"] = ones["drawn-1-22"]._replace(problems=("1.2 N",), waited="vehicle-1 0.3 s")
    counts = count_kinds(ones)
    assert sum(c.flights for c in counts.values()) == 2 * len(KINDS)
    assert counts["autopilot killed"]._asdict() == {
        "flights": 2,
        "safe": 1,
        "cause_right": 1,
        "unexplained": 1,
        "replays": 2,
        "replays_equal": 1,
        "waited": 1,
        "repeated": 0,
    }
    assert counts["line"].safe == 2


def watch(tmp_path, *, still=None, silent_from=9.0, obeys=True):
    """Check outputs that act for a second. still: program frozen from 0.3 s on. obeys: the outputs then go safe."""
    time = VirtualTime(1)
    clock = time.adopt("user").clock
    own = time.start("machine", lambda c: c.wait(None, 1.0)).clock
    port = OutputPort(tmp_path / "port.bin", [0.0, 0.0], 0)

    def apply(c):
        while time.seconds < 1.0:
            acts = still is None or obeys is False or time.seconds < 0.38
            port.write(OutputRow(DRIVEN, True, (1.0 if acts else 0.0, 0.0)), c.monotonic_ns())
            c.wait(None, 0.005)
        port.write(OutputRow(DRIVEN, False, (0.0, 0.0)), c.monotonic_ns())

    programs = {"process": time.programs[1], "outputs' process": time.start("outputs", apply, clock=own)}

    def heard():
        return min(time.now, round(silent_from * 1e9))

    check = OutputsCheck("vehicle-1", time, programs, heard)
    time.start("driver", lambda c: check.run(c, port.path), clock=own)
    if still:
        time.call_at(0.3, lambda: time.freeze(programs[still]))
    clock.wait(None, 2.0)
    return check


def test_outputs_of_running_programs_pass_the_check(tmp_path):
    check = watch(tmp_path)
    assert check.list_violations() == []
    assert longest_times([check, check]) == check.longest_s
    assert set(check.longest_s.values()) == {0.0}


def test_outputs_that_act_after_the_vehicle_stopped_are_found(tmp_path):
    assert watch(tmp_path, still="process").list_violations() == []
    (found,) = watch(tmp_path, still="process", obeys=False).list_violations()
    assert found == "vehicle-1: the outputs still acted 700 ms after its process stopped"


def test_a_driver_makes_frozen_outputs_safe_by_itself(tmp_path):
    check = watch(tmp_path, still="outputs' process", obeys=False)
    assert check.list_violations() == []
    assert 0.5 * PROCESS_S < check.longest_s["its outputs' process stopped"] <= PROCESS_S


def test_outputs_that_act_without_an_autopilot_are_found(tmp_path):
    (found,) = watch(tmp_path, silent_from=0.5).list_violations()
    assert "after the last packet of an autopilot" in found
    assert watch(tmp_path, silent_from=1.0 - 0.9 * RADIO_S).list_violations() == []


FLOWN = {draw_flight(1, k).kind: f"drawn-1-{k}" for k in reversed(range(100))}
"""Kind of a flight -> the first one that is drawn."""


@pytest.mark.thorough
@pytest.mark.parametrize("kind", sorted(FLOWN))
def test_a_drawn_flight_ends_safe_with_the_right_cause(kind, tmp_path):
    outcome = _fly_virtual_case(1, FLOWN[kind], tmp_path / "flight")
    assert outcome.problems == ()
    assert np.isfinite(list(outcome.acted_s.values())).all()
    assert outcome.acted_s


def test_two_packet_disturbances_combine_in_either_order(tmp_path):
    later, thrice = delay_packets(0.5)(random.Random(1)), repeat_packets(random.Random(1))
    assert bend_packet([], b"a") == [(0.0, b"a")]
    both = [(0.5 + delay, b"a") for delay, _ in thrice(b"a")]
    assert len(both) == 3
    assert bend_packet([later, thrice], b"a") == both == bend_packet([thrice, later], b"a")
    outcome = _fly_virtual_case(1, "drawn-1-168", tmp_path / "flight")
    assert outcome.verdict == "holds", outcome.problems


def test_crash_of_the_study_fails_its_case():
    outcome = explain_crash(lambda name, _: {}[name], "cut-1", Path("nowhere"))
    assert outcome.verdict == "fails"
    assert re.fullmatch(
        r"the study itself failed, at test_drawn_flights.py:\d+: KeyError: 'cut-1'", outcome.problems[0]
    )

"""Alarms derived from the rows of a flight."""

import math

import pytest
from console.flight import HELLO, SIGNALS

from trimtab.console.alarms import ALARM, WARNING, Flight
from trimtab.loop.supervisor_modes import (
    CAUSES,
    ENDED,
    ENDED_BY,
    FAULT,
    FLYING,
    HOLD,
    LOST,
    SPEED,
    STANDBY,
    explain_requests,
)


def flight(clock=100.0, **changed):
    found = Flight(HELLO)
    values = SIGNALS | {path.replace("__", "."): value for path, value in changed.items()}
    found.take_row(1.0, clock, list(values.values()))
    return found


def alarms(found, now=100.0):
    return {a.id: (a.level, a.text) for a in found.list_alarms(now)}


def test_no_alarms_in_nominal_flight_or_before_first_row():
    assert alarms(flight()) == {}
    assert alarms(Flight(HELLO)) == {}


def test_missing_rows_raise_no_data_alarm():
    assert alarms(flight(), now=100.4) == {}
    assert alarms(flight(), now=100.7) == {"mute": (ALARM, "no data from the autopilot for 0.7 s")}


@pytest.mark.parametrize(("age", "level"), [(0.27, None), (0.29, WARNING), (0.41, ALARM)])
def test_sample_age_warns_before_its_limit(age, level):
    found = alarms(flight(estimate__age=age))
    assert found.get("age-estimate", (None,))[0] == level


@pytest.mark.parametrize(
    ("mode", "cause", "level"), [(LOST, 12, ALARM), (FAULT, SPEED, ALARM), (ENDED, ENDED_BY, WARNING)]
)
def test_supervisor_mode_alarm_states_the_cause(mode, cause, level):
    found = alarms(flight(supervisor__mode=mode, supervisor__cause=cause))
    ((shown, text),) = found.values()
    assert shown == level
    assert CAUSES[cause] in text


@pytest.mark.parametrize(("held_for", "text"), [(0.05, None), (0.4, "stick 0.40 s old, limit 0.3 s")])
def test_stick_age_counts_from_taking_control(held_for, text):
    stick = {"path": "downlink.stick.age", "label": "stick", "limit": 0.3}
    found = Flight(HELLO | {"signals": [*HELLO["signals"], stick], "ages": [*HELLO["ages"], stick]})
    found.take_row(1.0, 100.0, [*SIGNALS.values(), 66.0])
    assert alarms(found) == {}, "nobody has the stick"
    found.piloted_since = 100.0 - held_for
    assert alarms(found) == ({} if text is None else {"age-stick": (ALARM, text)})


def test_disarming_after_being_armed_raises_an_alarm():
    found = flight()
    found.take_row(2.0, 100.0, list((SIGNALS | {"vehicle.armed": 0.0}).values()))
    assert "disarmed" in alarms(found)
    assert "disarmed" not in alarms(flight(vehicle__armed=0.0))


def test_only_frequent_overruns_raise_a_warning():
    found = flight(loop__overruns=3.0)
    assert "overrun" not in alarms(found, 100.3)
    for clock, overruns, is_warned in ((101.0, 23.0, False), (101.5, 24.0, True), (103.6, 24.0, False)):
        found.take_row(3.0, clock, list((SIGNALS | {"loop.overruns": overruns}).values()))
        assert ("overrun" in alarms(found, clock)) == is_warned, clock


def test_unavailable_requests_state_the_reason():
    requests = flight().explain_requests()
    assert requests["hold"] == {"allowed": True, "why": ""}
    assert requests["resume"] == {"allowed": False, "why": "the mode is flying, not hold"}
    assert flight(supervisor__mode=STANDBY, supervisor__check=1.0).explain_requests()["arm"] == {
        "allowed": False,
        "why": "estimate not valid",
    }
    assert flight(vehicle__armed=0.0).explain_requests()["arm"]["allowed"]
    assert (
        flight(vehicle__armed=0.0, supervisor__mode=ENDED).explain_requests()["arm"]["why"]
        == "send a clear request first"
    )


@pytest.mark.parametrize("mode", [STANDBY, FLYING, HOLD, LOST, FAULT, ENDED])
def test_each_mode_explains_each_request(mode):
    why = explain_requests(mode, 0)
    assert set(why) == {"arm", "hold", "resume", "end", "clear"}
    assert any(not text for text in why.values())


def test_link_statistics_come_from_counts_and_ages():
    found = flight(link__samples=100.0, link__lost=0.0)
    found.describe_link({})
    found.take_row(2.0, 101.0, list((SIGNALS | {"link.samples": 190.0, "link.lost": 10.0}).values()))
    link = found.describe_link({"round_trip": 0.05})
    assert link["rate"] == pytest.approx(90.0)
    assert link["loss"] == pytest.approx(0.1)
    assert link["down"] == pytest.approx(0.02)
    assert link["up"] == pytest.approx(0.03)
    assert flight().describe_link({})["loss"] is None
    assert not any(isinstance(v, float) and math.isnan(v) for v in flight().describe_link({}).values())


def test_violated_formula_raises_alarm_while_violated():
    more = {"monitor.turn.robustness": 0.0, "monitor.turn.verdict": 0.0, "monitor.rest.verdict": 1.0}
    hello = HELLO | {"signals": [*HELLO["signals"], *({"path": p, "modes": None} for p in more)]}
    found = Flight(hello)
    for verdict, robustness, wanted in (
        (0.0, 0.0, {}),
        (1.0, 0.5, {}),
        (2.0, -0.125, {"monitor-turn": (ALARM, "the formula turn is violated, robustness -0.125")}),
        (1.0, 0.5, {}),
    ):
        values = SIGNALS | more | {"monitor.turn.verdict": verdict, "monitor.turn.robustness": robustness}
        found.take_row(1.0, 100.0, list(values.values()))
        assert alarms(found) == wanted

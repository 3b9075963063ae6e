"""Requests that a vehicle forwards to its autopilot, message by message, with a clock set by the test."""

import pytest
from flight.mavlink.line import every
from run.stand_ins import KEY, dialect

from trimtab.core.time import ms, seconds
from trimtab.flight.duties import (
    AUTOPILOT_TIMEOUT,
    NO_AUTOPILOT_PROBLEM,
    REQUEST_TIMEOUT,
    RESEND_PERIOD,
    FlightRequests,
)
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import FlightRequest, ModeRequest
from trimtab.flight.station.standard_services import Status

_, DIALECT = dialect({"compass": every()}, every())
STANDBY, FLYING, HOLDING = 0, 1, 2
MANUAL, HOLD, COMPUTER = 0, 4, 15
GOTO, LAND = 252, 21


class Line:
    """A vehicle's requests, and an autopilot whose answers the test sends."""

    def __init__(self):
        self.vehicle, self.autopilot = Endpoint(DIALECT, 1, 1, KEY), Endpoint(DIALECT, 1, 191, KEY)
        self.said, self.now = [], 0
        self.requests = FlightRequests(self.vehicle, self.said.append)

    def hear(self, name, sender=None, **fields):
        for message in self.vehicle.feed((sender or self.autopilot).pack(name, fields)):
            self.requests.handle_message(message, self.now)

    def beat(self, mode, sender=None, kind=18, flags=1):
        self.hear("HEARTBEAT", sender, type=kind, autopilot=8, base_mode=flags, custom_mode=mode)

    def run(self, duration):
        """Advance the time. Return (ms, command, first parameter, confirmation) of each message to the autopilot."""
        found = []
        for _ in range(0, duration, ms(1)):
            self.now += ms(1)
            for message in self.autopilot.feed(b"".join(self.requests.due(self.now))):
                assert (message.get("target_system"), message.get("target_component")) == (1, 191)
                found.append((self.now // ms(1), *(message.get(n) for n in ("command", "param1", "confirmation"))))
        return found

    def status(self, mode=COMPUTER):
        return self.requests.status(Status(mode=mode), self.now)


@pytest.fixture
def line():
    made = Line()
    made.beat(FLYING)
    return made


def test_autopilot_is_available_until_its_heartbeats_time_out(line):
    assert line.said == ["autopilot: flying"]
    assert (line.status().autopilot_problem, dict(line.status().closed_modes)) == ("", {})
    line.now += AUTOPILOT_TIMEOUT + 1
    assert (line.status().autopilot_problem, dict(line.status().closed_modes)) == (
        NO_AUTOPILOT_PROBLEM,
        {HOLD: NO_AUTOPILOT_PROBLEM},
    )


@pytest.mark.parametrize(
    "beat",
    [
        {"flags": 0},
        {"kind": 6},
        {"sender": Endpoint(DIALECT, 7, 191, KEY)},
    ],
)
def test_other_heartbeats_are_not_taken_for_the_autopilot(beat):
    made = Line()
    made.beat(FLYING, **beat)
    assert made.status().autopilot_problem == NO_AUTOPILOT_PROBLEM
    assert made.said == []


def test_a_request_is_repeated_until_it_is_acknowledged(line):
    line.requests.handle_event(FlightRequest("end"), line.now)
    assert line.run(ms(250)) == [(1, LAND, 0, 0), (101, LAND, 0, 1), (201, LAND, 0, 2)]
    line.hear("COMMAND_ACK", command=GOTO, result=0)  # of something else
    assert len(line.run(RESEND_PERIOD)) == 1
    line.hear("COMMAND_ACK", command=LAND, result=0)
    assert line.run(seconds(1)) == []
    assert line.said == ["autopilot: flying"]


def test_refused_and_unanswered_requests_are_reported(line):
    line.requests.handle_event(FlightRequest("end"), line.now)
    line.run(ms(1))
    line.hear("COMMAND_ACK", command=LAND, result=3)
    line.requests.handle_event(FlightRequest("hold"), line.now)
    assert len(line.run(REQUEST_TIMEOUT + RESEND_PERIOD)) == REQUEST_TIMEOUT // RESEND_PERIOD
    assert line.said[1:] == ["autopilot: end refused", "autopilot: hold: no answer"]
    assert line.run(seconds(1)) == []


def test_hold_mode_is_requested_and_shown_once_autopilot_holds(line):
    line.requests.handle_event(ModeRequest(HOLD), line.now)
    assert line.run(ms(50)) == [(1, GOTO, 0, 0)]
    assert line.status().mode == COMPUTER
    line.hear("COMMAND_ACK", command=GOTO, result=0)
    line.beat(HOLDING)
    assert (line.status().mode, line.status(MANUAL).mode) == (HOLD, MANUAL)
    line.now += AUTOPILOT_TIMEOUT + 1
    assert line.status().mode == COMPUTER
    line.beat(HOLDING)
    line.requests.handle_event(ModeRequest(COMPUTER), line.now)
    assert [(command, first) for _, command, first, _ in line.run(ms(50))] == [(GOTO, 1)]


def test_computer_mode_sends_no_request_unless_holding(line):
    line.requests.handle_event(ModeRequest(COMPUTER), line.now)
    line.requests.handle_event(ModeRequest(MANUAL), line.now)
    assert line.run(seconds(1)) == []


def test_resume_replaces_an_unanswered_hold_request(line):
    line.requests.handle_event(ModeRequest(HOLD), line.now)
    line.run(ms(50))
    line.requests.handle_event(ModeRequest(COMPUTER), line.now)
    assert [first for _, _, first, _ in line.run(ms(50))] == [1]

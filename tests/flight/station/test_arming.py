"""Checks before arming: their texts and their transfer over a link."""

import math

import pytest
from flight.mavlink.line import every
from flight.station.test_parameters import parameters
from run.stand_ins import dialect, ends

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.protocol import CommandCode, CommandResult
from trimtab.flight.station.arming import MOST_ASKS, ArmingCheck, RemoteChecks, first_problem, pack_checks
from trimtab.flight.station.standard_services import Station, Status

_, DIALECT = dialect({"compass": every()}, every())
CHECKS = [
    ArmingCheck("compass age", 3.2, 0.28, "s", "switch compass on"),
    ArmingCheck("space for the log", 50.0, 100.0, "MB", "free disk space", at_least=True),
    ArmingCheck("battery", math.nan, 0.0, "V", "charge it", at_least=True),
    ArmingCheck("confirmation", 0.0, 1.0, "", "confirm", at_least=True, heals=False),
    ArmingCheck("frames lost", 12.5, 50.0, "%", "come nearer"),
]


@pytest.fixture
def line():
    return ends(DIALECT)


@pytest.mark.parametrize(("is_armed", "result"), [(True, CommandResult.NOT_NOW), (False, CommandResult.UNSUPPORTED)])
@pytest.mark.parametrize("action", [1.0, 2.0, 3.0])
def test_reboot_request_is_refused_armed_or_not(line, is_armed, result, action):
    """PREFLIGHT_REBOOT has no effect, whether it asks to restart or to switch off."""
    station = Station(line.there, parameters(), {0: "MANUAL"})
    station.status = Status(armed=is_armed)
    fields = {"command": CommandCode.REBOOT, "param1": action, "target_system": line.there.system}
    (request,) = line.there.feed(line.here.pack("COMMAND_LONG", fields))
    done = station.handle_message(request, 0)
    replies = [message for packet in done.replies for message in line.here.feed(packet)]
    assert [m.get("result") for m in replies if m.name == "COMMAND_ACK"] == [result]
    assert "".join(m.get("text") for m in replies if m.name == "STATUSTEXT").startswith("Not rebooted: ")
    assert done.events == []
    assert station.status.armed == is_armed


def ask(line):
    """Request the checks and return the messages of the vehicle's answer."""
    (question,) = line.there.feed(line.here.pack("COMMAND_LONG", {"command": 401}))
    packets = pack_checks(line.there, question, CHECKS)
    return [message for packet in packets for message in line.here.feed(packet)]


def test_check_texts_give_value_limit_and_fix():
    assert [c.passes for c in CHECKS] == [False, False, True, False, True]
    assert CHECKS[0].sentence == "compass age: 3.2 s, at most 0.28 s; switch compass on"
    assert CHECKS[1].record == "check space for the log: 50 MB, at least 100 MB: refused"
    assert CHECKS[2].record == "check battery: not measured, at least 0 V: passed"
    assert ArmingCheck("compass age", math.inf, 0.28, "s").value_text == "∞ s"
    assert ArmingCheck("space for the log", 58043.9, 100.0, "MB").value_text == "58044 MB"
    assert ArmingCheck("space for the log", 2.5e6, 100.0, "MB").value_text == "2500000 MB"


def test_problem_that_does_not_heal_is_reported_first():
    assert first_problem(CHECKS) == CHECKS[3].sentence
    assert first_problem(CHECKS[:3]) == CHECKS[0].sentence
    assert first_problem(CHECKS[2:3]) == ""


def test_checks_round_trip_over_the_link_and_expire(line):
    remote = RemoteChecks()
    messages = ask(line)
    assert {(m.get("target_system"), m.get("target_component")) for m in messages} == {(1, 191)}
    for message in messages[:-1]:
        remote.handle_message(message, ms(5))
    assert remote.current(ms(5)) == []  # one is missing
    remote.handle_message(messages[-1], ms(6))
    assert [str(c) for c in remote.current(ms(6))] == [str(c) for c in CHECKS]
    assert remote.current(ms(5) + seconds(1) + 1) == []  # they are old


def test_checks_are_requested_at_5_hz_then_abandoned():
    remote = RemoteChecks()
    times = [t for t in range(0, seconds(5), ms(10)) if remote.is_due(t)]
    assert times == [k * ms(200) for k in range(MOST_ASKS)]
    assert remote.has_none


def test_refusal_means_no_checks_unless_received_before(line):
    remote, other = RemoteChecks(), RemoteChecks()
    other.handle_refusal()
    assert other.has_none
    for message in ask(line):
        remote.handle_message(message, 0)
    remote.handle_refusal()  # it has told them before
    assert not remote.has_none


def test_invalid_check_packets_are_ignored(line):
    remote = RemoteChecks()
    (message, *_) = ask(line)
    fields = message.fields()
    for wrong in ({"payload_type": 0xF475}, {"payload_length": 5}, {"payload": (255, 255) + (0,) * 126}):
        for heard in line.here.feed(line.there.pack("TUNNEL", fields | wrong)):
            remote.handle_message(heard, 0)
    assert remote.current(0) == []
    assert not remote.has_none

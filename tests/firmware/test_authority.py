"""Authority over the board and clock checks, by the same rules as `trimtab vehicle`."""

import pytest
from firmware.host import MS, Host, values

from trimtab.flight.autopilot_end import scenario_dialect
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.scenario_identity import scenario_identity
from trimtab.flight.station.identity import IdentityComparison
from trimtab.scenarios.build import build

ARM, CONTROL, ACCEPTED, DENIED = 400, 32100, 0, 2
DAY = 86_400
NEUTRAL = 3000


def arm(host, end, on=True):
    fields = {"target_system": 1, "command": ARM, "param1": float(on), "param3": float(end.session)}
    return [m for m in host.run(2, end.pack("COMMAND_LONG", fields)) if m.name == "COMMAND_ACK"]


def command(host, end, speed_rpm=6000.0, ahead=0):
    fields = {"t": host.now + ahead, "valid": 1, "rudder_pulse": 1.5e-3, "speed_rpm": speed_rpm}
    return host.run(10, end.pack("COMMAND", fields | {"session": end.session}))


def two(host):
    return [host.other(system=1, component=191) for _ in range(2)]


@pytest.mark.thorough
def test_arming_autopilot_has_authority_and_second_one_is_denied(host):
    first, second = two(host)
    assert [(m.get("result"), m.get("result_param2")) for m in arm(host, first)] == [(ACCEPTED, first.session)]
    assert [(m.get("result"), m.get("result_param2")) for m in arm(host, second)] == [(DENIED, first.session)]
    said = []
    for _ in range(30):
        said += command(host, first, 9000.0) + command(host, second, 0.0)
    assert host.counts()["foreign"] == 30
    assert host.pulses()[1] > NEUTRAL  # it turns as the first says
    texts = [m.get("text") for m in said if m.name == "STATUSTEXT" and "commands" in m.get("text")]
    assert texts == ["commands without authority refused"]
    owners = [m for m in said if m.name == "COMMAND_ACK" and m.get("command") == CONTROL]
    assert [m.get("result_param2") for m in owners] == [first.session]
    assert [m.get("result") for m in arm(host, second, on=False)] == [DENIED]
    assert host.pulses()[1] > NEUTRAL
    assert [m.get("result") for m in arm(host, first, on=False)] == [ACCEPTED]
    assert host.pulses()[1] == NEUTRAL
    assert [m.get("result") for m in arm(host, second)] == [ACCEPTED]


@pytest.mark.thorough
def test_rejects_stolen_session_and_other_system(host):
    first, thief = host.other(system=1, component=191), host.other(system=1, component=191, link=9)
    arm(host, first)
    fields = {"t": host.now, "valid": 1, "rudder_pulse": 1.5e-3, "speed_rpm": 9000.0, "session": first.session}
    host.run(10, thief.pack("COMMAND", fields))
    assert host.counts()["foreign"] == 1
    arm(host, first, on=False)
    station = host.other()
    host.run(2, station.pack("COMMAND_LONG", {"target_system": 1, "command": ARM, "param1": 1.0}))
    command(host, host.other(system=7, component=191))
    assert host.counts()["foreign"] == 2
    for _ in range(30):
        command(host, first, 9000.0)
    assert host.counts()["foreign"] == 2
    assert host.pulses()[1] > NEUTRAL


@pytest.mark.thorough
def test_authority_is_handed_over_on_request(host):
    first, second = two(host)
    arm(host, first)
    fields = {"target_system": 1, "command": CONTROL, "param2": 1.0, "param5": float(second.session)}
    (ack,) = [m for m in host.run(2, second.pack("COMMAND_LONG", fields)) if m.name == "COMMAND_ACK"]
    assert (ack.get("result"), ack.get("result_param2")) == (ACCEPTED, second.session)
    command(host, first)
    command(host, second)
    assert host.counts()["foreign"] == 1


@pytest.mark.thorough
def test_first_commander_gets_authority_after_ground_station_arms(host):
    first, second = two(host)
    host.arm()
    command(host, second)
    command(host, first)
    assert host.counts()["foreign"] == 1
    host.arm(False)
    assert host.pulses()[1] == NEUTRAL


@pytest.mark.thorough
def test_only_the_leading_command_is_dropped(host):
    first, _ = two(host)
    arm(host, first)
    for k in range(60):
        command(host, first, ahead=490 * MS if k == 20 else 0)
    assert host.counts()["leading_commands"] == 1
    assert host.pulses()[1] > NEUTRAL


@pytest.mark.thorough
def test_late_clock_is_answered_and_early_clock_does_not_shift_time(host):
    host.run(10, host.pack("HEARTBEAT", type=6))
    host.run(2000)
    kept = host.library.host_kept()
    for difference, count in ((-120.0, "stale"), (DAY, "leading")):
        wrong = host.other(system=1, component=192, clock=lambda d=difference: host.clock() + d)
        answers = []
        for k in range(100):
            answers += host.run(10, wrong.pack("TIMESYNC", {"ts1": k + 1}))
        assert host.counts()[count] == 100
        answered = values(answers, "TIMESYNC", "ts1")
        assert 5 <= len(answered) <= 6  # five a second
        assert set(answered) <= set(range(1, 101))
        assert values(answers, "TIMESYNC", "tc1").min() > 0
    host.run(2000)
    assert host.library.host_kept() - kept < 10 * 100_000  # as time went, and no day more
    before = host.counts()["accepted"]
    host.run(1, host.pack("HEARTBEAT", type=6))
    assert host.counts()["accepted"] == before + 1


def test_time_request_with_wrong_key_is_answered_before_first_accepted_peer(library, written):
    host = Host(library, written.dialect)
    key = passphrase_key("another-passphrase-than-that")
    station, stranger = host.other(key=key), host.other(key=key, system=1, component=191)
    host.work(station.pack("TIMESYNC", {"ts1": 7}) + stranger.pack("HEARTBEAT", {"type": 18}))
    host.now += MS
    host.work()
    assert host.sent() == host.peer.untimely == []
    host.work(stranger.pack("TIMESYNC", {"ts1": 7}))
    host.now += MS
    host.work()
    (answer,) = host.sent() or [u.message for u in host.peer.untimely]
    assert (answer.name, answer.get("ts1")) == ("TIMESYNC", 0)
    assert host.counts()["forged"] == 3


def test_stored_stamp_ahead_of_all_clocks_is_reported_on_request(library, written):
    """After one peer with a wrong clock, peers with the right clock must still be answered."""
    host = Host(library, written.dialect, stored=DAY * 100_000)
    asker = host.other(system=1, component=191)
    data = asker.pack("TIMESYNC", {"ts1": 7})
    host.work(data)
    host.now += MS
    host.work()
    (answer,) = host.sent() or [u.message for u in host.peer.untimely]
    assert (answer.name, answer.get("ts1")) == ("TIMESYNC", 7)
    asker.stamps.follow(host.peer.untimely[0].stamp)
    host.work(asker.pack("HEARTBEAT", {"type": 18}))
    assert host.counts()["accepted"] == 1


CONFIRMATION, REJECTED = 21196, 1


def order_arming(host, end, **fields):
    order = {"target_system": 1, "command": ARM, "param1": 1.0, "param3": float(end.session)} | fields
    return host.run(2, end.pack("COMMAND_LONG", order))


def results(messages):
    texts = [m.get("text").rstrip("\0") for m in messages if m.name == "STATUSTEXT"]
    return [m.get("result") for m in messages if m.name == "COMMAND_ACK"], [x for x in texts if "not armed" in x]


def test_arming_after_failsafe_requires_rest_and_confirmation(host):
    first, _ = two(host)
    arm(host, first)
    for _ in range(300):
        command(host, first, 9000.0)
    host.run(700)  # no commands: failsafe; it glides
    assert results(order_arming(host, first)) == ([REJECTED], ["not armed: failsafe, confirm"])
    answers = results(order_arming(host, first, param2=float(CONFIRMATION)))
    assert answers == ([REJECTED], ["not armed: it moves"])
    assert host.pulses()[1] == NEUTRAL


def test_autopilot_confirms_failsafe_with_arm_command(host):
    first, _ = two(host)
    arm(host, first)
    command(host, first, 0.0)
    host.run(2000)  # no more commands: failsafe at rest
    assert results(order_arming(host, first)) == ([REJECTED], ["not armed: failsafe, confirm"])
    assert results(arm(host, first, on=False))[0] == [ACCEPTED]  # a program's disarming at its end confirms nothing
    assert results(order_arming(host, first))[0] == [REJECTED]
    assert results(order_arming(host, first, param2=float(CONFIRMATION))) == ([ACCEPTED], [])


def test_ground_station_confirms_failsafe_by_disarming(host):
    first, _ = two(host)
    host.arm()
    command(host, first, 0.0)
    host.run(2000)  # no more commands: failsafe at rest
    assert results(host.arm())[0] == [REJECTED]
    assert results(host.arm(False))[0] == [ACCEPTED]
    assert results(host.arm()) == ([ACCEPTED], [])


def test_commands_to_another_vehicle_are_ignored(host):
    first, second = two(host)
    assert results(order_arming(host, first, param4=77.0)) == ([], [])
    arm(host, first)
    fields = {"target_system": 1, "command": CONTROL, "param2": 1.0, "param5": float(second.session), "param6": 77.0}
    assert results(host.run(2, second.pack("COMMAND_LONG", fields))) == ([], [])
    command(host, first)
    assert host.counts()["foreign"] == 0


def test_first_stamp_decades_ahead_does_not_set_the_clock(host):
    far = host.other(system=1, component=191, clock=lambda: host.clock() + 11 * 365 * DAY)
    host.run(10, far.pack("HEARTBEAT", {"type": 18}))
    assert host.counts()["accepted"] == 0
    assert host.counts()["leading"] == 1
    host.run(2000, host.pack("HEARTBEAT", type=6))
    assert host.counts()["accepted"] == 1
    assert host.library.host_kept() < DAY * 100_000


def test_board_identity_reports_parameter_differences(host, written):
    """The board's identity equals that of its scenario; another mass is reported by its path."""
    scenario = build("hovercraft/forward")
    for settings, paths in (({}, []), ({"world.vehicle.mass": "2.8"}, ["world.vehicle.mass"])):
        ours = scenario_identity(build("hovercraft/forward", settings), written.dialect)
        comparison = IdentityComparison(host.peer, ours)
        for _ in range(400):
            asked = b"".join(comparison.due(host.now, 1, 1))
            for message in host.run(10, asked):
                if message.name == "TUNNEL":
                    comparison.handle_message(message)
        assert comparison.is_known
        assert [d.path for d in comparison.differences()] == paths
    assert scenario_dialect(scenario).fingerprint == written.dialect.fingerprint

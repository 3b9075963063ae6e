"""The portable firmware on this computer in simulated time: outputs, failsafe, and accepted frames."""

import ctypes
import itertools

import numpy as np
import pytest
from firmware.conftest import load_library
from firmware.host import COUNTS, KEY, MS, STAMP, Host, values

from trimtab.actuators.speed_regulator import SpeedRegulator
from trimtab.flight.boards.firmware_folder import key_image, write_firmware
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.mavlink.stamps import EPOCH, PER_SECOND
from trimtab.scenarios.build import build

NEUTRAL, FULL = 3000, 1000


def flying(host, ms=500, speed_rpm=6000.0):
    """Armed, and commanded every 20 ms; the last command has just gone."""
    host.arm()
    for _ in range(ms // 20):
        host.run(20, host.command(speed_rpm=speed_rpm))
    host.run(1, host.command(speed_rpm=speed_rpm))


@pytest.mark.thorough
def test_sends_no_frames_until_authenticated_peer_is_received(host):
    assert host.run(1500) == []
    said = host.run(2000, host.pack("HEARTBEAT", type=6))
    assert {m.name for m in said} >= {"HEARTBEAT", "SYS_STATUS", "SERVO_OUTPUT_RAW", "SAMPLE_NAVIGATION"}
    assert all(m.is_signed for m in said)
    assert [m.get("system_status") for m in said if m.name == "HEARTBEAT"] == [3, 3]
    times = values(said, "SAMPLE_NAVIGATION", "t")
    np.testing.assert_array_equal(np.diff(times), 60_000)  # each 6 ms, to the 100 ns
    frames = values(said, "SERVO_OUTPUT_RAW", "time_usec")
    np.testing.assert_array_equal(np.diff(frames), 20_000)


@pytest.mark.thorough
def test_timesync_answers_with_board_clock(host):
    host.run(37)
    host.now += 4321
    host.work(host.pack("TIMESYNC", tc1=0, ts1=123456789))
    (answer,) = [m for m in host.sent() if m.name == "TIMESYNC"]
    assert (answer.get("tc1"), answer.get("ts1")) == (host.now * 100, 123456789)


def test_arming_is_acknowledged_and_other_commands_are_unsupported(host):
    (ack,) = [m for m in host.arm() if m.name == "COMMAND_ACK"]
    assert (ack.get("command"), ack.get("result"), ack.get("target_system")) == (400, 0, 1)
    (ack,) = [m for m in host.run(1, host.pack("COMMAND_LONG", command=22)) if m.name == "COMMAND_ACK"]
    assert (ack.get("command"), ack.get("result")) == (22, 3)
    (ack,) = [m for m in host.run(1, host.pack("COMMAND_LONG", command=400, param1=0.5)) if m.name == "COMMAND_ACK"]
    assert ack.get("result") == 2
    assert host.run(1, host.pack("COMMAND_LONG", command=400, target_system=7, param1=1.0)) == []


def test_outputs_stay_neutral_before_arming(host):
    for _ in range(20):
        host.run(20, host.command())
    assert host.pulses() == [NEUTRAL, NEUTRAL, NEUTRAL - FULL]


def test_fan_reaches_commanded_speed_and_vehicle_moves(host):
    flying(host, 3000)
    duty = (host.pulses()[1] - NEUTRAL) / FULL
    # the motor's own curve: propeller torque over stall torque, and speed over free speed, at 6000 rpm
    assert duty == pytest.approx(2.207e-4 * 36 / 0.08474 + 6 / 19.2, abs=0.02)
    assert host.library.host_truth()[0] > 0.3  # 0.4 N on 2.6 kg for over two seconds


@pytest.mark.thorough
def test_fan_on_empty_battery_needs_more_duty(tmp_path):
    """Voltage: 6.2 V empty, less 0.03 ohm times (3 A + the fan's current). Source: the page of the battery."""
    scenario = build("hovercraft/forward", {"world.actuators.fan.battery.initial": "0"})
    written = write_firmware(scenario, tmp_path, KEY)
    host = Host(load_library(written, tmp_path), written.dialect)
    flying(host, 3000)
    full = 2.207e-4 * 36 / 0.08474 + 6 / 19.2
    duty = (host.pulses()[1] - NEUTRAL) / FULL
    current = duty * 2.207e-4 * 36 * 19200 / (30 / np.pi * 7.2)
    assert duty == pytest.approx(full * 7.2 / (6.2 - 0.03 * (3 + current)), abs=0.01)


def test_failsafe_stops_fan_after_250_ms(host):
    flying(host)
    assert host.pulses()[1] > NEUTRAL
    start = host.now
    stopped = off = None
    while off is None and host.now - start < 2000 * MS:
        host.run(1)
        if stopped is None and host.pulses()[1] == NEUTRAL:
            stopped = (host.now - start) // MS
        if host.pulses()[2] == NEUTRAL - FULL:
            off = (host.now - start) // MS
    assert stopped == 250
    assert 1250 <= off <= 1270  # with the next servo frame
    for _ in range(20):  # latched: commands alone don't help
        host.run(20, host.command())
    assert host.pulses() == [NEUTRAL, NEUTRAL, NEUTRAL - FULL]
    host.arm(False)  # a person confirms
    flying(host)
    assert host.pulses()[1] > NEUTRAL


def test_mode_changes_are_reported_with_cause(host):
    flying(host)
    said = host.run(300)
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"] == ["failsafe: no command"]


def test_disarming_stops_fan_at_once(host):
    flying(host)
    host.arm(False)
    assert host.pulses()[1] == NEUTRAL


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e300])
def test_non_finite_and_huge_commands_are_ignored(host, number):
    flying(host)
    for _ in range(12):
        host.run(20, host.command(rudder_pulse=number, speed_rpm=number))
    host.run(20)
    assert host.pulses()[1] == NEUTRAL  # as if nothing had come


def test_safety_pilot_takes_over_by_radio(host):
    flying(host)
    host.library.host_radio(1, 1200, 1500, 1900)
    host.run(21, host.command())
    assert host.pulses()[:2] == [2400, NEUTRAL]
    host.library.host_radio(1, 1200, 1500, 1100)
    host.run(21, host.command())
    assert host.pulses()[0] == NEUTRAL


def test_pulses_are_half_microsecond_counts_within_limits(library):
    for seconds, counts in (
        (1.5e-3, 3000),
        (1.0e-3, 2000),
        (1.23425e-3, 2469),
        (0.1, 4400),
        (-1.0, 1600),
        (np.nan, 3000),
    ):
        assert library.host_width(ctypes.c_double(seconds)) == counts
    for duty, counts in ((0.0, 3000), (1.0, 4000), (-1.0, 2000), (7.0, 4000), (-np.inf, 2000), (np.nan, 3000)):
        assert library.host_duty(ctypes.c_double(duty)) == counts


def test_finds_frames_split_and_surrounded_by_garbage(host):
    rng = np.random.default_rng(1)
    stream = b""
    for _ in range(50):
        stream += rng.bytes(20) + b"\xfd" + host.pack("HEARTBEAT", type=6)
    for k in range(0, len(stream), 7):
        host.work(stream[k : k + 7])
    assert host.counts()["accepted"] == 50


def test_counts_accepted_and_rejected_frames_by_reason(host):
    good = host.pack("HEARTBEAT", type=6)
    host.work(good)
    host.work(good)
    host.work(host.other(key=None, unsigned=True).pack("HEARTBEAT", {"type": 6}))
    host.work(host.other(key=passphrase_key("some-other-passphrase")).pack("HEARTBEAT", {"type": 6}))
    host.work(host.other(system=1, component=1).pack("HEARTBEAT", {"type": 6}))
    host.work(b"\xfe\x09" + good[2:])
    found = host.counts()
    assert [found[name] for name in COUNTS[:5]] == [1, 1, 1, 1, 1]
    assert found["skipped"] > 0


def test_frames_recorded_before_restart_are_rejected(library, written):
    first = Host(library, written.dialect)
    old = [first.pack("HEARTBEAT", type=6) for _ in range(20)]
    first.run(10, old[0])
    first.run(3000)
    kept = library.host_kept()
    late = first.pack("HEARTBEAT", type=6)
    first.run(1, late)
    second = Host(library, written.dialect, stored=kept)
    second.work(b"".join([*old, late]))
    assert second.counts()["accepted"] == 0
    assert second.counts()["stale"] == 21
    second.peer = first.other(clock=lambda: first.clock() + 5.0)
    second.work(second.pack("HEARTBEAT", type=6))
    assert second.counts()["accepted"] == 1


@pytest.mark.thorough
def test_c_link_accepts_only_frames_that_python_link_accepts(host):
    """Stale, repeated and unordered frames of several senders: Python accepts each frame that C accepts."""
    rng = np.random.default_rng(7)
    behind = [0.0, 0.5, 30.0, 70.0]
    senders = [
        host.other(component=c, clock=lambda b=b: host.clock() - b + 0.2)
        for c, b in zip((1, 2, 3, 4), behind, strict=True)
    ]
    ours = host.other(system=1, component=1, clock=lambda: host.clock() - 1.0)
    recorded, both, only_ours = [], 0, 0
    for _ in range(3000):
        host.now += int(rng.integers(0, 5 * 10**6))
        if recorded and rng.random() < 0.4:
            frame = recorded[rng.integers(len(recorded))]
        else:
            frame = senders[rng.integers(4)].pack("HEARTBEAT", {"type": 6})
            recorded.append(frame)
            if rng.random() < 0.3:
                continue  # kept back for later
        before = host.counts()["accepted"]
        host.work(frame)
        c, python = host.counts()["accepted"] - before, len(ours.feed(frame))
        assert c <= python
        both += c
        only_ours += python - c
    assert both > 500
    assert only_ours < 0.02 * both


def test_key_file_is_private_and_key_is_in_no_other_file(written):
    key = written.folder / "key.bin"
    assert key.stat().st_mode & 0o777 == 0o600
    assert KEY.secret in key.read_bytes()
    numbers = ", ".join(map(str, KEY.secret)).encode()
    others = [p for p in written.folder.rglob("*") if p.is_file() and p != key]
    assert [p for p in others if KEY.secret in p.read_bytes() or numbers in p.read_bytes()] == []
    assert STAMP  # the tests' first stamp is older than any build's


def test_board_reads_valid_key_image_and_rejects_corrupt_ones(library):
    class VehicleKey(ctypes.Structure):
        _fields_ = (("secret", ctypes.c_uint8 * 32), ("since", ctypes.c_uint64))

    since = EPOCH + 12_345.5
    image, key = key_image(KEY, since), VehicleKey()
    assert library.host_key(image, ctypes.byref(key))
    assert (bytes(key.secret), key.since) == (KEY.secret, round(12_345.5 * PER_SECOND))
    for k in range(len(image)):  # a bit of every byte
        assert not library.host_key(image[:k] + bytes([image[k] ^ 1 << k % 8]) + image[k + 1 :], ctypes.byref(key))
    assert not library.host_key(b"\xff" * len(image), ctypes.byref(key))
    assert not library.host_key(None, ctypes.byref(key))


def test_watchdog_is_kicked_only_by_completed_ticks(host):
    """One kick per completed tick of 1 ms. A loop whose time stands still does not kick."""
    host.run(10)
    before = host.library.host_kicks()
    for _ in range(50):
        host.work()  # time stands still
    assert host.library.host_kicks() == before
    host.run(250)
    assert host.library.host_kicks() == before + 250


def test_board_that_cannot_arm_reports_reason(host):
    host.library.host_refuse(1)
    said = host.arm()
    (ack,) = [m for m in said if m.name == "COMMAND_ACK"]
    assert ack.get("result") == 1
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"] == ["not armed: no crystal"]
    host.run(100, host.command())
    assert host.pulses() == [NEUTRAL, NEUTRAL, NEUTRAL - FULL]
    host.library.host_refuse(0)
    flying(host)
    host.library.host_refuse(1)
    host.arm()  # flying already: nothing is taken away
    host.run(100, host.command())
    assert host.pulses()[1] > NEUTRAL
    host.arm(False)
    assert host.pulses()[1] == NEUTRAL


def test_reset_cause_is_reported_once(host):
    said = host.run(4000, host.pack("HEARTBEAT", type=6))
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"].count("started: watchdog") == 1


def test_black_box_records_flight_and_mode_changes(host):
    assert host.library.host_recorded() == 0
    flying(host, 3000)
    host.run(2000)  # the commands stop: failsafe, lift off
    rows = [host.library.host_record(i)[:6] for i in range(host.library.host_recorded())]
    modes = [row[1] & 0xFF for row in rows]
    assert [modes[0], *(b for a, b in itertools.pairwise(modes) if a != b)] == [1, 3]
    times = np.array([row[0] for row in rows])
    assert (np.diff(times) <= 100).all()
    assert max(row[2] >> 16 for row in rows) > NEUTRAL  # thrust
    assert max(row[3] >> 16 for row in rows) == 6000  # rpm wanted
    assert [row[4] & 0xFFFF for row in rows if row[1] & 0xFF == 1][-1] == pytest.approx(6000, rel=0.02)  # measured
    assert rows[-1][4] >> 16 > 1000  # age of the command, ms


def test_slow_work_runs_only_while_disarmed(host):
    host.run(3000)
    assert host.library.host_rests() == 3
    flying(host, 2000)
    assert host.library.host_rests() == 3


PARAMETERS = ["reg.kp", "reg.ki", "reg.limit", "reg.stall", "reg.stall_duty"]
REAL32 = 9


def parameters(messages):
    return {m.get("param_id").rstrip("\0"): m.get("param_value") for m in messages if m.name == "PARAM_VALUE"}


def set_parameter(host, name, value):
    packet = host.pack("PARAM_SET", target_system=1, param_id=name, param_value=value, param_type=REAL32)
    return host.run(1, packet)


def test_parameters_are_listed_bounded_and_persistent(library, written):
    host = Host(library, written.dialect)
    defaults = parameters(host.run(10, host.pack("PARAM_REQUEST_LIST", target_system=1)))
    regulator = SpeedRegulator()
    assert list(defaults) == PARAMETERS
    assert list(defaults.values()) == pytest.approx([getattr(regulator, name[4:]) for name in PARAMETERS])
    assert parameters(set_parameter(host, "reg.kp", 0.125)) == {"reg.kp": 0.125}
    for wrong in (-0.1, 1.5, np.nan, np.inf):
        said = set_parameter(host, "reg.kp", wrong)
        assert parameters(said) == {"reg.kp": 0.125}  # what holds
        texts = [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"]
        assert texts == ["parameter refused: out of bounds"]
    assert parameters(set_parameter(host, "reg.nothing", 0.5)) == {}
    read = host.pack("PARAM_REQUEST_READ", target_system=1, param_id="reg.kp", param_index=-1)
    assert parameters(host.run(1, read)) == {"reg.kp": 0.125}
    again = Host(library, written.dialect, stored=1)
    assert parameters(again.run(10, again.pack("PARAM_REQUEST_LIST"))) == defaults | {"reg.kp": 0.125}


def test_rejects_parameter_change_while_armed(host):
    flying(host)
    said = set_parameter(host, "reg.kp", 0.5)
    assert parameters(said) == {"reg.kp": pytest.approx(0.08)}
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"] == ["parameter refused: armed"]


@pytest.mark.thorough
def test_lockstep_stamps_follow_the_peer_when_board_time_is_faster(written, tmp_path):
    host = Host(load_library(written, tmp_path, "-DSTAMPS_FOLLOW_PEER"), written.dialect)
    wall = host.clock()
    host.peer = host.other(system=1, component=191, clock=lambda: wall)
    for _ in range(5):  # five minutes of the board's time, while the other end's clock stands still
        host.run(1, host.pack("HEARTBEAT", type=6))
        host.now += 60_000 * MS
        host.run(1)
    assert host.counts()["accepted"] == 5
    assert host.counts()["stale"] == 0
    assert host.peer.counts.refusals == 0

"""Standard services of a vehicle, used by a ground station over packets. Numbers are compared with pymavlink's."""

import math

import pytest
from flight.station.test_parameters import parameters
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.errors import InputError
from trimtab.core.time import seconds
from trimtab.flight.mavlink import protocol
from trimtab.flight.mavlink.endpoint import Endpoint, Numbering
from trimtab.flight.mavlink.protocol import (
    ArmRequest,
    CommandResult,
    FlightRequest,
    JoystickAxes,
    ModeRequest,
    ParameterChange,
    ReceiverChannels,
)
from trimtab.flight.station.arming import ArmingCheck
from trimtab.flight.station.standard_services import Station, Status
from trimtab.flight.station.streams import Streams, TelemetryStream
from trimtab.vehicles.vehicle_type import VehicleType

GROUND = (255, 190)
MODES = {0: "MANUAL", 4: "HOLD", 15: "GUIDED"}


class Line:
    """A vehicle and a ground station."""

    def __init__(self, dialect, **how) -> None:
        self.vehicle = Endpoint(dialect, 1, 1, unsigned=True)
        self.ground = Endpoint(dialect, *GROUND, unsigned=True)
        kind = VehicleType.SURFACE_BOAT
        self.station = Station(self.vehicle, parameters(), MODES, **{"vehicle": kind, **how})

    def ask(self, name, now=0, **fields):
        """Send a message. Return the replies and the events."""
        events, replies = [], []
        for message in self.vehicle.feed(self.ground.pack(name, fields)):
            done = self.station.handle_message(message, now)
            events += done.events
            replies += self.ground.feed(b"".join(done.replies))
        return replies, events

    def command(self, number, *params, **fields):
        """Send a COMMAND_LONG. Return the result, the texts and the events."""
        given = {f"param{k + 1}": v for k, v in enumerate(params)}
        replies, events = self.ask(
            "COMMAND_LONG", command=number, target_system=1, target_component=1, **given, **fields
        )
        (result,) = [m.get("result") for m in replies if m.name == "COMMAND_ACK"]
        return result, "".join(m.get("text") for m in replies if m.name == "STATUSTEXT"), events

    def due(self, now):
        return self.ground.feed(b"".join(self.station.due(now)))


@pytest.fixture
def line(dialect):
    return Line(dialect)


def test_enum_values_match_the_common_dialect():
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    for ours, theirs in (
        ("CommandCode.ARM", "MAV_CMD_COMPONENT_ARM_DISARM"),
        ("CommandCode.SET_MODE", "MAV_CMD_DO_SET_MODE"),
        ("CommandCode.TERMINATE", "MAV_CMD_DO_FLIGHTTERMINATION"),
        ("CommandCode.LAND", "MAV_CMD_NAV_LAND"),
        ("CommandCode.PAUSE_CONTINUE", "MAV_CMD_DO_PAUSE_CONTINUE"),
        ("CommandCode.OVERRIDE_GOTO", "MAV_CMD_OVERRIDE_GOTO"),
        ("CommandCode.STORAGE", "MAV_CMD_PREFLIGHT_STORAGE"),
        ("CommandCode.REBOOT", "MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN"),
        ("CommandResult.FAILED", "MAV_RESULT_FAILED"),
        ("CommandCode.GET_HOME", "MAV_CMD_GET_HOME_POSITION"),
        ("CommandCode.REQUEST_MESSAGE", "MAV_CMD_REQUEST_MESSAGE"),
        ("CommandCode.REQUEST_CAPABILITIES", "MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES"),
        ("CommandResult.NOT_NOW", "MAV_RESULT_TEMPORARILY_REJECTED"),
        ("CommandResult.DENIED", "MAV_RESULT_DENIED"),
        ("CommandResult.UNSUPPORTED", "MAV_RESULT_UNSUPPORTED"),
        ("State.STANDBY", "MAV_STATE_STANDBY"),
        ("State.EMERGENCY", "MAV_STATE_EMERGENCY"),
        ("Severity.WARNING", "MAV_SEVERITY_WARNING"),
        ("ModeFlag.ARMED", "MAV_MODE_FLAG_SAFETY_ARMED"),
        ("ModeFlag.CUSTOM", "MAV_MODE_FLAG_CUSTOM_MODE_ENABLED"),
        ("VehicleType.SURFACE_BOAT", "MAV_TYPE_SURFACE_BOAT"),
        ("VehicleType.GROUND_ROVER", "MAV_TYPE_GROUND_ROVER"),
        ("VehicleType.FIXED_WING", "MAV_TYPE_FIXED_WING"),
        ("VehicleType.ONBOARD_COMPUTER", "MAV_TYPE_ONBOARD_CONTROLLER"),
        ("Capability.PARAMETERS_AS_FLOAT", "MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST"),
        ("Capability.MAVLINK2", "MAV_PROTOCOL_CAPABILITY_MAVLINK2"),
        ("Capability.FILES", "MAV_PROTOCOL_CAPABILITY_FTP"),
        ("Capability.COMMAND_INT", "MAV_PROTOCOL_CAPABILITY_COMMAND_INT"),
    ):
        kind, name = ours.split(".")
        numbers = VehicleType if kind == "VehicleType" else getattr(protocol, kind)
        assert numbers[name] == getattr(common, theirs), ours
    assert common.MAV_PARAM_TYPE_REAL32 == protocol.REAL_32
    assert common.MAVLINK_MSG_ID_SET_MODE == protocol.SET_MODE_MESSAGE


def test_heartbeat_each_second_gives_mode_and_arming(line):
    beats = []
    for k in range(41):
        line.station.status = Status(mode=4, armed=k > 20, state=protocol.State.ACTIVE)
        beats += line.due(k * seconds("0.05"))
    assert [b.name for b in beats] == ["HEARTBEAT"] * 3
    assert [b.get("base_mode") for b in beats] == [1, 1, 129]
    assert {(b.get("type"), b.get("autopilot"), b.get("custom_mode")) for b in beats} == {(11, 0, 4)}
    assert [m.name for m in line.due(0)] == ["HEARTBEAT"]  # the clock went back


def test_timesync_answer_holds_both_times(line):
    ((answer,), events) = line.ask("TIMESYNC", now=12_345_678, tc1=0, ts1=777)
    assert (answer.get("tc1"), answer.get("ts1")) == (1_234_567_800, 777)
    assert not events
    assert line.ask("TIMESYNC", tc1=5, ts1=777) == ([], [])  # an answer to somebody else


def test_arm_command_is_accepted_or_refused_with_reason(line):
    assert line.command(400, 1.0) == (0, "", [ArmRequest(True, by_hand=True)])
    line.station.status = Status(arming_problem="no position yet; the tank of the lift fan is empty, and more is wrong")
    result, text, events = line.command(400, 1.0, 21196.0)  # forcing doesn't help
    assert (result, text, events) == (1, f"Arming refused: {line.station.status.arming_problem}", [])
    assert line.command(400, 0.0) == (0, "", [ArmRequest(False, by_hand=True)])
    assert line.command(185, 1.0) == (0, "", [ArmRequest(False, by_hand=True)])
    assert line.command(400, math.nan)[0] == line.command(400, 0.5)[0] == 2


def test_arming_is_refused_if_settings_changed_since_comparison(line):
    line.station.status = Status(identity=77)
    result, text, events = line.command(400, 1.0, 0, 5, 0, 78)
    assert (result, events) == (1, [])
    assert text == "Arming refused: settings have changed since they were compared"
    for number in (77, 0, math.nan):  # a ground station compares nothing
        result, _, events = line.command(400, 1.0, 0, 5, 0, number)
        assert (result, len(events)) == (0, 1)
    result, _, events = line.command(400, 0.0, 0, 5, 0, 78)
    assert (result, len(events)) == (0, 1)  # disarming is never refused for that


def test_arming_after_failsafe_needs_confirmation(line):
    """A forced arming request counts as confirmation and overrides no check."""
    line.station.status = Status(confirmation_problem="confirmation: 0, at least 1; disarm, then arm")
    assert line.command(400, 1.0) == (1, "Arming refused: confirmation: 0, at least 1; disarm, then arm", [])
    assert line.command(400, 1.0, 21196.0) == (0, "", [ArmRequest(True, by_hand=True)])
    line.station.status = Status(arming_problem="imu age", confirmation_problem="confirmation")
    assert line.command(400, 1.0, 21196.0) == (1, "Arming refused: imu age", [])


def test_prearm_checks_are_sent_on_request_unless_armed(dialect):
    checks = [
        ArmingCheck("imu age", 3.0, 0.28, "s", "switch imu on"),
        ArmingCheck("battery", 7.4, 7.0, "V", "charge it", at_least=True),
    ]
    line = Line(dialect, arming_checks=lambda: checks)
    assert line.command(401, 0.0) == (0, "PreArm: imu age: 3 s, at most 0.28 s; switch imu on", [])
    replies, _ = line.ask("COMMAND_LONG", command=401, target_system=1)
    assert [m.name for m in replies].count("TUNNEL") == 2
    line.station.status = Status(armed=True)
    assert line.command(401, 0.0) == (1, "", [])


def test_mode_command_is_accepted_or_refused_with_choices(line):
    assert line.command(176, 1.0, 15.0) == (0, "", [ModeRequest(15)])
    result, text, events = line.command(176, 1.0, 7.0)
    assert (result, events) == (2, [])
    assert text == "No mode 7; available: 0 MANUAL, 4 HOLD, 15 GUIDED"
    assert (
        line.command(176, math.nan, math.nan)[0]
        == line.command(176, 0.0, 4.0)[0]
        == line.command(176, 1e30, 4.0)[0]
        == 2
    )
    for part in (4.0, 5.0, 6.0):  # MISSION, RTL and LAND of PX4, parts of its mode 4
        result, text, events = line.command(176, 1.0, 4.0, part)
        assert (result, events) == (2, [])
        assert text == f"No mode 4.{part:.0f}; available: 0 MANUAL, 4 HOLD, 15 GUIDED"
    assert line.command(176, 1.0, 4.0, math.nan)[2] == [ModeRequest(4)]
    line.station.status = Status(closed_modes={15: "no link to the autopilot"})
    result, text, _ = line.command(176, 1.0, 15.0)
    assert (result, text) == (1, "Mode GUIDED refused: no link to the autopilot")
    replies, events = line.ask("SET_MODE", target_system=1, base_mode=1, custom_mode=4)
    assert events == [ModeRequest(4)]
    assert [(m.name, m.get("command"), m.get("result")) for m in replies] == [("COMMAND_ACK", 11, 0)]


def test_command_int_works_and_unknown_commands_are_unsupported(line):
    replies, events = line.ask("COMMAND_INT", command=400, param1=1.0, target_system=1, target_component=1)
    assert events == [ArmRequest(True, by_hand=True)]
    assert [m.get("result") for m in replies] == [0]
    assert line.command(246, 1.0)[0] == 3  # reboot
    assert line.command(512, 31.0)[0] == 3


def test_messages_for_other_targets_are_ignored(line):
    for system, component in ((2, 1), (1, 2), (2, 0)):
        fields = {"command": 400, "param1": 1.0, "target_system": system, "target_component": component}
        assert line.ask("COMMAND_LONG", **fields) == ([], [])
    assert len(line.ask("COMMAND_LONG", command=400, param1=1.0)[1]) == 1  # for all
    assert line.ask("MANUAL_CONTROL", target=2, x=5) == ([], [])
    assert line.ask("SAMPLE_EVERY") == ([], [])


def test_autopilot_version_carries_the_dialect_fingerprint(line, dialect):
    for number, params in ((520, (1.0,)), (512, (148.0,))):
        fields = {f"param{k + 1}": v for k, v in enumerate(params)}
        replies, _ = line.ask("COMMAND_LONG", command=number, target_system=1, **fields)
        version, ack = replies
        assert bytes(version.get("flight_custom_version")) == dialect.fingerprint
        assert version.get("flight_sw_version") >> 24 == 0
        assert ack.get("result") == 0


def test_parameter_list_is_sent_at_a_limited_rate(line):
    line.ask("PARAM_REQUEST_LIST", target_system=1)
    found, sent = [], 0
    for k in range(100):
        new = [m for m in line.due(k * seconds("0.005")) if m.name == "PARAM_VALUE"]
        found += new
        sent = max(sent, len(new))
    names = list(parameters().table())
    assert sent == 1
    first, *found = found
    assert (first.get("param_id"), first.get("param_index"), first.get("param_count")) == ("_HASH_CHECK", 65535, 7)
    assert [m.get("param_id") for m in found] == names
    assert [m.get("param_index") for m in found] == list(range(len(names)))
    assert {m.get("param_count") for m in found} == {len(names)}
    assert found[0].get("param_value") == pytest.approx(2.6, rel=1e-7)


def test_one_parameter_is_read_by_name_or_index(line):
    by_name, _ = line.ask("PARAM_REQUEST_READ", target_system=1, param_id="WV_DRAG", param_index=-1)
    by_index, _ = line.ask("PARAM_REQUEST_READ", target_system=1, param_index=6)
    assert by_name[0].values == by_index[0].values
    assert line.ask("PARAM_REQUEST_READ", target_system=1, param_id="NO_SUCH", param_index=-1) == ([], [])


def test_parameter_set_answers_with_the_value_in_force(line):
    (value,), events = line.ask("PARAM_SET", target_system=1, param_id="WVI_MASS", param_value=3.5)
    assert value.get("param_value") == 3.5
    assert events == [ParameterChange("world.vehicle.inner.mass", 0, 3.5)]
    replies, events = line.ask("PARAM_SET", target_system=1, param_id="WVI_MASS", param_value=-1.0)
    value, *texts = replies
    assert (value.get("param_value"), events) == (3.5, [])
    assert "".join(t.get("text") for t in texts) == "Not set: WVI_MASS (world.vehicle.inner.mass) must be above 0"
    replies, events = line.ask("PARAM_SET", target_system=1, param_id="NONE", param_value=1.0)
    assert [m.get("text") for m in replies] == ["Not set: no parameter 'NONE'"]
    assert not events


@pytest.mark.parametrize("kind", [1, 2, 3, 4, 5, 6, 7, 8, 10])
def test_rejects_real_parameter_sent_as_another_type(line, kind):
    """The bytes of the integer 3, read as a real number, are 4.2e-45."""
    replies, events = line.ask("PARAM_SET", target_system=1, param_id="WVI_MASS", param_value=3.0, param_type=kind)
    assert not events
    assert f"got type {kind}" in "".join(m.get("text") for m in replies if m.name == "STATUSTEXT")
    _, (event,) = line.ask("PARAM_SET", target_system=1, param_id="WVI_MASS", param_value=3.0, param_type=9)
    assert event.value == 3.0


def test_receiver_channels_and_joystick_become_events(line):
    fields = {"chancount": 3, "chan1_raw": 1500, "chan2_raw": 65535, "chan3_raw": 1000, "chan4_raw": 1700}
    _, (event,) = line.ask("RC_CHANNELS", **fields)
    assert isinstance(event, ReceiverChannels)
    assert event.pulses[0] == pytest.approx(1.5e-3)
    assert event.pulses[2] == pytest.approx(1e-3)
    assert [k for k, v in enumerate(event.pulses) if not math.isnan(v)] == [0, 2]
    _, (event,) = line.ask("RC_CHANNELS_OVERRIDE", target_system=1, chan1_raw=0, chan2_raw=1200, chan9_raw=65534)
    assert [k for k, v in enumerate(event.pulses) if not math.isnan(v)] == [1]
    _, (event,) = line.ask("MANUAL_CONTROL", target=1, x=500, y=-1000, z=32767, r=0)
    assert event[:2] == (0.5, -1.0)
    assert math.isnan(event.heave)
    assert isinstance(event, JoystickAxes)
    assert event.yaw == 0.0


@pytest.mark.parametrize("pulse", [1, 799, 2201, 3000, 65534])
def test_implausible_receiver_pulse_counts_as_missing(line, pulse):
    for name in ("RC_CHANNELS", "RC_CHANNELS_OVERRIDE"):
        fields = {"chancount": 18} if name == "RC_CHANNELS" else {"target_system": 1}
        _, (event,) = line.ask(name, chan1_raw=pulse, chan2_raw=800, chan3_raw=2200, **fields)
        assert math.isnan(event.pulses[0])
        assert event.pulses[1:3] == pytest.approx((0.8e-3, 2.2e-3))


@pytest.mark.parametrize(
    ("pulses", "is_release"),
    [
        ({}, True),
        ({f"chan{k}_raw": 65535 for k in range(2, 9)}, False),
        ({f"chan{k}_raw": 65535 for k in range(1, 9)}, False),
        ({"chan1_raw": 1500}, False),
        ({"chan9_raw": 1500}, False),
    ],
)
def test_override_of_eight_zeros_releases_the_sticks(line, pulses, is_release):
    _, (event,) = line.ask("RC_CHANNELS_OVERRIDE", target_system=1, **pulses)
    assert event.is_release is is_release
    _, (event,) = line.ask("RC_CHANNELS", chancount=0)
    assert not event.is_release


def test_signing_keys_are_not_accepted_over_the_link(line):
    replies, events = line.ask("SETUP_SIGNING", target_system=1, secret_key=bytes(range(32)))
    assert [m.get("text") for m in replies] == ["Keys are not accepted over the link"]
    assert not events


def test_broadcast_ping_is_echoed(line):
    ((echo,), _) = line.ask("PING", seq=7, time_usec=99)
    assert (echo.get("seq"), echo.get("time_usec"), echo.get("target_system")) == (7, 99, GROUND[0])
    assert line.ask("PING", seq=7, target_system=1) == ([], [])


@pytest.mark.parametrize("length", [0, 50, 51, 100, 120])
def test_long_texts_are_split_and_can_be_rejoined(line, length):
    text = "0123456789" * (length // 10) + "x" * (length % 10)
    line.station.queue_text(protocol.Severity.INFO, text)
    pieces = [m for m in line.due(0) if m.name == "STATUSTEXT"]
    assert "".join(m.get("text") for m in pieces) == text
    if length > 50:
        assert [m.get("chunk_seq") for m in pieces] == list(range(len(pieces)))
        assert len({m.get("id") for m in pieces}) == 1
        assert pieces[0].get("id") > 0
        assert len(pieces[-1].get("text")) < 50  # what tells that it ends
    else:
        assert [m.get("id") for m in pieces] == [0]


def test_too_many_texts_are_dropped_and_counted(line):
    for _ in range(30):
        line.station.queue_text(protocol.Severity.INFO, "again")
    assert len([m for m in line.due(0) if m.name == "STATUSTEXT"]) == 20
    assert line.station.texts.dropped == 10


@given(st.data())
def test_station_survives_any_fuzzed_message(dialect, data):
    """Any message of the dialect with random bytes as payload. All replies can be packed."""
    line = Line(dialect)
    for _ in range(5):
        definition = data.draw(st.sampled_from(list(dialect.definitions.values())))
        payload = data.draw(st.binary(min_size=definition.size, max_size=definition.size))
        packet = line.ground._make_frame(definition, payload, Numbering(line.ground.component, False))
        for message in line.vehicle.feed(packet):
            done = line.station.handle_message(message, data.draw(st.integers(0, 2**60)))
            assert len(line.ground.feed(b"".join(done.replies))) == len(done.replies)
    line.station.due(0)


def test_a_vehicle_without_modes_is_refused(dialect):
    with pytest.raises(InputError, match="needs at least one mode"):
        Station(Endpoint(dialect, 1, 1, unsigned=True), parameters(), {})


def test_streams_are_sent_while_a_station_is_present(dialect):
    endpoint = Endpoint(dialect, 1, 1, unsigned=True)
    streams = Streams(endpoint, {"ATTITUDE": TelemetryStream(lambda now: {}, seconds("0.5"))})
    line = Line(dialect, streams=streams)

    def told(start, end):
        half = seconds("0.5")
        return sum(m.name == "ATTITUDE" for k in range(2 * start, 2 * end) for m in line.due(k * half))

    assert told(0, 5) == 0
    line.ask("HEARTBEAT", now=seconds(5))
    assert told(5, 30) == 20
    own = Endpoint(dialect, 1, 191, unsigned=True).pack("HEARTBEAT")
    for message in line.vehicle.feed(own):
        line.station.handle_message(message, seconds(30))
    assert told(30, 35) == 0
    line.ask("HEARTBEAT", now=seconds(35))
    line.ask("REQUEST_DATA_STREAM", now=seconds(35), target_system=1, req_stream_id=10, start_stop=0)
    assert told(35, 40) == 0
    result, _, _ = line.command(511, 30, 500_000)
    assert result == 0
    assert told(35, 40) == 10
    assert line.command(511, 31, 500_000)[0] == 3


LAND, PAUSE_CONTINUE, OVERRIDE_GOTO = 21, 193, 252


@pytest.mark.parametrize(
    ("number", "params", "request_"),
    [
        (OVERRIDE_GOTO, (0, 2), "hold"),
        (OVERRIDE_GOTO, (0, 0), "hold"),
        (OVERRIDE_GOTO, (1, 2), "resume"),
        (PAUSE_CONTINUE, (0,), "hold"),
        (PAUSE_CONTINUE, (1,), "resume"),
        (LAND, (), "end"),
    ],
)
def test_flight_requests_are_forwarded_while_autopilot_is_available(line, number, params, request_):
    line.station.status = Status(autopilot_problem="")
    assert line.command(number, *params) == (CommandResult.ACCEPTED, "", [FlightRequest(request_)])
    line.station.status = Status(autopilot_problem="nobody is there")
    result, text, events = line.command(number, *params)
    assert (result, events) == (CommandResult.NOT_NOW, [])
    assert text == f"Cannot {request_}: nobody is there"


@pytest.mark.parametrize(("number", "params"), [(OVERRIDE_GOTO, (0, 3)), (OVERRIDE_GOTO, (7,)), (PAUSE_CONTINUE, (2,))])
def test_hold_at_another_position_is_denied(line, number, params):
    line.station.status = Status(autopilot_problem="")
    assert line.command(number, *params) == (CommandResult.DENIED, "", [])


def test_land_command_is_refused_without_an_autopilot(line):
    assert line.command(LAND)[0] == CommandResult.NOT_NOW

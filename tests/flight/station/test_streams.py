"""Message rates set by ground stations, counted over the vehicle's time."""

from collections import Counter

import pytest
from flight.station.test_parameters import parameters

from trimtab.core.time import ms, seconds
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import CommandCode, CommandResult, Severity
from trimtab.flight.station.standard_services import Station
from trimtab.flight.station.streams import Streams, TelemetryStream, TextAssembly, pack_text

ATTITUDE, LANDED, IMU, INTERVAL, UNKNOWN = 30, 245, 105, 244, 31


class Line:
    """A vehicle's streams and a ground station that receives them."""

    def __init__(self, dialect) -> None:
        self.vehicle = Endpoint(dialect, 1, 1, unsigned=True)
        self.ground = Endpoint(dialect, 255, 190, unsigned=True)
        self.imu = None
        told = {
            "ATTITUDE": TelemetryStream(lambda now: {"time_boot_ms": now // ms(1)}, ms(250)),
            "EXTENDED_SYS_STATE": TelemetryStream(lambda now: {"landed_state": 1}, seconds(1)),
            "HIGHRES_IMU": TelemetryStream(lambda now: self.imu, ms(500)),
        }
        self.streams = Streams(self.vehicle, told)
        self.now = 0

    def count(self, duration):
        """Number of messages of each name sent within a duration."""
        found = Counter()
        for _ in range(duration // ms(1)):
            packets = self.streams.due(self.now)
            assert len(packets) <= 1
            found.update(m.name for m in self.ground.feed(b"".join(packets)))
            self.now += ms(1)
        return dict(found)

    def order(self, command, first, second=0.0):
        result, packets = self.streams.handle_command(command, first, second, self.now)
        return result, self.ground.feed(b"".join(packets))

    def ask(self, stream, rate, start=1):
        fields = {"req_stream_id": stream, "req_message_rate": rate, "start_stop": start}
        for message in self.vehicle.feed(self.ground.pack("REQUEST_DATA_STREAM", fields)):
            self.streams.ask(message, self.now)


@pytest.fixture
def line(dialect):
    return Line(dialect)


def test_each_stream_has_its_rate_and_empty_ones_pause(line):
    assert line.count(seconds(10)) == {"ATTITUDE": 40, "EXTENDED_SYS_STATE": 10}
    line.imu = {"xacc": 1.0}
    assert line.count(seconds(10)) == {"ATTITUDE": 40, "EXTENDED_SYS_STATE": 10, "HIGHRES_IMU": 20}


def test_message_interval_can_be_set_read_reset_and_stopped(line):
    assert line.order(CommandCode.SET_INTERVAL, ATTITUDE, 100_000)[0] == CommandResult.ACCEPTED
    assert line.count(seconds(10))["ATTITUDE"] == pytest.approx(100, abs=1)
    (told,) = line.order(CommandCode.REQUEST_MESSAGE, INTERVAL, ATTITUDE)[1]
    assert told.fields() == {"message_id": ATTITUDE, "interval_us": 100_000}
    assert line.order(CommandCode.SET_INTERVAL, ATTITUDE, -1)[0] == CommandResult.ACCEPTED
    assert "ATTITUDE" not in line.count(seconds(2))
    (told,) = line.order(CommandCode.GET_INTERVAL, ATTITUDE)[1]
    assert told.get("interval_us") == -1
    assert line.order(CommandCode.SET_INTERVAL, ATTITUDE, 0)[0] == CommandResult.ACCEPTED
    assert line.count(seconds(10))["ATTITUDE"] == pytest.approx(40, abs=1)


def test_stream_rate_is_limited_to_50_hz(line):
    for asked in (1, 19_999):
        assert line.order(CommandCode.SET_INTERVAL, ATTITUDE, asked)[0] == CommandResult.ACCEPTED
        assert line.count(seconds(2))["ATTITUDE"] == pytest.approx(100, abs=1)
    line.ask(10, 65535)
    assert line.count(seconds(2))["ATTITUDE"] == pytest.approx(100, abs=1)


@pytest.mark.parametrize("number", [UNKNOWN, -1.0, 1e30, float("nan"), float("inf")])
def test_unknown_messages_cannot_be_requested(line, number):
    for command in (CommandCode.SET_INTERVAL, CommandCode.GET_INTERVAL, CommandCode.REQUEST_MESSAGE, 9999):
        assert line.order(command, number) == (CommandResult.UNSUPPORTED, [])
    assert line.order(9999, ATTITUDE) == (CommandResult.UNSUPPORTED, [])


@pytest.mark.parametrize("micros", [float("nan"), float("inf"), -2.0])
def test_invalid_interval_is_denied(line, micros):
    assert line.order(CommandCode.SET_INTERVAL, ATTITUDE, micros)[0] == CommandResult.DENIED
    assert line.count(seconds(10))["ATTITUDE"] == 40


def test_one_message_is_sent_on_request(line):
    result, (message,) = line.order(CommandCode.REQUEST_MESSAGE, LANDED)
    assert (result, message.get("landed_state")) == (CommandResult.ACCEPTED, 1)
    assert line.order(CommandCode.REQUEST_MESSAGE, IMU) == (CommandResult.NOT_NOW, [])


def test_data_stream_request_sets_rates_of_a_group(line):
    line.ask(10, 0)
    assert "ATTITUDE" not in line.count(seconds(2))
    line.ask(10, 20)
    found = line.count(seconds(2))
    assert found["ATTITUDE"] == pytest.approx(40, abs=1)
    assert found["EXTENDED_SYS_STATE"] == 2
    line.ask(0, 5)
    found = line.count(seconds(2))
    assert [found[n] for n in ("ATTITUDE", "EXTENDED_SYS_STATE")] == pytest.approx([10, 10], abs=1)
    line.ask(0, 5, start=0)
    assert line.count(seconds(2)) == {}
    line.ask(77, 5)
    assert line.count(seconds(2)) == {}


@pytest.mark.parametrize("order", [(4, 25), (25, 4), (10, 0)])
def test_last_of_several_stations_sets_the_rate_for_all(dialect, order):
    """Each of two stations requests its own rate (Hz) of one message. 0: the station stops the message."""
    vehicle = Endpoint(dialect, 1, 1, unsigned=True)
    attitude = TelemetryStream(lambda now: {"time_boot_ms": now // ms(1)}, ms(250))
    landed = TelemetryStream(lambda now: {"landed_state": 1}, seconds(1))
    streams = Streams(vehicle, {"ATTITUDE": attitude, "EXTENDED_SYS_STATE": landed})
    station = Station(vehicle, parameters(), {0: "MANUAL"}, streams=streams)
    for system, rate in zip((254, 255), order, strict=True):
        ground = Endpoint(dialect, system, 190, unsigned=True)
        interval = 1e6 / rate if rate else -1
        fields = {"command": CommandCode.SET_INTERVAL, "param1": ATTITUDE, "param2": interval, "target_system": 1}
        for packet in (ground.pack("HEARTBEAT", {}), ground.pack("COMMAND_LONG", fields)):
            for message in vehicle.feed(packet):
                replies = station.handle_message(message, 0).replies
        assert [m.get("result") for m in ground.feed(b"".join(replies))] == [CommandResult.ACCEPTED]
    found = Counter(m.name for t in range(2000) for p in station.due(ms(1) * t) for m in ground.feed(p))
    assert found["ATTITUDE"] == pytest.approx(2 * order[-1], abs=1)
    assert found["EXTENDED_SYS_STATE"] == 2


def test_after_a_pause_there_is_no_burst(line):
    line.count(seconds(1))
    line.now += seconds(60)
    assert line.count(seconds(1))["ATTITUDE"] <= 5


def test_vehicle_without_streams_sends_no_messages(dialect):
    streams = Streams(Endpoint(dialect, 1, 1, unsigned=True), {})
    assert streams.due(seconds(100)) == []


@pytest.mark.parametrize("before", range(44, 52))
def test_multibyte_character_is_not_split_between_messages(dialect, before):
    here, there = (Endpoint(dialect, s, 1, unsigned=True) for s in (1, 2))
    assembly = TextAssembly()
    text = "x" * before + "∞ s, at most 0.28 s; °µ"
    packets = pack_text(here, Severity.WARNING, text)
    messages = [m for p in packets for m in there.feed(p)]
    assert all("\ufffd" not in m.get("text") for m in messages)
    lines = [assembly.join(m) for m in messages]
    assert lines[:-1] == [None] * (len(lines) - 1)
    assert lines[-1].replace(" ", "") == text.replace(" ", "")
    assert len(lines[-1]) - len(text) <= 2

import numpy as np
import pytest
from flight.mavlink.line import every
from run.stand_ins import dialect

from trimtab.core.time import ms
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.station.identity import (
    MOST_ASKS,
    PAYLOAD,
    IdentityComparison,
    IdentityService,
    digest_number,
    format_value,
    identity_digest,
)

_, DIALECT = dialect({"compass": every()}, every())
WORLD = {f"world.vehicle.number_{k}": repr(k / 7) for k in range(40)} | {"scenario": "hovercraft/spin"}


class Line:
    """Both ends of a link. lose: True for the numbers of packets that are lost."""

    def __init__(self, theirs, ours, lose=lambda n: False):
        self.vehicle, self.pilot = Endpoint(DIALECT, 1, 1, unsigned=True), Endpoint(DIALECT, 1, 191, unsigned=True)
        self.service = IdentityService(self.vehicle, theirs)
        self.comparison, self.now, self.sent, self.lose = IdentityComparison(self.pilot, ours), 0, 0, lose

    def run(self, duration):
        for _ in range(0, duration, ms(10)):
            self.now += ms(10)
            for packet in self.comparison.due(self.now, 1, 1):
                self.sent += 1
                if self.lose(self.sent):
                    continue
                (message,) = self.vehicle.feed(packet)
                for answer in self.service.answer(message):
                    assert len(answer) < PAYLOAD + 40
                    (back,) = self.pilot.feed(answer)
                    self.comparison.handle_message(back)
        return self.comparison


def line_number(entries):
    """Number of an identity as sent in an arming request."""
    number = digest_number(identity_digest(entries))
    assert float(np.float32(number)) == number
    return number


def test_equal_settings_show_no_differences():
    comparison = Line(WORLD, WORLD).run(ms(2000))
    assert comparison.is_known
    assert comparison.differences() == []
    assert comparison.number == line_number(WORLD) != 0


def test_later_setting_change_is_detected():
    line = Line(WORLD, WORLD)
    assert line.run(ms(1000)).differences() == []
    line.service.change("world.vehicle.number_3", np.float64(9.0))
    assert [d.path for d in line.run(ms(1500)).differences()] == ["world.vehicle.number_3"]
    line.service.change("world.vehicle.number_3", np.float64(3 / 7))
    assert line.run(ms(1500)).differences() == []
    assert line.comparison.number == line.service.number == line_number(WORLD)


@pytest.mark.parametrize("lose", [lambda n: False, lambda n: n % 3 == 1])
def test_differences_give_path_and_values_despite_packet_loss(lose):
    theirs = WORLD | {"world.vehicle.number_7": "2.8", "scenario": "hovercraft/forward", "only.there": "1.0"}
    ours = WORLD | {"only.here": "2.0"}
    line = Line(theirs, ours, lose)
    comparison = line.run(ms(4000))
    assert comparison.is_known
    assert [str(d) for d in comparison.differences()] == [
        "only.here: none on the vehicle, 2.0 here",
        "only.there: 1.0 on the vehicle, none here",
        "scenario: hovercraft/forward on the vehicle, hovercraft/spin here",
        "world.vehicle.number_7: 2.8 on the vehicle, 1.0 here",
    ]
    left = comparison.differences(lambda path: path.startswith("only") or path == "scenario")
    assert [d.path for d in left] == ["world.vehicle.number_7"]


def test_vehicle_that_never_answers_is_reported_unanswered():
    line = Line(WORLD, WORLD, lambda n: True)
    assert not line.run(ms(500) * (MOST_ASKS - 1)).is_unanswered
    assert line.run(ms(1500)).is_unanswered
    assert line.comparison.differences() == []


def test_setting_changed_on_the_vehicle_is_a_difference():
    line = Line(WORLD, WORLD)
    line.service.change("world.vehicle.number_3", np.float64(9.0))
    line.service.change("nothing.of.it", 1.0)
    assert [str(d) for d in line.run(ms(3000)).differences()] == [
        "world.vehicle.number_3: 9.0 on the vehicle, 0.42857142857142855 here"
    ]


def test_values_keep_all_digits_and_tables_are_hashed():
    assert format_value(0.1 + 0.2) == "0.30000000000000004"
    assert (format_value("text"), format_value(True), format_value(None)) == ("text", "True", "None")
    assert format_value(np.array([1, 2.5])) == "1.0 2.5"
    table = np.arange(100.0)
    other = table.copy()
    other[50] = np.nextafter(50.0, 51.0)
    assert format_value(table).startswith("100 numbers, hash ")
    assert format_value(table) != format_value(other)
    assert identity_digest({"a": "1", "b": "2"}) == identity_digest({"b": "2", "a": "1"})
    assert identity_digest({"a": "1"}) != identity_digest({"a": "2"})


def test_invalid_packets_are_ignored():
    line = Line(WORLD, WORLD)
    for kind, length, payload in ((0xF475, 3, ()), (0xF475, 128, ()), (7, 20, ()), (0xF475, 255, (255,) * 128)):
        fields = {"payload_type": kind, "payload_length": length, "payload": (*payload, *(0,) * (128 - len(payload)))}
        (message,) = line.pilot.feed(line.vehicle.pack("TUNNEL", fields))
        line.comparison.handle_message(message)
    assert line.run(ms(9000)).is_known  # the true answer counts, when it comes
    (request,) = line.vehicle.feed(
        line.pilot.pack("TUNNEL", {"payload_type": 0xF474, "payload_length": 2, "target_system": 9})
    )
    assert line.service.answer(request) == []

"""The autopilot's view of a vehicle, message by message, with a clock set by the test."""

import itertools

import pytest
from flight.mavlink.line import every
from run.stand_ins import KEY, Link, dialect, ends

from trimtab.core.time import ms, seconds
from trimtab.flight.connection_problem import owner_problem
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.mavlink.protocol import CommandCode, CommandResult, State
from trimtab.flight.remote import RemoteVehicle
from trimtab.flight.scenario_comparison import MOST_ASKS
from trimtab.flight.station.identity import TUNNEL, IdentityComparison, IdentityService
from trimtab.flight.vehicle_clock import QUICK_ANSWERS

NOT_ARMED = "the vehicle was not armed at the end"

_, DIALECT = dialect({"compass": every()}, every())
_, OTHER = dialect({"compass": every(), "sonar": every()}, every())
ARMED = 128
SETTINGS = {"world.vehicle.mass": "2.6"}
AHEAD = 5_000_000_000
"""The vehicle's clock less the autopilot's."""


class Line:
    """A vehicle whose answers the test controls, and the RemoteVehicle that receives them."""

    def __init__(self, of=DIALECT, settings=None):
        both = ends(DIALECT)
        self.here, self.there, self.link = both.here, both.there, Link()
        identity = None if settings is None else IdentityComparison(self.here, settings)
        self.service = IdentityService(self.there, SETTINGS)
        self.of, self.now, self.said, self.answers = of, 0, [], True
        self.remote = RemoteVehicle(self.here, self.link, identity=identity, tell=self.said.append)
        self.orders = []

    def hear(self, name, sender=None, **fields):
        for message in self.here.feed((sender or self.there).pack(name, fields)):
            self.link.heard += 1
            self.remote.handle_message(message, self.now)

    def beat(self, armed=False, sender=None, autopilot=0):
        self.hear("HEARTBEAT", sender, base_mode=ARMED * armed, autopilot=autopilot)

    def run(self, duration, *, ahead=AHEAD):
        """Advance the time by milliseconds. The vehicle answers requests for time and version."""
        for _ in range(0, duration, ms(1)):
            self.now += ms(1)
            self.remote.due(self.now)
            sent, self.link.sent[:] = list(self.link.sent), []
            for message in (m for packet in sent for m in self.there.feed(packet)):
                if message.name == "TIMESYNC" and message.get("tc1") == 0:
                    self.hear("TIMESYNC", tc1=(self.now + ahead) * 100, ts1=message.get("ts1"))
                elif message.name == TUNNEL:
                    for answer in map(self.here.feed, self.service.answer(message)):
                        self.remote.handle_message(answer[0], self.now)
                elif message.name == "COMMAND_LONG":
                    self.orders.append((self.now // ms(1), message.get("command"), message.get("param1")))
                    if self.answers and message.get("command") == CommandCode.REQUEST_MESSAGE:
                        self.hear("AUTOPILOT_VERSION", flight_custom_version=self.of.fingerprint)

    def arms(self):
        return [(t, wanted) for t, command, wanted in self.orders if command == CommandCode.ARM]


def ready():
    line = Line()
    line.beat()
    line.run(ms(500))
    assert line.remote.is_ready
    return line


def test_vehicle_is_ready_after_heartbeat_and_clock_sync():
    line = Line()
    assert "no vehicle answers" in line.remote.find_problem("a/b").problem
    line.run(ms(300))
    assert not line.remote.is_ready
    line.beat()
    assert "clock" in line.remote.find_problem("a/b").problem
    line.run(ms(50) * (QUICK_ANSWERS - 1))
    assert not line.remote.is_ready
    line.run(ms(60))
    assert line.remote.is_ready
    assert abs(line.remote.clock.offset(line.now) - AHEAD) <= 1
    assert line.remote.clock.sync.to_local(line.now + AHEAD) == line.now


def test_rejects_vehicle_with_different_dialect_fingerprint():
    line = Line(OTHER)
    line.beat()
    line.run(ms(600))
    assert not line.remote.is_ready
    assert OTHER.fingerprint.hex() in line.remote.find_problem("a/b").problem
    assert DIALECT.fingerprint.hex() in line.remote.find_problem("a/b").problem


@pytest.mark.parametrize("how", ["refused", "silent"])
def test_vehicle_without_fingerprint_is_accepted(how):
    line = Line()
    line.answers = False
    line.beat()
    line.run(ms(450))
    assert not line.remote.is_ready
    if how == "refused":
        line.hear("COMMAND_ACK", command=CommandCode.REQUEST_MESSAGE, result=CommandResult.UNSUPPORTED)
    else:
        line.run(ms(500) * MOST_ASKS + ms(100))
    assert line.remote.is_ready


def test_unsigned_frames_and_wrong_keys_are_distinguished():
    line = Line()
    line.link.heard = 3
    stranger = Endpoint(DIALECT, 1, 1, unsigned=True)
    line.beat(sender=stranger)
    assert line.remote.heartbeat_time is None
    problem = line.remote.find_problem("a/b")
    assert problem.problem == "wrong key: the vehicle does not sign its frames, and this end accepts signed frames only"
    assert "--unsigned" in problem.fix
    line.beat(sender=Endpoint(DIALECT, 1, 1, passphrase_key("another-passphrase-than-that")))
    assert "another key than this end" in line.remote.find_problem("a/b").problem


def test_arming_request_repeats_until_acknowledged():
    line = ready()
    line.remote.arming.arm()
    line.run(ms(1200))
    times = [t for t, wanted in line.arms() if wanted == 1.0]
    assert len(times) == 3
    assert all(b - a == 500 for a, b in itertools.pairwise(times))
    line.hear("COMMAND_ACK", command=CommandCode.ARM, result=CommandResult.NOT_NOW)
    assert line.remote.arming.is_asking
    line.hear(
        "COMMAND_ACK", command=CommandCode.ARM, result=CommandResult.ACCEPTED, target_system=1, target_component=77
    )
    assert line.remote.arming.is_asking  # somebody else was answered
    line.hear(
        "COMMAND_ACK", command=CommandCode.ARM, result=CommandResult.ACCEPTED, target_system=1, target_component=191
    )
    assert (line.remote.arming.armed, line.remote.arming.is_asking) == (True, False)
    line.run(ms(1200))
    assert len(line.arms()) == 3
    line.remote.arming.disarm()
    line.run(ms(250))
    assert [wanted for _, wanted in line.arms()][3:] == [0.0] * 3
    line.hear(
        "COMMAND_ACK", command=CommandCode.ARM, result=CommandResult.ACCEPTED, target_system=1, target_component=191
    )
    assert (line.remote.arming.armed, line.remote.arming.is_asking) == (False, False)
    line.run(ms(1200))
    assert len(line.arms()) == 6


def test_authority_over_armed_vehicle_needs_own_acknowledgement():
    line = ready()
    line.beat(armed=True)
    line.remote.arming.arm()
    line.run(ms(600))
    assert len(line.arms()) == 2
    ack = {"command": CommandCode.ARM, "target_system": 1, "target_component": 191}
    line.hear("COMMAND_ACK", result=CommandResult.DENIED, result_param2=77, **ack)
    assert (line.remote.arming.is_taken, line.remote.arming.has_authority) == (True, False)
    line.hear("COMMAND_ACK", result=CommandResult.ACCEPTED, result_param2=77, **ack)  # another's was answered
    assert (line.remote.arming.is_asking, line.remote.arming.has_authority) == (True, False)
    line.hear("COMMAND_ACK", result=CommandResult.ACCEPTED, result_param2=line.here.session, **ack)
    assert (line.remote.arming.is_asking, line.remote.arming.has_authority) == (False, True)
    problem = owner_problem(77, "trimtab fly it")
    assert "00004d" in problem.problem
    assert problem.fix.startswith("trimtab fly it --take-over")


@pytest.mark.parametrize("mass", ["2.6", "3.0"])
def test_settings_are_compared_before_taking_over_a_flight(mass):
    line = Line(settings={"world.vehicle.mass": mass})
    line.beat(armed=True)
    line.run(ms(900))
    assert line.remote.is_ready == (mass == "2.6")
    assert line.remote.comparison.misfit == ("" if mass == "2.6" else "wrong scenario")


def test_other_senders_are_not_taken_for_the_vehicle():
    """Some ground stations set the armed flag in their heartbeats."""
    line = ready()
    station, second = Endpoint(DIALECT, 255, 190, KEY), Endpoint(DIALECT, 2, 1, KEY)
    line.beat(armed=True, sender=station, autopilot=8)
    line.beat(armed=True, sender=second)
    assert not line.remote.arming.armed
    for stranger in (station, second):
        ask = line.remote.clock.sync.ask(line.now)
        line.hear("TIMESYNC", stranger, tc1=12345, ts1=ask["ts1"])
        line.hear("STATUSTEXT", stranger, text="hello")
        line.hear("AUTOPILOT_VERSION", stranger, flight_custom_version=OTHER.fingerprint)
    assert abs(line.remote.clock.offset(line.now) - AHEAD) <= 1
    assert (line.said, line.remote.comparison.misfit) == ([], "")


def test_vehicle_reboot_is_reported_and_its_clock_resynchronised():
    line = ready()
    line.beat(armed=True)
    line.run(seconds(3))
    line.beat(armed=False)
    line.run(seconds(2), ahead=-1000)
    assert line.said == ["the vehicle is no longer armed", "the vehicle's clock has changed"]
    assert abs(line.remote.clock.offset(line.now) + 1000) <= 1


def test_small_clock_offset_changes_are_slewed_not_stepped():
    """Samples that are 40 ms old arrive continuously. Their times and those of commands increase."""
    line = ready()
    line.remote.clock.sync.to_local(line.now + AHEAD - ms(40))
    before = line.remote.clock.offset(line.now)
    applied, given = [], []
    for _ in range(3000):
        line.run(ms(1), ahead=AHEAD + ms(5))
        applied.append(line.remote.clock.offset(line.now))
        given.append(line.remote.clock.sync.to_local(line.now + AHEAD - ms(40)))
    assert min(b - a for a, b in itertools.pairwise(given)) > ms(1) - 11
    steps = [abs(b - a) for a, b in zip([before, *applied], applied, strict=False)]
    assert sorted(steps)[-4] <= 11  # a thousandth of a millisecond is 10 units
    assert max(steps) <= 11 + 2 * ms(40) // 1000  # a turn begins where the newest sample was
    assert applied[-1] - before > 1000


def test_control_characters_in_vehicle_texts_are_replaced():
    line = ready()
    line.hear("STATUSTEXT", text="failsafe: no command\x1b[2J\nx")
    assert line.said == ["vehicle: failsafe: no command?[2J?x"]


GOTO, LAND, ACK = 252, 21, "COMMAND_ACK"


def asked(line, command, first=0.0, *, to=191, sender=None):
    """Forward a request. Return the results answered."""
    line.link.sent.clear()
    fields = {"command": command, "param1": first, "target_system": 1, "target_component": to}
    line.hear("COMMAND_LONG", sender, **fields)
    messages = [m for packet in line.link.sent for m in line.there.feed(packet)]
    return [m.get("result") for m in messages if m.name == ACK]


def test_forwarded_requests_are_queued_for_supervisor_and_acknowledged():
    line = ready()
    assert asked(line, GOTO) == [CommandResult.UNSUPPORTED]  # no supervisor
    line.remote.requests.mode = 1
    assert asked(line, GOTO) == [CommandResult.ACCEPTED]
    assert asked(line, GOTO, 1.0) == [CommandResult.ACCEPTED]
    assert asked(line, LAND) == [CommandResult.ACCEPTED]
    assert asked(line, GOTO, 9.0) == [CommandResult.UNSUPPORTED]
    assert asked(line, LAND, to=1) == []
    assert asked(line, LAND, sender=Endpoint(DIALECT, 255, 190, KEY)) == []
    assert list(line.remote.requests.pending) == ["hold", "resume", "end"]


def test_heartbeat_sends_a_new_supervisor_mode_at_once():
    line = ready()
    found = []
    for mode in (None, 1, 1, 2):
        line.remote.requests.mode = mode
        line.link.sent.clear()
        for _ in range(5):
            line.now += ms(1)
            line.remote.due(line.now)
        messages = [m for packet in line.link.sent for m in line.there.feed(packet)]
        found += [(m.get("base_mode"), m.get("custom_mode")) for m in messages if m.name == "HEARTBEAT"]
    assert found == [(1, 1), (1, 2)]


def test_accepted_path_covers_its_children_but_never_messages():
    remote = RemoteVehicle(Endpoint(DIALECT, 1, 191, KEY), Link(), accepts=["world.vehicle", "messages"])
    paths = ("world.vehicle", "world.vehicle.mass", "world.vehicles", "world", "messages")
    assert [remote.comparison.accepts(path) for path in paths] == [True, True, False, False, False]


def test_past_failsafe_of_own_flight_is_a_problem():
    line = ready()
    line.beat()
    line.hear("HEARTBEAT", base_mode=0, autopilot=0, system_status=State.CRITICAL)
    assert line.remote.arming.list_problems(True, False, line.now) == [NOT_ARMED]  # it was nobody's
    line.remote.arming.has_authority = True
    line.hear("HEARTBEAT", base_mode=0, autopilot=0, system_status=State.CRITICAL)
    line.beat(armed=True)
    assert line.remote.arming.list_problems(True, False, line.now) == ["the vehicle's failsafe acted"]
    assert "no data from the vehicle at the end" in line.remote.arming.list_problems(True, True, line.now)


def test_only_early_vehicle_end_or_disarm_is_a_problem():
    """Both ends have the same duration, and the vehicle's clock started a little earlier."""
    for state, after, wanted in ((State.POWEROFF, 100, []), (State.POWEROFF, 1100, [NOT_ARMED]), (3, 100, [NOT_ARMED])):
        line = ready()
        line.beat(armed=True)
        line.hear("HEARTBEAT", base_mode=0, autopilot=0, system_status=state)
        line.hear("HEARTBEAT", base_mode=0, autopilot=0, system_status=state)
        assert line.remote.arming.list_problems(True, False, line.now + ms(after)) == wanted

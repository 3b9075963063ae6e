"""A vehicle's answers to wrong clocks and wrong keys, on a virtual network."""

import pytest
from flight.mavlink.line import every
from flight.transports.virtual_line import open_virtual_line
from run.stand_ins import KEY, dialect

from trimtab.flight.clock_refusals import ANSWER_PERIOD, REPORT_PERIOD, RefusalAnswers
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.remote import RemoteVehicle

_, DIALECT = dialect({"compass": every()}, every())
DAY = 86_400.0
OTHER_KEY = passphrase_key("another-passphrase-than-that")


def seconds_of(text, form):
    """Number in the text at the place of {} in the form."""
    before, after = form.split("{}")
    assert text.startswith(before)
    number, space, rest = text.removeprefix(before).partition(" ")
    assert (space + rest).startswith(after)
    return float(number)


class Line:
    """A vehicle and an autopilot that may have another clock or key, on one UDP port."""

    def __init__(self, difference=0.0, key=KEY):
        line = open_virtual_line()
        self.there, self.here, self.unix = line.listen(), line.call(), line.clock.unix
        self.pause = line.pause
        self.vehicle = Endpoint(DIALECT, 1, 1, KEY, clock=self.unix)
        self.said, self.heard, self.now = [], [], 0
        self.answers = RefusalAnswers(self.vehicle, self.there, self.said.append)
        self.start_pilot(Endpoint(DIALECT, 1, 191, key, clock=lambda: self.unix() + difference))

    def start_pilot(self, endpoint, options=""):
        """Start the autopilot, or restart it with another endpoint. options: further command line options."""
        self.pilot, typed = endpoint, f"trimtab fly it --link there{options}"
        self.remote = RemoteVehicle(endpoint, self.here, typed=typed, tell=self.heard.append)

    def run(self, ms):
        """Run both ends for a number of milliseconds. Return the messages the vehicle accepted."""
        accepted = []
        for _ in range(0, ms, 10):
            self.now += 100_000
            self.pause(0.01)
            self.remote.due(self.now)
            while (data := self.there.receive(0.0)) is not None:
                accepted += self.vehicle.feed(data)
                self.answers.handle_refusals(self.now)
            while (data := self.here.receive(0.0)) is not None:
                for message in self.pilot.feed(data):
                    self.remote.handle_message(message, self.now)
                self.remote.clock.handle_untimely(self.pilot.untimely)
        return accepted

    def close(self):
        self.there.close()
        self.here.close()


@pytest.fixture
def opened(request):
    lines = []

    def make(*arguments, **kinds):
        lines.append(Line(*arguments, **kinds))
        return lines[-1]

    yield make
    for line in lines:
        line.close()


def test_autopilot_clock_30_s_behind_catches_up(opened):
    """Regression: the autopilot was refused for half a minute, longer than its timeout."""
    line = opened(-30.0)
    accepted = line.run(400)
    assert {m.name for m in accepted} == {"TIMESYNC"}
    assert line.vehicle.counts.stale > 0
    assert seconds_of(
        line.said[0], "refused: the clock of 1/191 is {} s behind this computer's clock"
    ) == pytest.approx(30, abs=2)
    assert line.remote.clock.untimely is None


@pytest.mark.parametrize(("difference", "which"), [(-120.0, "ahead of"), (120.0, "behind"), (DAY, "behind")])
def test_larger_clock_difference_is_reported_and_follow_fixes_it(opened, difference, which):
    line = opened(difference)
    before = line.vehicle.stamps.last
    assert line.run(500) == []
    assert line.vehicle.stamps.last - before < 1e5  # nothing moved
    far = abs(difference)
    problem = line.remote.find_problem("it")
    told = f"wrong clock: clocks differ by {{}} s, the vehicle's is {which} this computer's"
    assert seconds_of(problem.problem, told) == pytest.approx(far, abs=2)
    assert problem.fix.startswith("trimtab fly it --link there --clock vehicle")
    opposite = {"ahead of": "behind", "behind": "ahead of"}[which]
    (said,) = line.said
    assert seconds_of(said, f"refused: the clock of 1/191 is {{}} s {opposite} this computer's clock") == pytest.approx(
        far, abs=2
    )
    line.remote.clock.follow()
    assert len(line.run(300)) > 3
    assert line.pilot.counts.refusals == line.pilot.counts.stale + line.pilot.counts.leading


def test_wrong_key_is_diagnosed_at_both_ends(opened):
    line = opened(key=OTHER_KEY)
    assert line.run(500) == []
    problem = line.remote.find_problem("it")
    assert problem.problem.startswith("wrong key: ")
    assert problem.fix.startswith("trimtab fly it --link there --key FILE")
    assert line.said == ["refused: 1 frames so far were unsigned or signed with another key"]
    assert not line.there.peers  # it is told nothing else


def test_unsigned_autopilot_is_asked_for_a_key(opened):
    line = opened()
    line.start_pilot(Endpoint(DIALECT, 1, 191, unsigned=True, clock=line.unix), " --unsigned")
    assert line.run(500) == []
    problem = line.remote.find_problem("it")
    assert problem.problem == "wrong key: the vehicle accepts signed frames only, and this end has no key"
    assert problem.fix == "trimtab fly it --link there"


def test_refusal_answers_and_reports_are_rate_limited(opened):
    line = opened(-120.0)
    for _ in range(200):
        line.vehicle.feed(line.pilot.pack("TIMESYNC", {"ts1": 5}))
        line.there._sender = line.here._socket.address
        line.answers.handle_refusals(line.now)
        line.now += ANSWER_PERIOD // 20
    assert line.there.statistics.packets_out == 10
    assert len(line.said) == 1
    line.now += REPORT_PERIOD
    line.vehicle.feed(line.pilot.pack("TIMESYNC", {"ts1": 5}))
    line.answers.handle_refusals(line.now)
    assert len(line.said) == 2


def test_replayed_time_answers_do_not_set_the_vehicle_clock(opened):
    """Frames that were recorded yesterday and replayed must not set the clock."""
    line = opened()
    old = Endpoint(DIALECT, 1, 1, KEY, clock=lambda: line.unix() - DAY)
    line.remote.due(0)
    for fields in ({"tc1": 5, "ts1": 12345}, {"ts1": 0}):
        line.pilot.feed(old.pack("TIMESYNC", fields))
        line.remote.clock.handle_untimely(line.pilot.untimely)
    line.pilot.feed(old.pack("HEARTBEAT"))
    line.remote.clock.handle_untimely(line.pilot.untimely)
    assert line.pilot.counts.stale == 3
    assert line.remote.clock.untimely is None


def test_suggested_option_resets_a_stored_future_time_stamp(opened, tmp_path):
    key = passphrase_key("correct-horse-battery-staple", tmp_path / "a.key")
    line = opened()
    Endpoint(DIALECT, 1, 191, key, clock=lambda: line.unix() + DAY).close()
    line.start_pilot(Endpoint(DIALECT, 1, 191, key, clock=line.unix))
    assert line.run(300) == []
    problem = line.remote.find_problem("it")
    assert problem.fix == "trimtab fly it --link there --clock computer"
    assert seconds_of(problem.problem, "wrong clock: the stored time stamp is {} s ahead, ") == pytest.approx(
        DAY, abs=2
    )
    line.pilot.close()
    line.start_pilot(Endpoint(DIALECT, 1, 191, key, clock=line.unix, is_reset=True))
    assert len(line.run(300)) > 3
    line.pilot.close()


def test_ground_station_without_key_gets_no_answer(opened):
    line = opened()
    station = Endpoint(DIALECT, 255, 190, unsigned=True)
    for name in ("HEARTBEAT", "TIMESYNC"):
        line.here.send(station.pack(name, {}))
    assert line.run(300) != []
    answers = line.there.statistics.packets_out
    line.there._counts.packets_out = 0
    for _ in range(5):
        line.here.send(station.pack("TIMESYNC", {"ts1": 3}))
        data = line.there.receive(1.0)
        assert line.vehicle.feed(data) == []
        line.answers.handle_refusals(line.now + 10 * REPORT_PERIOD)
    assert line.there.statistics.packets_out == 0
    assert answers == 0

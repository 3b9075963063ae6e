"""`trimtab inject` against a simulated peer that answers message by message."""

import json
import threading

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.core.time import FOREVER, seconds
from trimtab.flight.autopilot_end import scenario_dialect
from trimtab.flight.injector import Injector, add_idle_faults, format_value
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import passphrase_key
from trimtab.flight.station.parameters import Parameters
from trimtab.flight.station.standard_services import Station
from trimtab.flight.transports.open_link import open_link
from trimtab.loop.faults import KINDS
from trimtab.scenarios import catalogue

NAME = "hovercraft/forward"
NOW = seconds(123)


def test_fault_values_are_formatted_with_their_unit():
    scenario, _ = catalogue.load_scenario(NAME)
    listed = {p.path: p.declaration for p in Parameters(add_idle_faults(scenario).world, "world").listed}
    start, duration, word = (listed[f"world.downlink.fault.{name}"] for name in ("start", "duration", "kind"))
    assert format_value(start, float(seconds(6) + 2841735)) == "6284.1735 ms"
    assert format_value(duration, float(seconds(2))) == "2 s"
    assert format_value(duration, float(FOREVER)) == "until the end"
    assert format_value(word, float(KINDS.index("off"))) == "off"


class Heard:
    """Link on which the same packet arrives every 0.1 s; it is also the clock."""

    def __init__(self, packet):
        self.packet, self.now = packet, 0

    def send(self, packet):
        pass

    def receive(self, timeout):
        self.now += 100_000_000
        return self.packet

    def monotonic_ns(self):
        return self.now


def test_vehicle_with_another_key_is_reported_as_wrong_key():
    scenario, _ = catalogue.load_scenario(NAME)
    dialect, (theirs, ours) = scenario_dialect(scenario), (passphrase_key(f"a-key-for-tests-{k}") for k in range(2))
    link = Heard(Endpoint(dialect, 1, 1, theirs).pack("HEARTBEAT", {}))
    with pytest.raises(InputError, match="wrong key: the vehicle signs with another key") as refused:
        Injector(link, Endpoint(dialect, 1, 192, ours), link).read_vehicle_time()
    assert "copy of the vehicle's key file" in refused.value.fix


class Played:
    """A peer that answers like a vehicle, at a constant time, and records the parameters set."""

    def __init__(self, uri):
        scenario, _ = catalogue.load_scenario(NAME)
        self.link = open_link(uri, listen=True)
        self.endpoint = Endpoint(scenario_dialect(scenario), 1, 1, unsigned=True)
        parameters = Parameters(add_idle_faults(scenario).world, "world")
        self.station = Station(self.endpoint, parameters, {0: "computer"})
        self.set, self.loses, self._ended = [], 0, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._ended.is_set():
            for message in self.endpoint.feed(self.link.receive(0.02)):
                if self.loses:
                    self.loses -= 1
                    continue
                handled = self.station.handle_message(message, NOW)
                self.set += [(e.path, e.value) for e in handled.events]
                for packet in handled.replies:
                    self.link.send(packet)

    def end(self):
        self._ended.set()
        self._thread.join()
        self.link.close()


@pytest.fixture
def played():
    vehicle = Played("loopback://test-inject")
    yield vehicle
    vehicle.end()


def inject(*arguments):
    return CliRunner().invoke(main, ["inject", NAME, *arguments, "--link", "loopback://test-inject", "--unsigned"])


def numbers(played):
    """Return the last value of each parameter set, and the order of the first settings."""
    return dict(played.set), list(dict.fromkeys(path for path, _ in played.set))


@pytest.mark.real_time
def test_fault_starts_relative_to_now_and_its_kind_is_set_last(played):
    done = inject("sensor:navigation stuck @ 2 s for 500 ms", "--json")
    assert done.exit_code == 0, done.output
    found, order = numbers(played)
    before = "world.sensors.navigation.fault."
    assert found[f"{before}start"] == pytest.approx(NOW + seconds(2), rel=1e-7)
    assert found[f"{before}duration"] == seconds("0.5")
    assert found[f"{before}kind"] == KINDS.index("stuck")
    assert order[-1] == f"{before}kind"
    assert set(order) == {f"{before}{n}" for n in ("start", "duration", "kind")}  # the others stay as they are
    assert json.loads(done.stdout) == {
        "answer": "inject/1",
        "fault": "sensor:navigation stuck @ 2 s for 500 ms",
        "from": "125 s",
        "lasts": "for 500 ms",
    }


@pytest.mark.real_time
def test_lost_requests_are_repeated(played):
    played.loses = 2
    done = inject("uplink off")
    assert done.exit_code == 0, done.output
    assert numbers(played)[0]["world.uplink.fault.kind"] == KINDS.index("off")
    assert "uplink off: from 123 s on, until the end" in done.stdout


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("sensor:navigation stuck when w_WB_B.2 above 1", "a condition cannot be set in flight"),
        ("sensor:sonar off", "sonar"),
        ("sensor:navigation exploded", "exploded"),
    ],
)
def test_invalid_fault_is_rejected_before_sending(played, fault, said):
    done = inject(fault)
    assert done.exit_code == 2
    assert said in done.output
    assert played.set == []


@pytest.mark.real_time
def test_no_answer_is_reported_with_vehicle_command(monkeypatch):
    monkeypatch.setattr("trimtab.flight.injector.PATIENCE", 0.3)
    done = inject("uplink off")
    assert done.exit_code == 2
    assert "no vehicle answers" in done.output
    assert "start the vehicle: trimtab vehicle SCENARIO --listen URI" in done.output
    assert "Fix:" in done.output

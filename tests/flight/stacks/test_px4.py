"""A vehicle as PX4's simulator, flown by a fake PX4: lockstep, sensors, errors and a hover."""

import math
import socket
import threading
import time

import numpy as np
import pytest
from click.testing import CliRunner
from flight.pair import Program
from flight.stacks.fake_px4 import Estimate, FakePx4

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.flight.stacks import px4
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.flight.stacks.px4 import Px4Simulator
from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.tcp import open_tcp
from trimtab.logs.mcap import read_mcap
from trimtab.scenarios.build import build
from trimtab.vehicles.quadrotor import Multirotor

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
REST, PUSH = [0.0, 0.0], [0.0, 0.6]


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


@pytest.fixture(scope="module")
def boat():
    """A vessel in still water: rudder and shaft."""
    scenario = build("vessel/path", in_virtual_time=False)
    return scenario, PulsedVehicle(scenario, seed=0, channels=(), release=None)


class Bench:
    """A simulator in a thread, and its port."""

    def __init__(self, scenario, vehicle):
        vehicle.reset()
        self.port, self.said, self.ended = free_port(), [], threading.Event()
        self.link = open_tcp(parse_uri(f"tcp://127.0.0.1:{self.port}"), listen=True)
        self.simulator, self.vehicle = Px4Simulator(scenario, vehicle, self.link), vehicle
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self):
        self.summary = self.simulator.serve(stop=self.ended.is_set, tell=self.said.append)

    def finish(self):
        self.ended.set()
        self.thread.join(20)
        self.link.close()
        return self.summary


@pytest.fixture
def bench(boat):
    made = Bench(*boat)
    yield made
    made.finish()


def fly(pilot, controls, samples, *, armed=True):
    """Answer a number of samples and return them."""
    seen = []
    for _ in range(samples):
        seen.append(pilot.receive())
        pilot.answer(controls, armed=armed)
    return seen


@pytest.mark.real_time
def test_each_answer_steps_and_disarmed_vehicle_stands_still(bench):
    pilot = FakePx4(bench.port)
    while "PX4 is disarmed" not in bench.said:
        pilot.receive()
        pilot.answer(PUSH, armed=False, whole=True)
    standing = fly(pilot, REST, 60)
    assert bench.vehicle.release_time is None
    steps = np.diff([s.time_usec for s in standing])
    assert (steps == 4000).all()
    assert np.mean([s.zacc for s in standing]) == pytest.approx(-9.80665, abs=5 * px4.FORCE_NOISE / math.sqrt(60))
    slow = [k for k, s in enumerate(standing) if s.fields_updated == 0x1FFF]
    assert set(np.diff(slow)) == {5}
    assert all(s.fields_updated == 0b111111 for k, s in enumerate(standing) if k not in slow)
    assert len({s.xacc for s in standing}) > 50  # PX4 takes samples that stay the same for those of a dead sensor
    home = pilot.fix
    moved = fly(pilot, PUSH, 1500)
    pilot.close()
    assert bench.vehicle.release_time is not None
    assert moved[-1].time_usec - standing[0].time_usec == 1559 * 4000
    assert math.hypot(pilot.fix.lat - home.lat, pilot.fix.lon - home.lon) * 0.011 > 0.1
    assert bench.simulator.tally.unanswered == 0
    assert [text for text in bench.said if "armed" in text] == ["PX4 is disarmed", "PX4 is armed"]


@pytest.mark.real_time
def test_magnetic_field_and_pressure_match_the_reported_position(bench):
    pilot = FakePx4(bench.port)
    first = pilot.receive()
    fix = pilot.fix
    pilot.close()
    assert (fix.lat * 1e-7, fix.lon * 1e-7) == pytest.approx((38.9897, -76.9378), abs=0.1)
    heading = bench.vehicle.state().attitude[2]
    north = first.xmag * math.cos(heading) - first.ymag * math.sin(heading)
    assert north == pytest.approx(0.2047, abs=5e-3)
    assert first.zmag == pytest.approx(0.4783, abs=5e-3)
    height = fix.alt * 1e-3
    assert first.abs_pressure == pytest.approx(1013.25 * (1 - 2.25577e-5 * height) ** 5.25588, abs=0.06)


@pytest.mark.real_time
def test_controls_map_to_pulses_from_1_to_2_ms(boat):
    _, vehicle = boat
    spans = [px4.pulse_span(o) for o in vehicle.outputs]
    assert spans == [(pytest.approx(1.5e-3), pytest.approx(1e-3), pytest.approx(2e-3))] * 2


@pytest.mark.real_time
def test_answers_to_old_samples_are_ignored(bench):
    """An autopilot that answers late at first does not stay a sample behind."""
    pilot = FakePx4(bench.port)
    early = [pilot.receive() for _ in range(6)]
    for sample in early[:3]:
        pilot.time = sample.time_usec
        pilot.answer(REST, armed=True)
    pilot.socket.settimeout(0.3)
    newest = early[-1]
    try:
        while True:
            newest = pilot.receive()
    except TimeoutError:
        pass  # it waits for the answer to the newest one
    pilot.socket.settimeout(5)
    pilot.answer(REST, armed=True)
    assert pilot.receive().time_usec == newest.time_usec + 4000
    pilot.socket.settimeout(0.3)
    with pytest.raises(TimeoutError):
        pilot.receive()
    pilot.close()


@pytest.mark.real_time
def test_new_connection_starts_another_flight(bench):
    first = FakePx4(bench.port)
    fly(first, PUSH, 50)
    first.close()
    second = FakePx4(bench.port)
    again = second.receive()
    assert again.time_usec == 1_000_000
    second.answer(REST, armed=False)
    second.receive()
    assert bench.vehicle.release_time is None
    second.close()
    assert bench.finish().flights == 2


@pytest.mark.real_time
def test_missing_answer_is_counted_and_time_continues(bench, monkeypatch):
    monkeypatch.setattr(px4, "SILENCE_S", 0.05)
    pilot = FakePx4(bench.port)
    fly(pilot, REST, 2)
    before = pilot.receive()
    assert pilot.receive().time_usec == before.time_usec + 4000
    pilot.close()
    assert bench.simulator.tally.unanswered >= 1
    assert sum("did not answer a sample" in text for text in bench.said) == 1


@pytest.mark.real_time
def test_px4_without_lockstep_gets_samples_in_real_time(bench):
    pilot = FakePx4(bench.port, is_locked=False)
    begin = time.monotonic()
    samples = [pilot.receive() for _ in range(101)]
    pilot.answer(REST, armed=True)
    took = time.monotonic() - begin
    pilot.close()
    assert samples[-1].time_usec - samples[0].time_usec == 400_000
    assert took >= 0.39
    assert bench.simulator.tally.unanswered == 0


@pytest.mark.real_time
def test_rejects_non_mavlink_2_bytes_and_nan_outputs(bench):
    pilot = FakePx4(bench.port)
    fly(pilot, REST, 2)
    pilot.receive()
    pilot.socket.sendall(b"hello, is this the simulator?")
    pilot.answer([math.nan, 0.0], armed=True)
    fly(pilot, REST, 2)
    pilot.answer(REST, armed=True)
    pilot.receive()
    pilot.close()
    assert bench.simulator.tally.malformed == 1
    assert bench.simulator.tally.refused >= 1
    assert sum("refused bytes that are not MAVLink 2" in text for text in bench.said) == 1
    assert sum("PX4's output 1 is not a finite number" in text for text in bench.said) == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--listen", "udp://:14550", "--px4"), "--listen: does not apply to PX4"),
        (("--lockstep", "--px4"), "--lockstep: does not apply to PX4"),
        (("--px4", "0.0.0.0:4560"), "anyone who reaches 0.0.0.0:4560 could fly the vehicle"),
        (("--ardupilot", "127.0.0.1:9002", "--px4"), "--px4: cannot be combined with --ardupilot"),
        (("--px4", "4560"), "is not HOST:PORT"),
    ],
)
def test_rejects_incompatible_options_before_compiling(words, said):
    refused = CliRunner().invoke(main, ["vehicle", "vessel/path", *words])
    assert refused.exit_code == 2
    assert said in " ".join(refused.output.split())


@pytest.mark.real_time
def test_fake_px4_hovers_the_quadrotor_on_its_sensors(tmp_path):
    """The vehicle stands disarmed, then idles, is released when pulses pass 1.5 ms, and flies to a goal."""
    port = free_port()
    words = ("--set", "trajectory=place", "--release", "1500", "--duration", "10", "--out", str(tmp_path / "there"))
    there = Program("vehicle", "quadrotor/track", *words, "--json", "--px4", f"127.0.0.1:{port}", folder=tmp_path)
    try:
        there.wait_for("waits on")
        pilot, own = FakePx4(port), Estimate()
        for k in range(4000):
            sensor = pilot.receive()
            if sensor is None:
                break
            fix, pilot.fix = pilot.fix, None
            own.follow(sensor, fix)
            controls = [0.1] * 4 if k < 50 else hover(own)
            if not pilot.answer(controls, armed=k >= 25):
                break
        pilot.close()
        ended = there.finished()
    finally:
        if there.process.poll() is None:
            there.process.kill()
            there.process.communicate()
    assert ended.status == 0
    assert ended.result["flights"] == 1
    assert ended.result["frames"]["malformed"] == ended.result["frames"]["unanswered"] == 0
    log = read_mcap(tmp_path / "there" / "vehicle.mcap")
    flown = log["truth.position"][-1] - log["truth.position"][0]
    assert flown == pytest.approx(GOAL, abs=0.05)  # a fix has steps of 1.1 cm
    assert np.linalg.norm(log["truth.velocity"][-1]) < 0.05
    assert log["px4.armed"][-1]
    assert not log["px4.armed"][1]


GOAL = np.array([1.0, 0.0, -2.0])


def hover(own):
    """Position and attitude feedback for the publication's quadrotor: front, right, rear, left; 615 rad/s at 1."""
    craft = Multirotor()
    mass, inertia = float(craft.mass), np.asarray(craft.inertia)
    a = np.clip(2.0 * (GOAL - own.p) - 2.5 * own.v, -2.0, 2.0)
    thrust = mass * (9.81 - a[2])
    moment = inertia * (60.0 * (np.array([a[1] / 9.81, -a[0] / 9.81, 0.0]) - own.attitude) - 14.0 * own.w)
    roll, pitch, yaw = moment / [0.315, 0.315, 0.026]
    shares = [pitch / 2 - yaw / 4, -roll / 2 + yaw / 4, -pitch / 2 - yaw / 4, roll / 2 + yaw / 4]
    speeds = np.sqrt(np.clip(thrust / 4 + np.array(shares), 0.0, None) / 8e-5)
    return np.minimum(speeds / 615.0, 1.0).tolist()

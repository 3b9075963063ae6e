"""A vehicle as ArduPilot's physics, flown by a fake ArduPilot: frames, losses, errors and a hover."""

import math
import socket

import numpy as np
import pytest
from click.testing import CliRunner
from flight.pair import Program
from flight.stacks.fake_ardupilot import FakeArduPilot

from trimtab.cli import main
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.flight.stacks import ardupilot
from trimtab.flight.stacks.ardupilot import ArduPilotPhysics
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.flight.transports.open_link import parse_uri
from trimtab.flight.transports.udp import open_udp
from trimtab.links.wire import Wire
from trimtab.logs.mcap import read_mcap
from trimtab.run.cosimulation import prepare_world
from trimtab.scenarios.build import build
from trimtab.vehicles.quadrotor import Multirotor

pytestmark = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
REST, PUSH = [1500, 1500], [1500, 1800]
STEP = ms(2.5)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


@pytest.fixture(scope="module")
def boat():
    """A vessel in still water: rudder and shaft."""
    scenario = build("vessel/path", in_virtual_time=False)
    return scenario, PulsedVehicle(scenario, seed=0, channels=(), release=None)


class Bench:
    """Physics and fake autopilots in one thread."""

    def __init__(self, scenario, vehicle, log=None):
        vehicle.reset()
        self.port, self.said, self.log = free_port(), [], log
        self.link = open_udp(parse_uri(f"udp://127.0.0.1:{self.port}"), listen=True)
        self.physics, self.vehicle = ArduPilotPhysics(scenario, vehicle, self.link), vehicle
        self.pilot = FakeArduPilot(self.port)

    def handle(self):
        """Handle one waiting packet, without a log."""
        ends = iter([False, True])
        return self.physics.serve(stop=lambda: next(ends), tell=self.said.append)

    def exchange(self, pulses, count=None, pilot=None):
        pilot = pilot or self.pilot
        pilot.send(pulses, count)
        self.handle()
        return pilot.receive()

    def close(self):
        self.pilot.close()
        self.link.close()


@pytest.fixture
def bench(boat):
    made = Bench(*boat)
    yield made
    made.close()


@pytest.mark.real_time
def test_vehicle_is_held_until_pulses_then_steps_per_frame(bench):
    states = [bench.exchange(REST) for _ in range(3)]
    assert [s["timestamp"] for s in states] == [0.0, 0.0025, 0.005]
    assert all(s["accel_body"][2] == pytest.approx(-9.80665) and s["velocity"] == [0, 0, 0] for s in states)
    assert bench.vehicle.release_time is None
    start = states[-1]["position"]
    pushed = [bench.exchange(PUSH) for _ in range(1200)]
    assert bench.vehicle.release_time == 2 * STEP
    assert pushed[-1]["timestamp"] == pytest.approx(1203 * 0.0025 - 0.0025)
    assert math.dist(pushed[-1]["position"], start) > 0.1
    assert pushed[-1]["airspeed"] == pytest.approx(np.linalg.norm(pushed[-1]["velocity"]), rel=1e-9)


@pytest.mark.real_time
def test_motion_matches_the_compiled_world(bench, boat):
    """Reference: the world's own step, with the command equivalent to 1800 µs."""
    scenario, vehicle = boat
    for _ in range(401):
        state = bench.exchange(PUSH)
    world = prepare_world(replace(scenario, world=replace(scenario.world, uplink=Wire())), seed=0)[0]
    low, high = vehicle.outputs[1].pulse.values
    now = 0
    for k in range(401):
        t = k * STEP
        world.set_inputs({"t": now, "h": t - now, "first": k == 0, "fresh": True, "command.t": now})
        world.set_inputs({"command.valid": True, "command.value.rudder": 0.0})
        world.set_inputs({"command.value.shaft_speed": low + 0.8 * (high - low)})
        world.step()
        now = t
    truth = [float(world.result(f"truth.{name}")) for name in ("north", "east")]
    assert state["position"][:2] == pytest.approx(truth, rel=1e-12)


@pytest.mark.real_time
def test_repeated_frame_gets_the_same_answer_without_stepping(bench):
    first = [bench.exchange(PUSH) for _ in range(5)][-1]
    assert bench.exchange(REST, count=4) == first
    assert bench.physics.tally.repeated == 1
    assert bench.exchange(PUSH)["timestamp"] == pytest.approx(first["timestamp"] + 0.0025, rel=1e-12)


@pytest.mark.real_time
def test_lost_frames_are_flown_with_the_previous_pulses(bench, boat):
    for count in range(400):
        bench.exchange(PUSH, count)
    lossy = bench.exchange(REST, count=410)
    assert (bench.physics.tally.missed, bench.physics.tally.frames) == (10, 401)
    assert lossy["timestamp"] == pytest.approx(410 * 0.0025)
    whole = Bench(*boat)
    try:
        for count in range(410):
            whole.exchange(PUSH, count)
        assert whole.exchange(REST, count=410) == lossy
    finally:
        whole.close()
    assert sum("were lost" in text for text in bench.said) == 1


@pytest.mark.real_time
def test_frame_gap_is_limited_to_one_second(bench):
    bench.exchange(PUSH, count=0)
    assert bench.exchange(PUSH, count=1_000_000)["timestamp"] == pytest.approx(1.0 + 0.0025)


@pytest.mark.real_time
def test_frame_count_wraps_at_32_bits(bench):
    bench.exchange(PUSH, count=2**32 - 1)
    assert bench.exchange(PUSH, count=0)["timestamp"] == 0.0025
    assert bench.physics.tally.missed == 0


@pytest.mark.real_time
def test_late_frame_is_ignored_and_counted(bench):
    for count in range(20):
        bench.exchange(PUSH, count)
    assert bench.exchange(REST, count=12) is None
    assert bench.physics.tally.late == 1
    assert bench.exchange(PUSH, count=20)["timestamp"] == pytest.approx(20 * 0.0025)


@pytest.mark.real_time
@pytest.mark.parametrize(("last", "count"), [(5, 0), (3000, 0), (3000, 40)])
def test_decreasing_frame_count_starts_another_flight(bench, last, count):
    for k in range(last - 3, last + 1):
        bench.exchange(PUSH, k)
    again = bench.exchange(REST, count)
    assert again["timestamp"] == 0.0
    assert again["velocity"] == [0, 0, 0]
    assert bench.vehicle.release_time is None
    assert sum("flight 2" in text for text in bench.said) == 1


@pytest.mark.real_time
def test_second_sender_is_ignored_until_first_falls_silent(bench, monkeypatch):
    bench.exchange(PUSH)
    other = FakeArduPilot(bench.port)
    try:
        assert bench.exchange(REST, pilot=other) is None
        assert bench.exchange(REST, pilot=other) is None
        assert bench.physics.tally.foreign == 2
        assert [text for text in bench.said if "flies the vehicle" in text] == bench.said[-1:]
        assert bench.exchange(PUSH)["timestamp"] == 0.0025
        monkeypatch.setattr(ardupilot, "SILENCE_S", 0.0)  # the first one has been silent for long
        assert bench.exchange(REST, pilot=other)["timestamp"] == 0.0
        assert bench.physics.tally.frames == 3
    finally:
        other.close()


@pytest.mark.real_time
def test_malformed_packet_is_counted_and_reported_once(bench):
    bench.exchange(PUSH)
    for _ in range(3):
        bench.pilot.socket.sendto(b"hello, is this the physics?", bench.pilot.place)
        bench.handle()
    assert bench.pilot.receive() is None
    assert bench.physics.tally.malformed == 3
    assert sum("refused a packet" in text for text in bench.said) == 1


@pytest.mark.thorough
def test_any_of_32_channels_can_drive_the_command(boat):
    scenario, _ = boat
    vehicle = PulsedVehicle(scenario, seed=0, channels=(20, 3), release=1700e-6)
    reads = vehicle._world.reads
    vehicle.advance(0)
    pulses = [0] * 32
    pulses[19] = 1750
    vehicle.set_pulses(pulses)
    inputs = vehicle._world.inputs
    assert inputs[reads["command.value.rudder"]] == pytest.approx(0.5 * vehicle.outputs[0].pulse.values[1])
    assert inputs[reads["command.value.shaft_speed"]] == pytest.approx(0.0, abs=1e-9)
    assert vehicle.release_time == 0
    for channels, words in (((1,), "must be 2 numbers"), ((2, 2), "be different"), ((0, 1), "from 1 to 32")):
        with pytest.raises(InputError, match=words):
            PulsedVehicle(scenario, seed=0, channels=channels, release=None)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "Missing option '--listen'"),
        (("--listen", "udp://:14550", "--channels", "1,2"), "--channels: needs --ardupilot or --px4"),
        (("--listen", "udp://:14550", "--ardupilot"), "--listen: does not apply to ArduPilot"),
        (("--lockstep", "--ardupilot"), "--lockstep: does not apply to ArduPilot"),
        (("--channels", "one", "--ardupilot"), "'one' is not a list of channels"),
        (("--ardupilot", "0.0.0.0:9002"), "anyone who reaches 0.0.0.0:9002 could fly the vehicle"),
        (("--ardupilot", "9002"), "is not HOST:PORT"),
    ],
)
def test_rejects_incompatible_options_before_compiling(words, said):
    refused = CliRunner().invoke(main, ["vehicle", "vessel/path", *words])
    assert refused.exit_code == 2
    assert said in " ".join(refused.output.split())


@pytest.mark.real_time
def test_fake_ardupilot_hovers_the_quadrotor(tmp_path):
    """The vehicle idles, is released when its pulses pass 1.5 ms, and flies to a position, in a second flight."""
    port = free_port()
    words = ("--set", "trajectory=place", "--release", "1500", "--duration", "8", "--out", str(tmp_path / "there"))
    place = f"127.0.0.1:{port}"
    there = Program("vehicle", "quadrotor/track", *words, "--json", "--ardupilot", place, folder=tmp_path)
    pilot = Hover(port)
    try:
        there.wait_for("waits on")
        for _ in range(40):
            standing = pilot.fly_frame([1100] * 4)
        assert standing["velocity"] == [0, 0, 0]
        pilot.restart()
        for _ in range(3200):
            state = pilot.fly_frame(None)
        pilot.fly_frame(None)
        ended = there.finished()
    finally:
        pilot.autopilot.close()
        if there.process.poll() is None:
            there.process.kill()
            there.process.communicate()
    assert ended.status == 0
    assert math.dist(state["position"], Hover.PLACE) < 0.01
    assert np.linalg.norm(state["velocity"]) < 0.01
    assert ended.result["flights"] == 2
    assert ended.result["frames"]["malformed"] == ended.result["frames"]["missed"] == 0
    log = read_mcap(tmp_path / "there" / "vehicle-2.mcap")
    assert np.linalg.norm(log["truth.position"][-1] - Hover.PLACE) < 0.01
    assert log["ardupilot.frame"][-1] > 3000
    assert (tmp_path / "there" / "vehicle.mcap").exists()


class Hover:
    """Position and attitude feedback on the data sent to ArduPilot, for the publication's plus quadrotor."""

    PLACE = np.array([0.0, 0.0, -3.5])

    def __init__(self, port):
        self.autopilot, craft = FakeArduPilot(port), Multirotor()
        self.m, self.J, self.arm, self.k = float(craft.mass), np.asarray(craft.inertia), 0.315, 8e-5
        self.state = None

    def restart(self):
        """Restart the autopilot: its frame count begins at zero."""
        self.autopilot.count = 0

    def fly_frame(self, pulses):
        self.autopilot.send(self.pulses() if pulses is None else pulses)
        state = self.autopilot.receive() or self.state
        self.state = state
        return state

    def pulses(self):
        """Pulses of the rotors: front, right, rear, left; 615 rad/s at 2 ms."""
        p, v, angles, w = (np.array(self.state[n]) for n in ("position", "velocity", "attitude", "gyro"))
        a = np.clip(2.0 * (self.PLACE - p) - 2.5 * v, -2.0, 2.0)
        thrust = self.m * (9.81 - a[2])
        wanted = np.array([a[1] / 9.81, -a[0] / 9.81, 0.0])
        moment = self.J * (60.0 * (wanted - angles) - 14.0 * w)
        roll, pitch, yaw = moment[0] / self.arm, moment[1] / self.arm, moment[2] / 0.026
        thrusts = thrust / 4 + np.array(
            [pitch / 2 - yaw / 4, -roll / 2 + yaw / 4, -pitch / 2 - yaw / 4, roll / 2 + yaw / 4]
        )
        speeds = np.sqrt(np.clip(thrusts, 0.0, None) / self.k)
        return [round(1000 + 1000 * min(s / 615.0, 1.0)) for s in speeds]

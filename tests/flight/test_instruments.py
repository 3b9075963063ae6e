"""Telemetry of a virtual vehicle, against its state, its sensor and its commands."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.actuators.drive import DriveCommand
from trimtab.actuators.failsafe import Failsafe
from trimtab.core.time import ms, seconds
from trimtab.flight.instruments import Instruments
from trimtab.flight.mavlink.dialect import derive_dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import ReceiverChannels
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.logs.frames import quaternion
from trimtab.run.blocks import choose_failsafe, compile_world, replace_links
from trimtab.scenarios.build import build
from trimtab.vehicles.vehicle_type import mav_type


class Told:
    """A vehicle that has stood still for 20 ms, and a ground station that reads its messages."""

    def __init__(self, scenario, failsafe=None, **truth) -> None:
        scenario = replace_links(build(scenario, {f"initial.{k}": str(v) for k, v in truth.items()}))
        world, frame, command = compile_world(scenario)
        dialect = derive_dialect(frame, command)
        self.body = VirtualVehicle(scenario, dialect, world)
        for t in self.body.instants():
            self.body.advance(t, fresh=True, is_held=True)
            if t >= ms(20):
                break
        endpoint = Endpoint(dialect, 1, 1, unsigned=True)
        self.duties = SimpleNamespace(failsafe=failsafe or choose_failsafe(scenario, command), is_commanded=False)
        self.guard = SimpleNamespace(may_be_armed=True)
        self.instruments = Instruments(self.body, self.duties, self.guard, endpoint)
        self._streams, self._ground = self.instruments.telemetry_streams(), Endpoint(dialect, 255, 190, unsigned=True)

    def ask(self, number, now=0):
        """Request a message. Return its fields, or None without an answer."""
        _, packets = self._streams.handle_command(512, number, 0.0, now)
        (message,) = self._ground.feed(b"".join(packets)) or [None]
        return message and message.fields()


@pytest.fixture(scope="module")
def hovercraft():
    low, high = DriveCommand(1e-3, -5000.0), DriveCommand(2e-3, 15000.0)
    failsafe = Failsafe(safe=DriveCommand(1.5e-3, 0.0), low=low, high=high)
    truth = {"north": 2, "east": -1, "heading": 1.2, "surge_velocity": 0.8, "sway_velocity": -0.3, "yaw_rate": 0.5}
    return Told("hovercraft/forward", failsafe, **truth)


@pytest.mark.thorough
def test_attitude_and_position_messages_match_the_state(hovercraft):
    attitude, place = hovercraft.ask(30), hovercraft.ask(32)
    assert (attitude["yaw"], attitude["yawspeed"]) == pytest.approx((1.2, 0.5))
    assert (place["x"], place["y"], place["z"]) == pytest.approx((2.0, -1.0, 0.0))
    c, s = math.cos(1.2), math.sin(1.2)
    assert (place["vx"], place["vy"]) == pytest.approx((0.8 * c + 0.3 * s, 0.8 * s - 0.3 * c), rel=1e-6)


@pytest.mark.thorough
def test_servo_output_is_scaled_between_command_bounds(hovercraft):
    world = hovercraft.body.world
    world.inputs[world.reads["command.value.rudder_pulse"]] = 1.25e-3
    world.inputs[world.reads["command.value.speed_rpm"]] = 5000.0
    found = hovercraft.ask(36)
    assert [found[f"servo{k}_raw"] for k in (1, 2, 3)] == [1250, 1500, 0]


@pytest.mark.thorough
def test_receiver_channels_are_sent_until_receiver_times_out(hovercraft):
    assert hovercraft.ask(65) is None
    hovercraft.instruments.handle_event(ReceiverChannels((1.1e-3, 1.9e-3)), seconds(1))
    assert hovercraft.ask(65, seconds("1.4"))["chan2_raw"] == 1900
    assert hovercraft.ask(1, seconds("1.4"))["onboard_control_sensors_present"] & 0x10000
    assert hovercraft.ask(65, seconds("1.6")) is None
    assert not hovercraft.ask(1, seconds("1.6"))["onboard_control_sensors_present"] & 0x10000


def test_landed_state_is_on_ground_until_commanded(hovercraft):
    assert hovercraft.ask(245)["landed_state"] == 1
    hovercraft.duties.is_commanded = True
    assert hovercraft.ask(245)["landed_state"] == 0


def test_no_imu_message_without_an_inertial_unit(hovercraft):
    assert hovercraft.ask(105) is None
    assert not hovercraft.ask(1)["onboard_control_sensors_present"] & 0b111


@pytest.mark.thorough
def test_imu_message_holds_the_measured_specific_force():
    told = Told("navigation/platform-magnetometer")
    found, world = told.ask(105), told.body.world
    (force,) = [p for p in world.writes if p.startswith("sensors.") and p.endswith(".specific_force")]
    measured = np.asarray(world.outputs[world.writes[force]])
    assert np.hypot.reduce(measured) == pytest.approx(9.8, abs=1.0)
    assert [found[f"{axis}acc"] for axis in "xyz"] == pytest.approx(measured.tolist(), rel=1e-6)
    assert found["time_usec"] <= 20_000
    bounds_unknown = told.ask(36)
    assert bounds_unknown["servo1_raw"] == 0
    assert told.ask(1)["onboard_control_sensors_health"] & 0b11 == 0b11


def test_prearm_health_bit_shows_arming_permission(hovercraft):
    bit = 0x10000000
    assert hovercraft.ask(1)["onboard_control_sensors_health"] & bit
    hovercraft.guard.may_be_armed = False
    health = hovercraft.ask(1)
    hovercraft.guard.may_be_armed = True
    assert health["onboard_control_sensors_present"] & bit
    assert not health["onboard_control_sensors_health"] & bit


@pytest.fixture(scope="module")
def quadrotor():
    q = Rotation.from_euler("ZYX", [2.0, -0.4, 3.0])  # on its back
    x, y, z, w = q.as_quat().tolist()
    truth = {"attitude": [w, x, y, z], "position": [3, -4, -20], "velocity": [1, 2, -5], "rate": [0.3, -0.2, 0.1]}
    return Told("quadrotor/track", **truth)


@pytest.mark.thorough
def test_quadrotor_attitude_and_velocity_messages_match_the_state(quadrotor):
    told = quadrotor
    truth = {n: told.body.world.result(f"truth.{n}").copy() for n in ("attitude", "position", "velocity", "rate")}
    attitude, place, hud = told.ask(30), told.ask(32), told.ask(74)
    w, *xyz = truth["attitude"]
    R = Rotation.from_quat([*xyz, w])
    again = Rotation.from_euler("ZYX", [attitude[n] for n in ("yaw", "pitch", "roll")])
    assert (R.inv() * again).magnitude() < 1e-5
    assert abs(attitude["roll"]) > 2.5
    assert [attitude[f"{n}speed"] for n in ("roll", "pitch", "yaw")] == pytest.approx(truth["rate"], rel=1e-5)
    assert [place[n] for n in "xyz"] == pytest.approx(truth["position"], rel=1e-5)
    assert [place[f"v{n}"] for n in "xyz"] == pytest.approx(truth["velocity"], rel=1e-5)
    assert hud["alt"] == pytest.approx(-truth["position"][2], rel=1e-5)
    assert hud["climb"] == pytest.approx(-truth["velocity"][2], rel=1e-5)
    assert hud["groundspeed"] == pytest.approx(np.hypot(*truth["velocity"][:2]), rel=1e-5)


@pytest.mark.thorough
def test_quadrotor_pose_and_type_match_the_vehicle(quadrotor):
    told = quadrotor
    pose = told.instruments.pose()
    assert pose[:3] == pytest.approx(told.body.world.result("truth.position").tolist())
    q = told.body.world.result("truth.attitude")
    assert abs(q @ np.array(quaternion(pose[3:6]))) == pytest.approx(np.linalg.norm(q), abs=1e-9)
    assert mav_type(told.body.scenario.world.vehicle).name == "QUADROTOR"

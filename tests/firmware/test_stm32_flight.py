"""The whole program of the STM32F405 that flies a craft, on the model of its registers: bytes by DMA in and out, the
inertial sensor on SPI, pulses by timer, the fan's encoder, the watchdog."""

import ctypes
from pathlib import Path

import numpy as np
import pytest
from firmware.chip import Chip
from firmware.host import KEY, STAMP, Host, values
from firmware.test_stm32 import compile_drivers

from trimtab.flight.boards.black_box import SECTOR, read_black_box
from trimtab.flight.boards.firmware_folder import write_firmware
from trimtab.scenarios.build import build

pytestmark = pytest.mark.thorough

NEUTRAL = 1.5e-3
IMU_PERIOD = 65_536
MS = 10_000


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """Dialect, and the library: hovercraft/forward with an inertial sensor, whose real one is on the board."""
    folder = tmp_path_factory.mktemp("flight")
    written = write_firmware(build("hovercraft/forward", {"navigation": "ins"}), folder, KEY, board="stm32f405")
    here = Path(__file__).parent
    sources = [
        *(folder / "portable").glob("*.c"),
        folder / "drive" / "drive.c",
        *(folder / "drivers").glob("*.c"),
        here / "flight.c",
    ]
    sources += [p for p in (folder / "boards/stm32f405").glob("*.c") if p.name != "start.c"]
    sources += [folder / "emulated" / "samples.c"]
    sources += [folder / "exported" / f"{name}.c" for name in ("command", "failsafe", "speed_regulator", "identity")]
    folders = [folder / p for p in ("portable", "drive", "drivers", "boards/stm32f405", "emulated", "exported")]
    mavlink = ["-isystem", str(folder / "mavlink")]
    return written.dialect, compile_drivers(folder / "flight.so", sources, folders, *mavlink)


class Craft(Host):
    """A board in a time of the test's own: one millisecond is a tick of its timers, a sample of its sensor."""

    def __init__(self, program, folder, chip=Chip):
        self.dialect, library = program
        (folder / "flight.so").write_bytes(library.read_bytes())
        self.library = ctypes.CDLL(str(folder / "flight.so"))
        self.chip, self.now, self.count, self.speed_rpm = chip(self.library), 0, 0.0, 0.0
        self.force, self.rate = np.array([0.0, 0.0, 9.80665]), np.zeros(3)
        self.library.flight_begin(KEY.secret, ctypes.c_uint64(STAMP))
        self.peer = self.other(system=1, component=191)

    def run(self, ms, data=b""):
        heard = []
        for _ in range(ms):
            self.now += MS
            self.chip.plain[0x40000024] = self.now // 5  # 2 MHz
            self.turn_fan()
            self.chip.plain[0x40000824] = int(self.count) % 65536
            self.chip.icm.measure(self.force + np.random.default_rng(self.now).normal(0, 0.01, 3), self.rate)
            self.chip.pass_time(1e-3)
            self.library.board_ticked()
            if data:
                self.chip.receive(data)
                data = b""
            self.library.flight_work()
            heard += self.sent()
        self.chip.check()
        return heard

    def turn_fan(self):
        """6000 rpm at a duty of 0.41, with a time constant of 0.1 s; 400 counts a turn."""
        width = self.chip.pulses()[1][1]
        self.speed_rpm += ((width - NEUTRAL) / 0.5e-3 / 0.41 * 6000 - self.speed_rpm) * 1e-3 / 0.1
        self.count += self.speed_rpm / 60 * 400 * 1e-3

    def sent(self):
        self.chip.finish_sending()
        data, self.chip.sent = self.chip.sent, b""
        return self.peer.feed(data)


@pytest.fixture
def craft(program, tmp_path):
    return Craft(program, tmp_path)


def test_imu_samples_reach_autopilot_in_body_axes(craft):
    craft.run(100, craft.pack("HEARTBEAT", type=6))
    craft.force, craft.rate = np.array([1.0, 0.5, 9.8]), np.array([0.1, 0.2, 0.7])
    craft.run(20)
    said = [m for m in craft.run(300) if m.name == "SAMPLE_IMU"]
    times = values(said, "SAMPLE_IMU", "t")
    assert set(np.diff(times)) == {IMU_PERIOD}
    assert set(times % IMU_PERIOD) == {0}
    np.testing.assert_allclose([m.get("specific_force") for m in said], [[1.0, -0.5, -9.8]] * len(said), atol=0.02)
    np.testing.assert_allclose([m.get("angular_rate") for m in said], [[0.1, -0.2, -0.7]] * len(said), atol=1e-3)


def test_arms_drives_and_stops_when_commands_stop(craft):
    craft.run(100, craft.pack("HEARTBEAT", type=6))
    (ack,) = [m for m in craft.arm() if m.name == "COMMAND_ACK"]
    assert ack.get("result") == 0
    for _ in range(100):
        craft.run(20, craft.command(rudder_pulse=1.7e-3))
    frame, (rudder, thrust, lift) = craft.chip.pulses()
    assert frame == pytest.approx(50.0)
    assert (rudder, lift) == pytest.approx((1.7e-3, 2.0e-3))
    assert thrust == pytest.approx(NEUTRAL + 0.41 * 0.5e-3, abs=0.02e-3)  # the regulator found the duty of 6000 rpm
    said = craft.run(300)
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT" and "no command" in m.get("text")]
    assert craft.chip.pulses()[1][1] == NEUTRAL


def test_rejects_arming_while_inertial_sensor_is_dead(craft):
    craft.run(100, craft.pack("HEARTBEAT", type=6))
    craft.chip.icm.dead = True
    craft.run(50)
    said = craft.arm()
    assert [m.get("result") for m in said if m.name == "COMMAND_ACK"] == [1]
    assert [m.get("text").rstrip("\0") for m in said if m.name == "STATUSTEXT"] == ["not armed: inertial sensor"]


def test_stuck_loop_in_flight_is_reset_within_100_ms(craft):
    craft.run(100, craft.pack("HEARTBEAT", type=6))
    craft.arm()
    for _ in range(50):
        craft.run(20, craft.command())
    assert not craft.chip.watchdog["reset"]
    for _ in range(34):  # interrupts go on, the loop does not
        craft.chip.pass_time(1e-3)
        craft.library.board_ticked()
    assert not craft.chip.watchdog["reset"]
    craft.chip.pass_time(0.066)
    assert craft.chip.watchdog["reset"]


def test_stamp_and_black_box_of_flight_are_in_flash(craft):
    craft.run(100, craft.pack("HEARTBEAT", type=6))
    craft.arm()
    for _ in range(100):
        craft.run(20, craft.command())
    stamps = [craft.chip.flash.get(0x08008010 + 16 * k + 4) for k in range(8)]
    assert any(stamps)
    words = [craft.chip.flash.get(0x080C0000 + 4 * k, 0xFFFFFFFF) for k in range(2 * SECTOR // 4)]
    (flight,) = read_black_box(np.array(words, "<u4").tobytes())
    assert len(flight) >= 20
    assert np.diff([r.t for r in flight[1:]]) == pytest.approx(0.1, abs=2e-3)  # the first is the change of mode
    assert {(r.mode, r.cause, r.armed) for r in flight} == {("computer", "arm request", True)}
    assert flight[-1].rpm_command == 6000
    assert flight[-1].speed_rpm == pytest.approx(6000, rel=0.05)

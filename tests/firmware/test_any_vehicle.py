"""Firmware of vehicles without a fan: pulses by tables, on this computer in simulated time and on an emulated board."""

import contextlib
import ctypes

import numpy as np
import pytest
from firmware.board import emulator
from firmware.conftest import build_elf, load_library
from firmware.host import KEY, MS, Host, values
from firmware.peer import Peer

from trimtab.actuators.servo_pulse import ServoPulse
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.flight.boards.firmware_folder import replace_hardware, write_firmware
from trimtab.flight.lockstep import LockstepAutopilot
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.transports.open_link import open_link
from trimtab.logs.mcap import read_mcap
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

REST = 3000
SAFE_THRUST = 2667
"""0 N between -3 and 6 N, in half microseconds."""


def boat():
    """The how-to's, with a rudder servo that is turned round and has its middle at 1.52 ms."""
    scenario = build("examples/my_boat.py:scenario")
    bank = scenario.world.actuators
    servo = ServoPulse(values=np.array([-0.6, 0.0, 0.6]), widths=np.array([2e-3, 1.52e-3, 1e-3]))
    bank = replace(bank, stages=bank.stages | {"rudder": (servo, *bank.stages["rudder"])})
    return replace(scenario, world=replace(scenario.world, actuators=bank))


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    written = write_firmware(boat(), tmp_path_factory.mktemp("boat"), KEY)
    return load_library(written, tmp_path_factory.mktemp("library")), written.dialect


@pytest.fixture
def host(program):
    return Host(*program)


def command(host, thrust, rudder, valid=True):
    return host.pack("COMMAND", t=host.now, valid=valid, thrust=thrust, rudder=rudder)


def flying(host, thrust=2.0, rudder=0.0, times=10):
    host.arm()
    for _ in range(times):
        host.run(20, command(host, thrust, rudder))


@pytest.mark.thorough
def test_pulse_tables_map_each_component_of_the_command(host):
    for thrust, rudder, counts in (
        (-3.0, 0.0, [2000, 3040]),
        (6.0, 0.6, [4000, 2000]),
        (1.5, -0.3, [3000, 3520]),
        (99.0, -99.0, [4000, 4000]),  # beyond the table: its ends
    ):
        flying(host, thrust, rudder)
        assert host.pulses(2) == counts


@pytest.mark.thorough
def test_outputs_stay_safe_before_arming(host):
    for _ in range(20):
        host.run(20, command(host, 5.0, 0.5))
    assert host.pulses(2) == [SAFE_THRUST, 3040]


@pytest.mark.thorough
def test_failsafe_sets_safe_pulses_after_250_ms_without_command(host):
    flying(host, 5.0, 0.5)
    host.run(1, command(host, 5.0, 0.5))
    begun = host.now
    while host.pulses(2) != [SAFE_THRUST, 3040]:
        assert host.now - begun < 1000 * MS
        host.run(1)
    assert (host.now - begun) // MS == 250
    for _ in range(20):  # latched
        host.run(20, command(host, 5.0, 0.5))
    assert host.pulses(2) == [SAFE_THRUST, 3040]


@pytest.mark.thorough
def test_disarming_or_radio_takeover_sets_safe_pulses_at_once(host):
    flying(host, 5.0, 0.5)
    host.arm(False)
    assert host.pulses(2) == [SAFE_THRUST, 3040]
    flying(host, 5.0, 0.5)
    host.library.host_radio(1, 1200, 1900, 1900)
    host.run(21, command(host, 5.0, 0.5))
    assert host.pulses(2) == [SAFE_THRUST, 3040]


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_non_finite_commands_are_ignored(host, number):
    flying(host, 5.0, 0.5)
    for _ in range(5):
        host.run(20, command(host, number, number))
    assert host.pulses(2) == [round(2000 + 2000 * 8 / 9), 2173]
    assert host.run(200, command(host, number, 0.0))  # and after the failsafe's time it stops
    assert host.pulses(2) == [SAFE_THRUST, 3040]


def test_emulated_boat_follows_pulses_and_reports_them(host):
    host.run(10, host.pack("HEARTBEAT", type=6))
    flying(host, 2.0, 0.0, times=150)
    assert host.library.host_truth()[0] == pytest.approx(1 - np.exp(-3.0 * 2 / 3), rel=0.06)  # 2 N, 2 N s/m, 3 kg
    said = host.run(40, command(host, 2.0, 0.0))
    assert values(said, "SERVO_OUTPUT_RAW", "servo1_raw")[-1] == pytest.approx(1000 + 1000 * 5 / 9, abs=1)
    assert values(said, "SERVO_OUTPUT_RAW", "servo2_raw")[-1] == 1520
    assert values(said, "SERVO_OUTPUT_RAW", "servo3_raw")[-1] == 0
    assert set(values(host.run(1100), "HEARTBEAT", "type")) == {11}


def test_parameter_requests_without_parameters_get_no_answer(host):
    host.run(10, host.pack("HEARTBEAT", type=6))
    said = host.run(50, host.pack("PARAM_REQUEST_LIST")) + host.run(5, host.pack("PARAM_REQUEST_READ", param_index=0))
    assert not [m for m in said if m.name == "PARAM_VALUE"]


def test_tables_in_c_match_numpy_interpolation(program):
    x, y = np.array([-0.5, -0.1, 0.2, 1.0]), np.array([4200.0, 3300.0, 3000.0, 1700.0])
    numbers = ctypes.POINTER(ctypes.c_double)
    for at in np.linspace(-1, 2, 61):
        got = program[0].host_line(x.ctypes.data_as(numbers), y.ctypes.data_as(numbers), 4, ctypes.c_double(at))
        assert got == pytest.approx(np.interp(at, x, y), abs=0.5001)


FLIGHTS = {
    "cart-pole/swing-up": "law.lean",
    "f16/gcas": "law.load_error",
    "quadrotor/track": "law.distance",
    "torpedo/depth": "law.depth_error",
}
"""Scenario -> what has to be small for the last 3 s of 12, as a mean of its size."""
MORE = 0.1
"""By so much it may differ from a simulation without links: a command acts a tick later, at the next servo frame."""


@pytest.mark.real_time
@pytest.mark.parametrize("name", FLIGHTS)
def test_lockstep_flight_of_firmware_matches_simulation(name, tmp_path):
    """Lockstep makes the flight independent of the load of this machine."""
    scenario = replace(build(name), duration=seconds(12))
    written = write_firmware(replace(scenario, duration=seconds(13)), tmp_path / "board", KEY)
    image = build_elf(written.folder, "LOCKSTEP=1")
    log = fly_in_step(image, scenario, tmp_path / "flight.mcap")
    late = log.ticks > log.ticks[-1] - seconds(3)
    simulated = simulate(replace_hardware(scenario), backend="c")[FLIGHTS[name]]
    flown = np.abs(np.asarray(log[FLIGHTS[name]])[late]).mean()
    expected = np.abs(np.asarray(simulated)[np.arange(len(simulated)) >= len(simulated) * 3 // 4]).mean()
    print(f"{name}: {FLIGHTS[name]} {flown:.5f}, simulated without links {expected:.5f}")
    assert len(log) == scenario.duration // scenario.autopilot.period
    assert flown == pytest.approx(expected, rel=MORE)


INSTRUCTIONS = {"cart-pole/swing-up": 6_000, "f16/gcas": 16_000, "quadrotor/track": 11_000, "torpedo/depth": 6_500}
"""Scenario -> bound of the instructions a millisecond, world included; a Cortex-M7 has 200 000 cycles or more."""


@pytest.mark.real_time
@pytest.mark.parametrize("name", INSTRUCTIONS)
def test_instruction_load_of_board_stays_below_limit(name, tmp_path):
    """QEMU counts 16 ns per instruction, as in test_board."""
    written = write_firmware(build(name), tmp_path / "board", KEY)
    image = build_elf(written.folder)
    with (
        emulator(image, tmp_path, "-icount", "shift=4,sleep=off") as port,
        contextlib.closing(Peer(port, written.dialect, KEY)) as peer,
    ):
        peer.heartbeat()
        peer.arm()
        loads = [peer.wait_for("SYS_STATUS", 60.0)[1].get("load") * 62.5 for _ in range(4)]
    print(f"{name}: {loads[-1]:.0f} instructions a millisecond")
    assert 1000 < loads[-1] < INSTRUCTIONS[name]


@pytest.mark.real_time
def test_lockstep_flight_is_reproducible(tmp_path):
    scenario = replace(build("torpedo/depth"), duration=seconds(4))
    image = build_elf(write_firmware(build("torpedo/depth"), tmp_path / "board", KEY).folder, "LOCKSTEP=1")
    one, other = (fly_in_step(image, scenario, tmp_path / f"{k}.mcap") for k in range(2))
    assert len(one) == len(other) == 80
    for path in one.paths:
        if not path.startswith("log."):
            np.testing.assert_array_equal(one[path], other[path], err_msg=path)


def fly_in_step(image, scenario, file):
    """The log of a flight of the emulated board in lockstep."""
    with emulator(image, file.parent) as port, contextlib.closing(open_link(f"tcp://127.0.0.1:{port}")) as link:
        autopilot = LockstepAutopilot(scenario, lambda d: Endpoint(d, 1, 191, KEY))
        autopilot.run(link, file)
    counts = autopilot.endpoint.counts
    assert (counts.lost, counts.refusals) == (0, 0)
    return read_mcap(file)

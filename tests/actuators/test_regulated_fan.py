"""Regulated fan: the firmware's blocks in a scenario's actuators, bit for bit, and what a sagging battery costs.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 4.
"""

import ctypes
import subprocess

import jax
import numpy as np
import pytest

from trimtab.actuators.battery import Battery
from trimtab.actuators.drive import BRAKING, DriveCommand, FanDrive
from trimtab.actuators.motor import Motor, MotorInput
from trimtab.actuators.regulated_fan import RegulatedFan
from trimtab.actuators.speed_regulator import SpeedRegulator, SpeedRegulatorInput
from trimtab.compiler.block import block_text
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.imperfections import imperfections
from trimtab.core.record import to_arrays
from trimtab.core.signals import new_sample
from trimtab.core.time import ms
from trimtab.run.blocks import timed_block
from trimtab.run.simulate import simulate
from trimtab.scenarios.build import build

drive = to_arrays(FanDrive(fan=RegulatedFan()))
no_compiler = pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
STEPS = 3000
WANTED = np.where(np.arange(STEPS) < 1500, 6000.0, 9000.0)
"""By the millisecond; a command of both directions is WANTED with its last second reversed."""
BOTH = np.where(np.arange(STEPS) < 2000, -WANTED, 5000.0)


def rollout(drive, wanted):
    """Outputs of so many milliseconds under these speeds."""

    def step(x, at):
        k, speed = at
        command = new_sample(k * ms(1), DriveCommand(rudder_pulse=1.5e-3, speed_rpm=speed))
        return drive.step(k * ms(1), x, command)

    return jax.lax.scan(step, drive.init(None), (np.arange(len(wanted)), wanted))[1]


flown = jax.jit(rollout)


def test_speed_is_independent_of_battery_voltage():
    """Where nothing regulates, 1 V costs 979 rpm at 9000 rpm: the motor's page."""
    speeds = {}
    for volts in (7.2, 6.2):
        fan = RegulatedFan(battery=Battery(full=volts, empty=volts))
        out = flown(to_arrays(FanDrive(fan=fan)), np.concatenate([WANTED, np.full(3000, 9000.0)]))
        speeds[volts] = np.asarray(out.speed_rpm)[-1000:].mean()
        assert not np.asarray(out.fan.encoder_fault).any()
    assert speeds[7.2] == pytest.approx(9000, abs=10)
    assert speeds[6.2] == pytest.approx(speeds[7.2], abs=10)


def test_battery_power_equals_winding_power():
    """What the battery gives at its terminals is what the windings take: voltage times the duty's share of current."""
    out = flown(drive, WANTED)
    duty, current = np.asarray(out.fan.duty), np.asarray(out.fan.battery.current) - 3.0
    speed = np.asarray(out.speed_rpm) * np.pi / 30
    volts = np.concatenate([[drive.fan.init().battery.voltage], np.asarray(out.fan.battery.voltage)[:-1]])
    constant = 7.2 / (19200 * np.pi / 30)
    resistance = 7.2 * constant / 0.08474
    winding = (duty * volts - constant * speed) / resistance
    np.testing.assert_allclose(current, duty * winding, rtol=1e-9, atol=1e-12)


def test_reverse_to_forward_brakes_for_150_ms():
    out = flown(drive, np.concatenate([BOTH, np.full(2000, 5000.0)]))
    braking = np.asarray(out.mode) == BRAKING
    assert int(out.brakings[-1]) == 1
    assert braking.sum() == 150
    assert (np.asarray(out.fan.duty)[braking] == 0).all()
    assert np.asarray(out.speed_rpm)[1900:2000].mean() == pytest.approx(-9000, rel=0.05)
    assert np.asarray(out.speed_rpm)[-500:].mean() == pytest.approx(5000, rel=0.02)


def test_rejects_inconsistent_periods():
    with pytest.raises(InputError, match=r"RegulatedFan\.period: .*regulator 15 ms, motor 10 ms"):
        RegulatedFan(regulator=SpeedRegulator(period=ms(15)), motor=Motor(period=ms(10))).check()
    with pytest.raises(
        InputError, match=r"motor\.period: the motor's period of 2 ms must equal the drive's period of 1 ms"
    ):
        FanDrive(fan=RegulatedFan(motor=Motor(period=ms(2)), battery=Battery(period=ms(2)))).check()


DRIVER = """
#include "motor.h"
#include "speed_regulator.h"
/* Duty and speed at each millisecond of the speeds wanted, on the voltages; the duty is what the controller passes. */
void fly(int n, const double *wanted, const double *volts, const double *passed, double *duty, double *speed) {
    speed_regulator_params rp; speed_regulator_state rs; speed_regulator_in ri; speed_regulator_out ro = {0};
    motor_params mp; motor_state mstate; motor_in mi; motor_out mo = {0};
    speed_regulator_defaults(&rp); speed_regulator_init(&rp, &rs);
    motor_defaults(&mp); motor_init(&mp, &mstate);
    for (int k = 0; k < n; ++k) {
        if (k % 10 == 0) {
            ri.t = k * 10000; ri.input.rpm_command = wanted[k]; ri.input.count = mo.count;
            speed_regulator_step(&rp, &rs, &ri, &ro);
        }
        duty[k] = ro.duty;
        mi.t = k * 10000; mi.input.duty = passed[k]; mi.input.voltage = volts[k];
        motor_step(&mp, &mstate, &mi, &mo);
        speed[k] = mo.speed_rpm;
    }
}
"""


@pytest.mark.thorough("forward")
@no_compiler
@pytest.mark.parametrize("wanted", [WANTED, BOTH], ids=["forward", "both"])
def test_firmware_blocks_are_bit_identical(wanted, tmp_path):
    """C of regulator and motor as `trimtab firmware` writes it, against the actuators of a compiled scenario."""
    out = compile(rollout, drive, wanted)(drive, wanted)
    zero = np.float64(0.0)
    blocks = [
        timed_block("speed_regulator", "", SpeedRegulator(), SpeedRegulatorInput(zero, np.int32(0))),
        timed_block("motor", "", Motor(), MotorInput(zero, zero)),
    ]
    sources = ["driver.c"]
    (tmp_path / "driver.c").write_text(DRIVER)
    for block in blocks:
        text = block_text(block, "f64")
        sources.append(f"{block.name}.c")
        (tmp_path / f"{block.name}.h").write_text(text.header)
        (tmp_path / f"{block.name}.c").write_text(text.source)
    command = [find_compiler("c").path, "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-o", "lib.so", *sources, "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    fly = ctypes.CDLL(str(tmp_path / "lib.so")).fly
    volts = np.concatenate([[drive.fan.init().battery.voltage], np.asarray(out.fan.battery.voltage)[:-1]])
    latched = wanted[np.arange(STEPS) // 20 * 20]
    duty, speed = np.zeros(STEPS), np.zeros(STEPS)
    given = [np.ascontiguousarray(a, float) for a in (latched, volts, out.fan.duty)]
    fly(STEPS, *(a.ctypes.data_as(ctypes.c_void_p) for a in (*given, duty, speed)))
    np.testing.assert_array_equal(speed, out.speed_rpm)
    drives = np.asarray(out.mode) != BRAKING
    np.testing.assert_array_equal(duty[drives], np.asarray(out.fan.duty)[drives])


@pytest.mark.thorough
@no_compiler
def test_forward_scenario_runs_on_a_nearly_empty_battery():
    """A setting brings the part with its defaults, and its signals are logged."""
    scenario = build("hovercraft/forward", {"world.actuators.fan.battery.initial": "0.1"})
    assert "battery-sag" in imperfections(scenario)
    log = simulate(scenario, seed=3, backend="c")
    tail = log.t > 10
    assert abs(log["truth.surge_velocity"][tail].mean() - 2.8 / 2.6) < 0.1
    assert log["actuators.fan.battery.voltage"].max() < 6.4
    assert not log["actuators.fan.encoder_fault"].any()


@pytest.mark.parametrize("typed", ["batery.initial", "battery"])
def test_misspelt_setting_suggests_the_full_path(typed):
    with pytest.raises(InputError) as refused:
        build("hovercraft/forward", {f"world.actuators.fan.{typed}": "1"})
    right = refused.value.fix.removeprefix('settings={"').removesuffix('": "…"}')
    assert right.startswith("world.actuators.fan.battery.")
    assert build("hovercraft/forward", {right: "6.3"} if "initial" not in right else {right: "1"})

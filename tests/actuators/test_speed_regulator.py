"""Speed regulator: overshoot and settling on the motor model, anti-windup, and what a broken encoder does.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 4.
"""

import jax
import numpy as np
import pytest

from trimtab.actuators.motor import Motor, MotorInput, MotorState
from trimtab.actuators.speed_regulator import SpeedRegulator, SpeedRegulatorInput
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms

RPM = 30 / np.pi
motor, regulator = to_arrays(Motor()), to_arrays(SpeedRegulator())
TICK, TICKS = 10, 800
"""Length (ms) and number of the ticks of a flight. All flights have one length, and so one program."""


step = jax.jit(SpeedRegulator.step)


@jax.jit
def _closed(regulator, motor, start, wanted, voltage, wire):
    """Speeds (n, 10) and outputs of n ticks; wire multiplies what the counter moves by."""

    def tick(carry, at):
        r, m, count = carry
        k, wanted, voltage, wire = at
        r, out = regulator.step(k * ms(TICK), r, SpeedRegulatorInput(wanted, count))
        drive = MotorInput(duty=out.duty, voltage=voltage)
        first = m
        speeds = []
        for _ in range(TICK):
            m, moved = motor.step(np.int64(0), m, drive)
            speeds.append(moved.speed_rpm)
        step = (np.int32(1) * (m.turned.astype(int) - first.turned.astype(int)) + 32768) % 65536 - 32768
        return (r, m, (count + wire * step.astype(np.int32)) % 65536), (jax.numpy.stack(speeds), out)

    given = (np.arange(len(wanted)), wanted, voltage, wire)
    return jax.lax.scan(tick, (regulator.init(), start, np.int32(0)), given)[1]


def closed(wanted, voltage=None, wire=None, block=regulator, speed_rpm=0.0):
    n = len(wanted)
    voltage = np.full(n, 7.2) if voltage is None else voltage
    wire = np.ones(n, np.int32) if wire is None else np.asarray(wire, np.int32)
    start = MotorState(speed=np.float64(speed_rpm / RPM), turned=np.float64(0.0))
    given = [np.pad(v, (0, TICKS - n), "edge") for v in (np.asarray(wanted, float), voltage, wire)]
    speeds, out = jax.tree.map(lambda v: np.asarray(v)[:n], _closed(block, motor, start, *given))
    return speeds.ravel(), out


@pytest.mark.thorough
def test_step_to_9_krpm_has_expected_settling_and_overshoot():
    """By the reconstructed gains; where the encoder stands between two counts moves it by some tenths of a percent."""
    speeds, _ = closed([6000.0] * 300 + [9000.0] * 300)
    assert speeds[2900:3000] == pytest.approx(6000, abs=30)
    after = speeds[3000:]
    settled = (np.nonzero(abs(after - 9000) > 0.02 * 9000)[0][-1] + 1) * 1e-3
    overshoot = (after.max() - 9000) / 3000
    assert settled == pytest.approx(0.89, abs=0.01)
    assert overshoot == pytest.approx(0.088, abs=0.002)


@pytest.mark.thorough
def test_voltage_sag_of_1_v_costs_1_rpm():
    """7.2 to 6.2 V, with the reconstructed gains."""
    speeds, _ = closed([9000.0] * 800, np.where(np.arange(800) < 400, 7.2, 6.2))
    before, after = speeds[3000:4000].mean(), speeds[7000:].mean()
    assert abs(before - after) <= 1.0
    assert speeds[4000:5000].min() < 8700, "it was felt"


def test_measures_15_rpm_per_count():
    state = replace(regulator.init(), started=np.bool_(True), count=np.int32(100))
    for count, rpm in ((500, 6000.0), (101, 15.0), (90, -150.0), (65530, -1590.0)):
        _, out = step(regulator, np.int64(0), state, SpeedRegulatorInput(np.float64(6000.0), np.int32(count)))
        assert float(out.speed_rpm) == rpm


def test_first_count_gives_zero_speed():
    _, out = step(regulator, np.int64(0), regulator.init(), SpeedRegulatorInput(np.float64(6000.0), np.int32(30000)))
    assert float(out.speed_rpm) == 0.0


def test_integral_does_not_wind_up():
    """15 krpm are out of reach: on the way back it must not stay at full duty, as an integral left alone does."""
    wanted = [15000.0] * 500 + [6000.0] * 200
    speeds, out = closed(wanted)
    assert np.asarray(out.saturated)[100:500].mean() > 0.4, "the measured speed dithers by a count"
    assert np.asarray(out.duty)[500] < 0.8
    assert speeds[5600] < 7000
    naive = 0.6 * np.sum((15 - speeds[:5000:10] * 1e-3) * 0.01)
    assert naive > 5, "an integral of that size would hold full duty for seconds"


def test_duty_sign_follows_command_and_stop_resets_integral():
    _, out = closed([9000.0] * 200 + [2000.0] * 100 + [0.0] * 50 + [-5000.0] * 400)
    duty = np.asarray(out.duty)
    assert (duty[:300] >= 0).all()
    assert duty[200] < 0.2
    assert (duty[300:350] == 0).all()
    assert (duty[350:] <= 0).all()
    assert np.asarray(out.speed_rpm)[-50:].mean() == pytest.approx(-5000, abs=30)


@pytest.mark.parametrize("wire", [0, -1], ids=["cut", "crossed"])
def test_broken_encoder_stops_the_fan(wire):
    n = 400
    speeds, out = closed([6000.0] * n, wire=[1] * 100 + [wire] * (n - 100))
    fault = np.asarray(out.fault)
    assert not fault[:140].any()
    assert fault[-1]
    first = int(np.argmax(fault))
    assert 100 + 50 - 1 <= first <= 100 + 52
    assert (np.asarray(out.duty)[first:] == 0).all()
    assert speeds[-1] < 1500


def test_stop_command_clears_the_fault():
    _, out = closed([6000.0] * 100 + [0.0] * 10 + [6000.0] * 100, wire=[0] * 100 + [1] * 110)
    fault = np.asarray(out.fault)
    assert fault[99]
    assert not fault[100:].any()
    assert np.asarray(out.speed_rpm)[-1] > 5000


def test_nan_speed_command_stops_the_fan():
    _, out = closed([6000.0] * 50 + [np.nan] * 10)
    assert (np.asarray(out.duty)[50:] == 0).all()


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_regulator_in_c_matches_jax():
    given = SpeedRegulatorInput(np.float64(0.0), np.int32(0))
    compiled = compile(lambda r, t, s, i: r.step(t, s, i), regulator, np.int64(0), regulator.init(), given)
    rng = np.random.default_rng(5)
    a = b = regulator.init()
    count = 0
    for k in range(300):
        wanted = [9000.0, -4000.0, 0.0][(k // 40) % 3]
        count = (count + int(rng.integers(-50, 700))) % 65536
        given = SpeedRegulatorInput(np.float64(wanted), np.int32(count))
        a, x = step(regulator, np.int64(k * ms(TICK)), a, given)
        b, y = compiled(regulator, np.int64(k * ms(TICK)), b, given)
        for p, q in zip(jax.tree.leaves((a, x)), jax.tree.leaves((b, y)), strict=True):
            np.testing.assert_allclose(p, q, rtol=1e-12, atol=1e-15)

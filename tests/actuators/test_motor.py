"""Motor: balances of torque from the source's figures, and its counter.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 4.
"""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.actuators.motor import Motor, MotorInput, MotorState
from trimtab.core.record import replace, to_arrays
from trimtab.core.time import ms

RPM = 30 / np.pi
motor = to_arrays(Motor())


@jax.jit
def steps(motor, state, duties, voltages):
    def body(x, at):
        return motor.step(np.int64(0), x, MotorInput(duty=at[0], voltage=at[1]))

    return jax.lax.scan(body, state, (duties, voltages))


def run(duty, voltage=7.2, seconds=3.0, block=motor, speed_rpm=0.0):
    n = round(seconds * 1000)
    state = MotorState(speed=np.float64(speed_rpm / RPM), turned=np.float64(0.0))
    return steps(block, state, np.full(n, duty), np.full(n, voltage))[1]


def test_full_duty_reaches_12_krpm():
    assert float(run(1.0).speed_rpm[-1]) == pytest.approx(12000, rel=1e-3)


def test_motor_without_propeller_reaches_free_speed():
    assert float(
        run(1.0, block=replace(motor, propeller=np.float64(0.0)), seconds=12.0).speed_rpm[-1]
    ) == pytest.approx(19200, rel=1e-6)


def test_reverse_mirrors_forward():
    np.testing.assert_allclose(run(-0.7).speed_rpm, -np.asarray(run(0.7).speed_rpm), rtol=1e-12)


def test_initial_acceleration_is_stall_torque_over_inertia():
    assert float(motor.acceleration(0.0, MotorInput(duty=1.0, voltage=7.2))) == pytest.approx(0.08474 / 2.2e-5)


def test_speed_matches_integration_of_the_torques():
    def rate(t, y):
        n = y[0] * RPM / 1000
        return [(0.08474 * (0.68 - n / 19.2) - 2.207e-4 * n * abs(n)) / 2.2e-5]

    wanted = solve_ivp(rate, (0, 0.4), [0.0], rtol=1e-10, atol=1e-10).y[0, -1] * RPM
    assert float(run(0.68, seconds=0.4).speed_rpm[-1]) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("voltage", [6.2, 7.2])
def test_duty_holds_the_speed(voltage):
    held = run(float(motor.duty(9000.0, voltage)), voltage, speed_rpm=9000.0, seconds=0.5).speed_rpm
    np.testing.assert_allclose(held, 9000.0, rtol=1e-9)


def test_open_loop_voltage_sag_reduces_speed():
    """By the balance of torques: 0.08474 (d 6.2/7.2 - n/19.2) = 2.207e-4 n^2 with the duty that held 9 krpm."""
    d = 2.207e-4 * 81 / 0.08474 + 9 / 19.2
    a, b = 2.207e-4 / 0.08474, 1 / 19.2
    n = (-b + np.sqrt(b * b + 4 * a * d * 6.2 / 7.2)) / (2 * a)
    assert float(run(d, 6.2, speed_rpm=9000.0).speed_rpm[-1]) == pytest.approx(1e3 * n, abs=0.5)
    assert 9000 - 1e3 * n == pytest.approx(979, abs=0.5)


@pytest.mark.parametrize("sign", [1, -1])
def test_counter_wraps_and_counts_400_per_turn(sign):
    out = run(sign * 1.0, seconds=3.0)
    turns = np.cumsum(np.asarray(out.speed_rpm)) / 60 * 1e-3
    moved = (np.diff(np.asarray(out.count)) + 32768) % 65536 - 32768
    assert np.asarray(out.count).min() >= 0
    assert np.asarray(out.count).max() <= 65535
    assert abs(turns[-1]) * 400 > 65536, "far enough to start anew"
    assert moved.sum() == pytest.approx(400 * turns[-1], rel=2e-3)
    assert Motor().period == ms(1)

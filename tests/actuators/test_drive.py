"""The drive against a plain simulation, its frames, brake and limits.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from trimtab.actuators.drive import BRAKING, FORWARD, REVERSE, DriveCommand, FanDrive
from trimtab.actuators.lookup import thrust_table
from trimtab.actuators.rudder import DEG
from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.imperfections import without
from trimtab.core.interfaces import Actuators
from trimtab.core.record import replace, to_arrays
from trimtab.core.signals import Sample, new_sample
from trimtab.core.time import ms

DRIVE = FanDrive()
STEPS = 2000


def _simulate(drive, *command):
    """Outputs for a command at every period, (n,) each. All flights have one length, and so one program."""
    n = len(command[0])
    held = [np.pad(v, (0, STEPS - n), "edge") for v in command]
    return jax.tree.map(lambda out: np.asarray(out)[:n], _fly(drive, *held))


@jax.jit
def _fly(drive, pulse, speed, valid):

    def body(state, row):
        t, pulse, speed, valid = row
        value = DriveCommand(pulse, speed)
        new, out = drive.step(t, state, Sample(value=value, t=t, age=0.0, fresh=True, valid=valid))
        return jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), new, state), out

    t = jnp.arange(len(pulse), dtype=np.int64) * drive.period
    start = jax.tree.map(jnp.asarray, drive.init(None))
    return jax.lax.scan(body, start, (t, pulse, speed, valid))[1]


def _commands(seed=0):
    """A new random command every 37 ms, zeros and impossible ones among them."""
    rng = np.random.default_rng(seed)
    n = STEPS // 37 + 1
    pulse = rng.uniform(0.8e-3, 2.2e-3, n)
    speed = rng.uniform(-14e3, 14e3, n) * (rng.random(n) > 0.2)
    return np.repeat(pulse, 37)[:STEPS], np.repeat(speed, 37)[:STEPS]


def _plain(pulse, speed, valid, braking=True):
    """The description in words, in loops: frames of 20 ms, brake of 150 ms, maps by numpy and scipy."""
    x = np.linspace(-1, 1, 21)
    map_ms, map_deg = 1.5 + 0.5 * x, 35 * np.sin(72 * DEG * x) / np.sin(72 * DEG)
    table = thrust_table(Thruster())
    thrust = RegularGridInterpolator((table.rows()[:, 0], table.columns()[0]), table.values)
    held_pulse, held_speed, reverse, since, rows, brakes = 1.5e-3, 0.0, False, None, [], 0
    for k in range(len(pulse)):
        if k % 20 == 0:
            held_pulse, held_speed = (pulse[k], speed[k]) if valid[k] else (1.5e-3, 0.0)
        n = np.clip(held_speed, -12e3, 12e3)
        if n < 0:
            reverse, since = True, None
        elif n > 0 and reverse and since is None and braking:
            since, brakes = k, brakes + 1
        if since is not None and k - since >= 150:
            reverse, since = False, None
        n = 0.0 if since is not None else n
        theta = np.clip(np.interp(held_pulse * 1e3, map_ms, map_deg), -35, 30)
        inside = np.clip(theta * DEG, table.rows()[0, 0], table.rows()[-1, 0])
        f = thrust([[inside, n]])[0]
        psi = (0.566 - theta) / 1.40 * DEG
        rows.append((f * np.cos(psi), -f * np.sin(psi), f, theta * DEG, n, since is not None, brakes))
    return np.array(rows).T


@pytest.mark.thorough("1")
@pytest.mark.parametrize("seed", range(2))
def test_drive_matches_reference_simulation(seed):
    pulse, speed = _commands(seed)
    valid = np.arange(STEPS) >= 150
    out = _simulate(to_arrays(DRIVE), pulse, speed, valid)
    FX, FY, f, theta, n, braking, brakes = _plain(pulse, speed, valid)
    assert brakes[-1] >= 3
    for got, wanted in ((out.u.FX, FX), (out.u.FY, FY), (out.thrust, f), (out.rudder, theta), (out.brakings, brakes)):
        assert np.allclose(got, wanted, atol=1e-9)
    assert np.allclose(out.speed_rpm, n, atol=1e-6)
    assert np.array_equal(np.asarray(out.mode) == BRAKING, braking)
    assert np.array_equal(out.speed_saturated, np.abs(n) == 12e3)
    assert np.array_equal(out.rudder_saturated, (theta < -35 * DEG + 1e-9) | (theta > 30 * DEG - 1e-9))


@pytest.mark.thorough
def test_drive_is_neutral_before_the_first_valid_command():
    pulse, speed = _commands()
    out = _simulate(to_arrays(DRIVE), pulse[:60], speed[:60], np.zeros(60, bool))
    neutral = DRIVE.neutral()
    for got, rest in zip(jax.tree.leaves(out), jax.tree.leaves(neutral), strict=True):
        assert np.array_equal(got, np.broadcast_to(rest, 60))
    assert float(neutral.rudder) == pytest.approx(0, abs=1e-12)


def test_command_takes_effect_with_the_next_frame():
    speed = np.where(np.arange(60) >= 21, 6000.0, 3000.0)
    out = _simulate(to_arrays(DRIVE), np.full(60, 1.5e-3), speed, np.ones(60, bool))
    assert np.array_equal(np.unique(out.speed_rpm[:40]), [3000])
    assert np.array_equal(np.unique(out.speed_rpm[40:]), [6000])


def test_reverse_to_forward_brakes_unless_switched_off():
    speed = np.where(np.arange(400) < 100, -4000.0, 4000.0)
    pulse, valid = np.full(400, 1.5e-3), np.ones(400, bool)
    out = _simulate(to_arrays(DRIVE), pulse, speed, valid)
    assert np.array_equal(np.asarray(out.mode), [REVERSE] * 100 + [BRAKING] * 150 + [FORWARD] * 150)
    assert np.array_equal(np.asarray(out.u.FX) == 0, np.asarray(out.mode) == BRAKING)
    free = _simulate(to_arrays(without(DRIVE, "braking")), pulse, speed, valid)
    assert np.array_equal(free.speed_rpm, speed)
    assert int(free.brakings[-1]) == 0


def test_disabled_saturation_removes_the_limits():
    pulse = np.full(20, 3.5e-3)
    out = _simulate(to_arrays(without(DRIVE, "saturation")), pulse, np.full(20, 20e3), np.ones(20, bool))
    assert float(out.speed_rpm[0]) == 20e3
    assert float(out.rudder[0]) > 80 * DEG
    assert not np.asarray(out.speed_saturated | out.rudder_saturated).any()
    limited = _simulate(to_arrays(DRIVE), pulse, np.full(20, 20e3), np.ones(20, bool))
    assert float(limited.speed_rpm[0]) == 12e3
    assert float(limited.rudder[0]) == pytest.approx(30 * DEG)


def test_disabled_tables_give_the_analytical_thrust():
    rng = np.random.default_rng(4)
    pulse, speed, valid = rng.uniform(1e-3, 2e-3, 100), rng.uniform(0, 12e3, 100), np.ones(100, bool)
    drive = replace(without(DRIVE, "lookup-table"), frame=ms(1))
    out = _simulate(to_arrays(drive), pulse, speed, valid)
    assert np.allclose(out.thrust, 1.6 / 144e6 * speed**2 * np.cos(np.asarray(out.rudder) - 0.566 * DEG), atol=1e-12)
    tabulated = _simulate(to_arrays(replace(DRIVE, frame=ms(1))), pulse, speed, valid)
    assert 1e-5 < np.abs(tabulated.thrust - out.thrust).max() < 2e-3


def test_fan_effectiveness_scales_force_and_time_constant_lags_speed():
    pulse, speed, valid = np.full(300, 1.5e-3), np.full(300, 8000.0), np.ones(300, bool)
    full = _simulate(to_arrays(DRIVE), pulse, speed, valid)
    weak = _simulate(to_arrays(replace(DRIVE, effectiveness=0.7)), pulse, speed, valid)
    assert np.allclose(weak.u.FX, 0.7 * full.u.FX)
    slow = _simulate(to_arrays(replace(DRIVE, thruster=Thruster(time_constant=0.1))), pulse, speed, valid)
    assert np.allclose(slow.speed_rpm, 8000 * -np.expm1(-np.arange(1, 301) * 1e-2))


def test_force_is_differentiable_in_the_command():
    def force(x):
        _, out = DRIVE.step(np.int64(0), DRIVE.init(None), new_sample(np.int64(0), DriveCommand(x[0], x[1])))
        return jnp.stack([out.u.FX, out.u.FY])

    slopes = jax.jit(jax.vmap(jax.jacfwd(force)))(np.array([[1.52e-3, 6020.0], [1.4e-3, -7000.0], [1.5e-3, 0.0]]))
    assert np.isfinite(slopes).all()
    assert slopes[0, 0, 1] > 0, "faster pushes more"
    assert slopes[0, 1, 0] > 0, "a longer pulse pushes the tail to starboard"


def test_rejects_bad_period_and_foreign_thruster():
    assert isinstance(DRIVE, Actuators)
    DRIVE.check()
    with pytest.raises(InputError, match="servo frame of 20 ms must be a multiple of the drive's period of 3 ms"):
        replace(DRIVE, period=ms(3)).check()
    with pytest.raises(InputError, match="another thruster"):
        replace(DRIVE, thruster=Thruster(coefficient=0.012)).check()
    with pytest.raises(InputError, match="no imperfection 'dead-zone'"):
        without(DRIVE, "dead-zone")

"""The F-16 over a flat earth: its equations against its own flight, its engine against plain branches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rotation import DEG, from_euler
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import GRAVITY, F16FlatEarth, F16State, air_data, engine_command, power_rate
from trimtab.vehicles.imperial import FOOT, SLUG

CRAFT = F16FlatEarth()
SOME = F16State(165.0, 0.15, 0.05, 0.6, -0.3, 1.2, 0.4, 0.2, -0.1, 100.0, -50.0, 900.0, 0.3)
CONTROLS = F16Controls(-2 * DEG, 3 * DEG, -4 * DEG, 0.4)


def velocity_over_ground(x):
    return from_euler(x.roll, x.pitch, x.yaw) @ CRAFT.loads(x, CONTROLS).velocity


@pytest.mark.thorough
def test_motion_acceleration_is_the_derivative_of_velocity():
    """Of the motion, against the derivative of the state through every angle."""
    rate = CRAFT.dynamics(0.0, SOME, CONTROLS)
    change = jax.jvp(velocity_over_ground, (SOME,), (jax.tree.map(jnp.asarray, rate),))[1]
    motion = CRAFT.motion(0, SOME, CONTROLS)
    np.testing.assert_allclose(from_euler(*motion.attitude) @ motion.a_WB_B, change, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(velocity_over_ground(SOME), [rate.north, rate.east, -rate.altitude], rtol=1e-13)


@pytest.mark.thorough
def test_euler_angle_rates_match_body_rates():
    """R' = R [w]×, by the derivative of the Euler angles."""
    rate = CRAFT.dynamics(0.0, SOME, CONTROLS)
    angles, change = (jnp.stack([r.roll, r.pitch, r.yaw]) for r in (SOME, rate))
    turned = jax.jvp(lambda a: from_euler(*a), (angles,), (change,))[1]
    p, q, r = SOME.roll_rate, SOME.pitch_rate, SOME.yaw_rate
    across = np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]])
    np.testing.assert_allclose(turned, from_euler(*angles) @ across, atol=1e-13)


@pytest.mark.thorough
def test_angular_momentum_obeys_eulers_equation():
    """J w' + w × (J w + h) is the moment, with a matrix that the vehicle does not build."""
    loads = CRAFT.loads(SOME, CONTROLS)
    x, y, z = CRAFT.inertia
    J = np.array([[x, 0, -CRAFT.product], [0, y, 0], [-CRAFT.product, 0, z]])
    w = np.array([SOME.roll_rate, SOME.pitch_rate, SOME.yaw_rate])
    h = J @ w + np.array([CRAFT.engine_momentum, 0, 0])
    np.testing.assert_allclose(J @ loads.turn + np.cross(w, h), loads.wrench.moment, rtol=1e-12)


def test_energy_is_conserved_without_air():
    """So high that the formula has no air left, and with idle power at its least: energy stays."""
    craft = replace(CRAFT, engine_momentum=0.0)
    x = replace(SOME, altitude=1 / 0.703e-5 * FOOT * (1 - 1e-9))
    loads, rate = jax.jit(lambda x: (craft.loads(x, CONTROLS), craft.dynamics(0.0, x, CONTROLS)))(to_arrays(x))
    thrust = np.asarray(loads.wrench.force)[0] / craft.mass
    gained = x.speed * rate.speed + GRAVITY * rate.altitude
    u = loads.velocity[0]
    np.testing.assert_allclose(gained, thrust * u, rtol=1e-9)


@pytest.mark.parametrize("power", [0.0, 0.2, 0.45, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("wanted", [0.0, 0.1, 0.3, 0.49, 0.5, 0.7, 1.0])
def test_power_rate_matches_the_published_program(power, wanted):
    """In per cent and by plain branches, as [1] prints PDOT and RTAU."""
    p, w = 100 * power, 100 * wanted

    def inverse_lag(gap):
        return 1.0 if gap <= 25 else 0.1 if gap >= 50 else 1.9 - 0.036 * gap

    towards = (w if p >= 50 else 60.0) if w >= 50 else 40.0 if p >= 50 else w
    rate = (5.0 if p >= 50 else inverse_lag(towards - p)) * (towards - p)
    np.testing.assert_allclose(100 * power_rate(power, wanted), rate, atol=1e-12)


def test_throttle_to_power_map_matches_tgear():
    """[1], TGEAR: 64.94 u, and 217.38 u - 117.38 beyond the knee, which meet there."""
    np.testing.assert_allclose([engine_command(u) for u in (0.0, 0.5, 1.0)], [0.0, 0.3247, 1.0], atol=1e-12)
    assert abs(float(engine_command(0.77)) - float(engine_command(0.7700001))) < 2e-5


def test_atmosphere_matches_the_textbook():
    """Sea level as printed; at 35 000 ft the temperature stands still at 390 Rankine."""
    sea, high, higher = (air_data(h * FOOT) for h in (0.0, 35_000.0, 45_000.0))
    np.testing.assert_allclose(sea.density / (SLUG / FOOT**3), 2.377e-3, rtol=1e-12)
    np.testing.assert_allclose(sea.sound_speed / FOOT, np.sqrt(1.4 * 1716.3 * 519), rtol=1e-12)
    assert float(high.temperature) == float(higher.temperature) == pytest.approx(390 / 1.8)
    np.testing.assert_allclose(high.density / sea.density, (1 - 0.703e-5 * 35_000) ** 4.14, rtol=1e-12)


@pytest.mark.thorough
def test_mirrored_initial_states_fly_mirrored():
    """Without the turning engine, surfaces and sideslip's own tables: a second of flight."""
    craft = replace(CRAFT, engine_momentum=0.0)

    def fly(side):
        x = replace(SOME, beta=0.0, roll=side * 0.5, yaw=0.0, east=0.0, roll_rate=side * 0.2, yaw_rate=side * 0.05)
        u = F16Controls(-2 * DEG, 0.0, 0.0, 0.3)
        for i in range(20):
            x = step(i * 0.02, x, u)
        return x

    step = jax.jit(lambda t, x, u: rk4(lambda t, x: craft.dynamics(t, x, u), t, x, 0.02))
    one, other = fly(1.0), fly(-1.0)
    for name in ("beta", "roll", "yaw", "roll_rate", "yaw_rate", "east"):
        np.testing.assert_allclose(getattr(other, name), -getattr(one, name), atol=1e-9)
    for name in ("speed", "alpha", "pitch", "altitude"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)


def test_rejects_physically_impossible_inertia():
    with pytest.raises(InputError, match="are not possible for a body"):
        replace(CRAFT, inertia=np.array([1.0, 1.0, 3.0])).check()

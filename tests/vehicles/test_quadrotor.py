"""The multirotor: hover, free fall, moments of each rotor, gyroscopics, drag, lag, what sensors feel, and refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.environment.wind import Wind
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, Rotors, RotorSpeeds, ring_rotors

CRAFT = Multirotor()
STEP = 1e-3


@jax.jit
def step(craft, x, u):
    return craft.after_step(0.0, rk4(lambda t, x: craft.dynamics(t, x, u), 0.0, x, STEP))


def fly(craft, x, u, duration):
    for _ in range(round(duration / STEP)):
        x = step(craft, x, u)
    return x


def test_hover_is_an_equilibrium():
    x = CRAFT.hover((1.0, 2.0, -3.0), heading=1.2)
    dx = jax.jit(lambda x: CRAFT.dynamics(0.0, x, RotorSpeeds(x.rotor_speed)))(x)
    for name in ("position", "velocity", "attitude", "rate", "rotor_speed"):
        np.testing.assert_allclose(getattr(dx, name), 0, atol=1e-12, err_msg=name)


def test_default_parameters_match_the_publication():
    """m = 4.34 kg, J = diag(0.0820, 0.0845, 0.1377) kg m^2, d = 0.315 m, c = 8.004e-4 m; its matrix of f to (f, M)."""
    d, c = 0.315, 8.004e-4
    B = [[1, 1, 1, 1], [0, -d, 0, d], [d, 0, -d, 0], [-c, c, -c, c]]
    np.testing.assert_allclose(CRAFT.rotors.effectiveness(), B, atol=1e-15)
    assert CRAFT.mass == 4.34
    np.testing.assert_array_equal(CRAFT.inertia, [0.0820, 0.0845, 0.1377])


def test_free_fall_conserves_angular_momentum():
    x = replace(CRAFT.hover(), rate=np.array([1.0, -2.0, 3.0]), rotor_speed=np.zeros(4))
    y = fly(CRAFT, x, RotorSpeeds(np.zeros(4)), 1.0)
    np.testing.assert_allclose(y.position, [0, 0, 9.81 / 2], atol=1e-9)
    J = np.asarray(CRAFT.inertia)
    before = np.asarray(quaternion.to_matrix(x.attitude)) @ (J * x.rate)
    after = np.asarray(quaternion.to_matrix(y.attitude)) @ (J * np.asarray(y.rate))
    np.testing.assert_allclose(after, before, atol=1e-8)
    assert np.linalg.norm(y.attitude) == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize(("rotor", "signs"), [(0, (0, 1)), (1, (-1, 0)), (2, (0, -1)), (3, (1, 0))])
def test_each_rotor_lifts_its_side(rotor, signs):
    x = CRAFT.hover()
    more = np.asarray(x.rotor_speed) * np.where(np.arange(4) == rotor, 1.1, 1.0)
    turn = np.asarray(CRAFT.accelerations(x, RotorSpeeds(more))[1])
    assert tuple(np.sign(np.round(turn[:2], 9))) == signs
    assert np.sign(turn[2]) == -np.asarray(CRAFT.rotors.spins)[rotor], "the body turns against its rotor"


def test_rotor_angular_momentum_causes_precession():
    craft = replace(CRAFT, rotors=replace(Rotors(), inertia=1e-3, torque_ratio=0.0))
    x = replace(craft.hover(), rate=np.array([1.0, 0.0, 0.0]), rotor_speed=np.array([400.0, 0, 400, 0]))
    pair = craft.rotors.angular_momentum(x.rotor_speed)
    assert pair == pytest.approx(0.8)
    turn = craft.accelerations(x, RotorSpeeds(x.rotor_speed))[1]
    # -w × h e3 = -(1, 0, 0) × (0, 0, 0.8) = (0, 0.8, 0)
    assert turn[1] == pytest.approx(0.8 / 0.0845)


def test_drag_acts_on_velocity_relative_to_wind():
    craft = replace(CRAFT, drag=np.array([0.3, 0.2, 0.1]), wind=Wind(north=5.0))
    still = craft.accelerations(craft.hover((0, 0, -10.0)), RotorSpeeds(craft.hover().rotor_speed))[0]
    np.testing.assert_allclose(still, [0.3 * 5 / 4.34, 0, 0], atol=1e-12)
    with_it = replace(craft.hover((0, 0, -10.0)), velocity=np.array([5.0, 0, 0]))
    np.testing.assert_allclose(craft.accelerations(with_it, RotorSpeeds(with_it.rotor_speed))[0], 0, atol=1e-12)


def test_rotor_speed_lags_by_the_time_constant():
    craft = replace(CRAFT, lag=0.05)
    x = craft.hover()
    y = fly(craft, x, RotorSpeeds(np.asarray(x.rotor_speed) + 50), 0.05)
    np.testing.assert_allclose(np.asarray(y.rotor_speed) - np.asarray(x.rotor_speed), 50 * (1 - np.exp(-1)), rtol=1e-6)
    at_once = CRAFT.accelerations(x, RotorSpeeds(np.zeros(4)))[0]
    np.testing.assert_allclose(at_once, [0, 0, 9.81], atol=1e-12)
    later = craft.accelerations(x, RotorSpeeds(np.zeros(4)))[0]
    np.testing.assert_allclose(later, 0, atol=1e-12)


def test_motion_is_consistent_with_the_dynamics():
    q = np.asarray(quaternion.from_euler(0.3, -0.2, 1.0))
    x = MultirotorState(
        np.array([1.0, 2, -3]), np.array([4.0, -1, 0.5]), q, np.array([0.1, 0.2, -0.3]), np.full(4, 300.0)
    )
    u = RotorSpeeds(np.full(4, 350.0))
    m, a = CRAFT.motion(seconds(1), x, u), CRAFT.accelerations(x, u)
    R = np.asarray(quaternion.to_matrix(q))
    np.testing.assert_allclose(m.attitude, [0.3, -0.2, 1.0], atol=1e-12)
    np.testing.assert_allclose(R @ m.v_WB_B, x.velocity, atol=1e-12)
    np.testing.assert_allclose(R @ m.a_WB_B, a[0], atol=1e-12)
    np.testing.assert_array_equal(m.alpha_WB_B, a[1])


def test_rotor_speeds_and_thrusts_are_inverse():
    thrust = np.array([-3.0, 0.0, 1e-9, 20.0])
    np.testing.assert_allclose(CRAFT.rotors.thrusts(CRAFT.rotors.speeds(jnp.asarray(thrust))), thrust, atol=1e-15)


def test_ring_layout_places_and_spins_rotors():
    places, spins = ring_rotors("PNPNPN", 0.4)
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 0.4)
    np.testing.assert_array_equal(spins, [1, -1, 1, -1, 1, -1])
    np.testing.assert_allclose(places[0], [0.4, 0, 0])
    assert places[1][1] > 0, "clockwise from above: to starboard"
    with pytest.raises(InputError, match=r"P \(clockwise from above\) or N"):
        ring_rotors("PX", 0.4)


@pytest.mark.parametrize(
    "wrong", [{"spins": np.array([1.0, -1, 1])}, {"spins": np.array([1.0, -1, 1, 0.5])}, {"places": np.zeros((3, 3))}]
)
def test_rejects_incomplete_rotor_descriptions(wrong):
    with pytest.raises(InputError):
        replace(Rotors(), **wrong).check()

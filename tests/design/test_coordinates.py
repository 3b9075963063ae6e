"""Trim and error coordinates of a vehicle in space: steady motion is at rest, no spurious poles, linear deviations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from trimtab.core import quaternion
from trimtab.core.integrate import rk4
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.signals import PlanarForce
from trimtab.design.coordinates import DERIVED, error_model, error_names, state_from_trim, trim_model
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_vehicle
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

J = np.array([1.0, 1.0, 2.0])


@record
class DartState:
    """Source: this test."""

    p_W: object = quantity("m", "Place.", frame="W", shape=(3,))
    v_W: object = quantity("m/s", "Velocity.", frame="W", shape=(3,))
    q_WB: object = quantity("1", "Attitude.", frame="WB", shape=(4,))
    w: object = quantity("rad/s", "Rate.", frame="B", shape=(3,))
    fuel: Scalar = quantity("kg", "Fuel.")


@record
class DartInput:
    """Source: this test."""

    force: object = quantity("N", "Force.", frame="B", shape=(3,))
    moment: object = quantity("N m", "Moment.", frame="B", shape=(3,))


class Dart:
    """A body with drag in its own axes, whose motion no place and no heading changes."""

    def dynamics(self, t, x, u):
        R = quaternion.to_matrix(x.q_WB)
        v = R.T @ x.v_W
        force = u.force - jnp.array([0.3, 0.7, 0.9]) * v
        turn = (u.moment - jnp.cross(x.w, J * x.w) - 0.2 * x.w + jnp.array([0.0, -0.1, 0.05]) * v[::-1]) / J
        return DartState(x.v_W, R @ force + jnp.array([0, 0, 9.8]), quaternion.rate(x.q_WB, x.w), turn, -0.1 * x.fuel)


def steady_turn():
    """Level, at 3 m/s, turning at 0.4 rad/s about the vertical, banked: force and moment that keep it so."""
    roll, pitch, yaw, rate = 0.3, 0.1, 0.7, 0.4
    q = quaternion.from_euler(roll, pitch, yaw)
    R = np.asarray(quaternion.to_matrix(q))
    w, v_W = R.T @ [0, 0, rate], np.array([3 * np.cos(yaw), 3 * np.sin(yaw), 0.0])
    a_W = np.cross([0, 0, rate], v_W)
    v = R.T @ v_W
    force = R.T @ (a_W - [0, 0, 9.8]) + np.array([0.3, 0.7, 0.9]) * v
    moment = np.cross(w, J * w) + 0.2 * w - np.array([0.0, -0.1, 0.05]) * v[::-1]
    return DartState(np.array([1.0, 2, 3]), v_W, np.asarray(q), w, 0.0), DartInput(force, moment)


@pytest.mark.thorough
def test_steady_turn_is_an_equilibrium_in_error_coordinates():
    x, u = steady_turn()
    errors = error_model(Dart(), x, u)
    np.testing.assert_allclose(errors.f(errors.x0, errors.u0), 0, atol=1e-13)
    model = trim_model(Dart(), x, u)
    rates = dict(zip(model.states, np.asarray(model.f(model.x0, model.u0)), strict=True))
    assert rates["q_WB.yaw"] == pytest.approx(0.4)
    moving = {n for n, v in rates.items() if abs(v) > 1e-12}
    assert moving == {"q_WB.yaw", "p_W[0]", "p_W[1]"}


@pytest.mark.thorough
def test_quaternion_length_adds_no_state_and_no_pole():
    x, u = steady_turn()
    linear = linearise(error_model(Dart(), x, u))
    assert len(linear.states) == 13
    # a place that moves along while it turns: 0 and the turn itself, which four components would show once more
    on_axis = sorted(p.imag for p in linear.poles() if abs(p.real) < 1e-7)
    np.testing.assert_allclose(on_axis, [-0.4, 0, 0, 0.4], atol=1e-6)


@pytest.mark.thorough
def test_deviations_from_steady_turn_follow_the_linear_model():
    """The vehicle itself, with and without a small deviation, 2 s on: attitude, velocity and place in body axes."""
    x, u = steady_turn()
    linear = linearise(error_model(Dart(), x, u))
    model = error_model(Dart(), x, u)
    e = 1e-5 * np.random.default_rng(1).normal(size=13)

    def fly(state):
        def step(s, _):
            return rk4(lambda t, s: Dart().dynamics(t, s, u), 0.0, s, 2e-3), None

        return jax.lax.scan(step, jax.tree.map(jnp.asarray, state), None, length=1000)[0]

    base, other = fly(x), fly(model.state(model.x0 + e))
    R, S = (np.asarray(quaternion.to_matrix(s.q_WB)).T for s in (base, other))
    end = np.concatenate(
        [
            R @ (other.p_W - base.p_W),
            S @ other.v_W - R @ base.v_W,
            quaternion.local(quaternion.normalise(base.q_WB), quaternion.normalise(other.q_WB)),
            other.w - base.w,
            [other.fuel - base.fuel],
        ]
    )
    np.testing.assert_allclose(expm(2.0 * linear.A) @ e, end, atol=2e-9)
    assert np.abs(end).max() > 5e-6


@pytest.mark.thorough
def test_spinning_top_nutates_at_euler_rate():
    """Torque-free and symmetrical: rates turn at (J3 - J1)/J1 times the spin in body axes. Source: Euler."""

    class Top:
        def dynamics(self, t, x, u):
            rate = (u.moment - jnp.cross(x.w, J * x.w)) / J
            return DartState(x.v_W, 0 * x.v_W, quaternion.rate(x.q_WB, x.w), rate, 0.0 * x.fuel)

    x = DartState(np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]), np.array([0, 0, 5.0]), 0.0)
    linear = linearise(error_model(Top(), x, DartInput(np.zeros(3), np.zeros(3)))).part(states=["w[0]", "w[1]"])
    np.testing.assert_allclose(np.sort(linear.poles().imag), [-5, 5], rtol=1e-12)


def test_state_record_round_trips_through_trim_coordinates():
    x, u = steady_turn()
    model = trim_model(Dart(), x, u)
    back = model.state(model.x0)
    for name in ("p_W", "v_W", "w"):
        np.testing.assert_allclose(getattr(back, name), getattr(x, name), atol=1e-12)
    np.testing.assert_allclose(quaternion.local(back.q_WB, jnp.asarray(x.q_WB)), 0, atol=1e-12)
    put = state_from_trim(x, {"q_WB.yaw": 0.0, "v_W.forward": 5.0})
    assert trim_model(Dart(), put, u).x0[model.states.index("v_W.forward")] == pytest.approx(5.0)
    assert error_names(x, "v_W") == ("v_W.forward", "v_W.starboard", "v_W.down")
    assert error_names(x, "no such") == ()


def test_trim_model_outputs_speed_and_flight_angles():
    x, u = steady_turn()
    model = trim_model(Dart(), replace(x, v_W=np.array([3.0, 4.0, -5.0])), u)
    derived = dict(zip(model.outputs, np.asarray(model.h(model.x0, model.u0)), strict=True))
    assert derived["speed"] == pytest.approx(np.sqrt(50))
    assert derived["climb"] == pytest.approx(np.arcsin(5 / np.sqrt(50)))
    assert model.outputs[-4:] == DERIVED


def test_planar_vehicle_keeps_its_states():
    x, u = HovercraftState(surge_velocity=1.0, heading=0.3), PlanarForce(0.5, 0.1)
    plain = linearise(model_of_vehicle(Hovercraft(), x, u))
    for make in (trim_model, error_model):
        linear = linearise(make(Hovercraft(), x, u))
        assert linear.states == plain.states
        np.testing.assert_allclose(linear.A, plain.A, atol=1e-14)
        np.testing.assert_allclose(linear.B, plain.B, atol=1e-14)

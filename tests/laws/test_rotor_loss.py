"""The law for a lost rotor: detection, demand after the loss, and the nominal law before."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.design.relaxed_hover import find_relaxed_hover
from trimtab.scenarios.build import build
from trimtab.vehicles.quadrotor import MultirotorState

LAW = build("quadrotor/track", {"trajectory": "place"}).autopilot.law
CRAFT = LAW.nominal.craft
PLACE = np.array([0.0, 0.0, -3.0])
TURNS = np.full(4, 365.0)


def run(law, speeds, x=None, dt=0.005):
    """Return outputs and last state of a law that measures these rotor speeds in turn."""
    x = CRAFT.hover(PLACE) if x is None else x
    state, outputs = law.init(key(0)), []
    step = jax.jit(law.step)
    for k, speed in enumerate(speeds):
        seen = Estimate(
            t=k,
            age=0.0,
            fresh=True,
            valid=True,
            state=replace(x, rotor_speed=np.asarray(speed, float)),
            dt=np.float64(dt),
        )
        state, out = step(k, state, seen)
        outputs.append(out)
    return outputs, state


@pytest.mark.thorough
def test_healthy_rotors_use_the_nominal_law():
    x = replace(CRAFT.hover(PLACE + np.array([0.2, -0.1, 0.3])), velocity=np.array([0.1, 0.0, -0.2]))
    (out,), _ = run(LAW, [TURNS], x)
    same = LAW.nominal.track(LAW.nominal.reference.at(0.0), x)
    np.testing.assert_allclose(out.demand.moment, same.demand.moment, rtol=1e-14)
    assert out.demand.thrust == pytest.approx(float(same.demand.thrust), rel=1e-14)
    assert not out.lost
    assert out.rotor == -1


@pytest.mark.thorough("0", "2", "3")
@pytest.mark.parametrize("rotor", range(4))
def test_stopped_rotor_is_detected_after_patience_and_latched(rotor):
    stands = np.where(np.arange(4) == rotor, 0.0, TURNS)
    outputs, _ = run(LAW, [TURNS] * 3 + [stands] * 4 + [TURNS] * 2)
    # patience of 12 ms: at 5, 10 and 15 ms of standing still
    np.testing.assert_array_equal([bool(o.lost) for o in outputs], [0, 0, 0, 0, 0, 1, 1, 1, 1])
    assert outputs[-1].rotor == rotor
    np.testing.assert_array_equal(outputs[-1].demand.working, np.arange(4) != rotor)


@pytest.mark.thorough
def test_ignores_short_pauses_and_second_rotor_losses():
    pause = [0.0, *TURNS[1:]]
    assert not run(LAW, [pause, pause, TURNS, pause, pause])[0][-1].lost
    later, _ = run(LAW, [pause] * 3 + [[0.0, 0.0, 365.0, 365.0]] * 5)
    np.testing.assert_array_equal(later[-1].demand.working, [False, True, True, True])


@pytest.mark.thorough
def test_reference_freezes_after_rotor_loss():
    law = build("quadrotor/track", {"trajectory": "helix"}).autopilot.law
    stands = [0.0, 365.0, 365.0, 365.0]
    outputs, state = run(law, [TURNS] * 10 + [stands] * 20)
    # patience is over in the 13th step: time 0.06 s is the place
    assert state.time == pytest.approx(0.06)
    wanted = law.reference.at(0.06).place
    np.testing.assert_allclose(outputs[-1].position_error, PLACE - wanted, atol=1e-12)
    np.testing.assert_allclose(outputs[-1].velocity_error, 0, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("rotor", range(4))
def test_relaxed_hover_demand_matches_the_hover_wrench(rotor):
    hover = find_relaxed_hover(CRAFT, rotor, 0.3)
    v = np.cross(hover.axis, [0, 0, 1])
    q = np.array([1 + hover.axis[2], *v])
    x = MultirotorState(
        PLACE, np.zeros(3), q / np.linalg.norm(q), hover.rate, np.asarray(CRAFT.rotors.speeds(hover.thrusts))
    )
    outputs, _ = run(replace(LAW, prediction_time=0.0), [x.rotor_speed] * 4, x)
    out = outputs[-1]
    assert out.rotor == rotor
    made = np.asarray(CRAFT.rotors.effectiveness()) @ hover.thrusts
    assert out.demand.thrust == pytest.approx(made[0], rel=1e-6)
    np.testing.assert_allclose(out.demand.moment, made[1:], atol=1e-5)
    assert out.attitude_error == pytest.approx(0, abs=1e-9)


@pytest.mark.thorough
def test_spin_axis_follows_second_order_dynamics_of_its_gains():
    """d'' = -ks (d - axis) - kd d', in x and y, along the motion that the demanded moment makes."""
    rng, law = np.random.default_rng(0), replace(LAW, prediction_time=0.0)
    R_of = quaternion.to_matrix
    for _ in range(10):
        q = quaternion.retract(jnp.array([1.0, 0, 0, 0]), jnp.asarray(rng.uniform(-0.4, 0.4, 3)))
        x = replace(
            CRAFT.hover(PLACE), attitude=q, rate=rng.uniform(-3, 3, 3), rotor_speed=np.array([0.0, 400, 250, 420])
        )
        demand, _ = law._spin(law.reference.at(0.0), x, np.array([True, False, False, False]))
        J, down = np.asarray(CRAFT.inertia), np.array([0.0, 0, 1])
        spin = float(CRAFT.rotors.angular_momentum(x.rotor_speed)) * down
        w_rate = (demand.moment - np.cross(x.rate, J * x.rate + spin) - np.asarray(CRAFT.turning_drag) * x.rate) / J
        d = np.asarray(R_of(x.attitude)).T @ down  # at its place without speed: the wanted force is the weight
        d_rate = np.cross(d, x.rate)
        d_turn = np.cross(d_rate, x.rate) + np.cross(d, w_rate)
        want = -law.ks * (d - np.asarray(law.axes)[0]) - law.kd * d_rate
        np.testing.assert_allclose(d_turn[:2], want[:2], atol=1e-8)


@pytest.mark.thorough("1", "2", "3")
@pytest.mark.parametrize("rotor", range(4))
def test_inverted_axis_is_repelled_from_its_mirror_image(rotor):
    """At the image d - axis has no x or y component; around it, d'' points away."""
    law, lost = replace(LAW, prediction_time=0.0), np.arange(4) == rotor
    mirror = np.asarray(law.axes)[rotor] * [1, 1, -1]
    for angle in np.arange(8) * np.pi / 4:
        away = 0.2 * np.array([np.cos(angle), np.sin(angle)])
        d = np.append(mirror[:2] + away, 0.0)
        d[2] = -np.sqrt(1 - d @ d)
        q = np.array([1 + d[2], *np.cross(d, [0, 0, 1])])  # of the turn that brings d to down
        x = replace(CRAFT.hover(PLACE), attitude=q / np.linalg.norm(q), rotor_speed=np.where(lost, 0.0, 100.0))
        np.testing.assert_allclose(np.asarray(quaternion.to_matrix(x.attitude)).T @ [0, 0, 1], d, atol=1e-12)
        demand, error = law._spin(law.reference.at(0.0), x, lost)
        assert error > 1.3
        assert np.cross(d, demand.moment / np.asarray(CRAFT.inertia))[:2] @ away > 1

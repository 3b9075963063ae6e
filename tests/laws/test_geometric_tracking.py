"""Geometric tracking: the two flights and the propositions of its publication."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core import quaternion
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.core.rotation import to_euler
from trimtab.core.spatial_reference import FixedPlace, Helix, LevelPath
from trimtab.laws.geometric_tracking import DOWN, GeometricTracking, command_attitude, heading_vector
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, RotorSpeeds

CRAFT = Multirotor()
HELIX = GeometricTracking(reference=Helix())
STEP = 1e-3


def hands(craft, demand):
    """Return the rotor speeds for exactly this demand: the publication has no limits and no lag."""
    return RotorSpeeds(
        craft.rotors.speeds(jnp.linalg.inv(craft.rotors.effectiveness()) @ jnp.append(demand.thrust, demand.moment))
    )


def closed_loop(law, t, x):
    """Return the derivative of the state under the law without delay."""
    return CRAFT.dynamics(t, x, hands(CRAFT, law.track(law.reference.at(t), x).demand))


@functools.cache
def flights():
    """Return a compiled flight of 10 s: states and outputs every millisecond."""

    def fly(law, x):
        def step(x, k):
            t = k * STEP
            out = law.track(law.reference.at(t), x)
            after = rk4(lambda t, x: closed_loop(law, t, x), t, x, STEP)
            return CRAFT.after_step(t, after), (x, out)

        return jax.lax.scan(step, x, jnp.arange(10_000))[1]

    return jax.jit(fly)


def upside_down():
    """Return the initial state of the second published flight: R(0) = [1 0 0; 0 -0.9995 -0.0314; 0 0.0314 -0.9995]."""
    R = np.array([[1, 0, 0], [0, -0.9995, -0.0314], [0, 0.0314, -0.9995]])
    return replace(CRAFT.hover(), attitude=np.asarray(quaternion.normalise(quaternion.from_matrix(jnp.asarray(R)))))


def draw_state(rng, law, t):
    """Return a random state near the reference at t, with an attitude error below 90 degrees."""
    x = MultirotorState(
        np.asarray(law.reference.at(t).place) + rng.uniform(-0.5, 0.5, 3),
        rng.uniform(-1, 1, 3),
        np.array([1.0, 0, 0, 0]),
        rng.uniform(-2, 2, 3),
        np.zeros(4),
    )
    A = law.command_force(law.reference.at(t), x, np.eye(3))
    R = command_attitude(A, heading_vector(law.reference.at(t))).R
    q = quaternion.retract(quaternion.from_matrix(R), jnp.asarray(rng.uniform(-0.8, 0.8, 3)))
    return replace(x, attitude=np.asarray(q))


def attitude_errors(law, t, x):
    """Psi, eR and eW, from the definitions of the publication (eqs. 9 to 11)."""
    R = quaternion.to_matrix(x.attitude)
    command = command_attitude(law.command_force(law.reference.at(t), x, R), heading_vector(law.reference.at(t)))
    S = command.R.T @ R - R.T @ command.R
    eR = jnp.stack([S[2, 1], S[0, 2], S[1, 0]]) / 2
    return jnp.trace(jnp.eye(3) - command.R.T @ R) / 2, eR, x.rate - R.T @ command.R @ command.rate


def along_flow(law, t, x):
    """Return the errors and their exact derivatives on the closed loop."""

    def at(s):
        flow = closed_loop(law, t, x)
        return attitude_errors(law, t + s, jax.tree.map(lambda a, b: a + s * b, x, flow))

    return jax.jvp(at, (0.0,), (1.0,))


@pytest.mark.thorough
@pytest.mark.parametrize("law", [HELIX, GeometricTracking(reference=LevelPath())], ids=["helix", "circle"])
def test_attitude_errors_obey_the_equations_of_the_proof(law):
    """J eW' = -kR eR - kW eW and Psi' = eR·eW [eqs. 12, 17], which requires correct Rc' and Rc''."""
    follow = jax.jit(functools.partial(along_flow, law))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = rng.uniform(0, 5)
        (psi, eR, eW), (psi_rate, _, eW_rate) = follow(t, draw_state(rng, law, t))
        assert 0 < psi < 1
        np.testing.assert_allclose(np.asarray(CRAFT.inertia) * eW_rate, -law.kR * eR - law.kW * eW, atol=1e-9)
        assert psi_rate == pytest.approx(float(eR @ eW), abs=1e-10)


@pytest.mark.thorough
def test_published_helix_errors_decay_exponentially():
    """From rest at the origin, 0.6 m off: Psi stays below 1 and all errors decay exponentially."""
    _, out = flights()(HELIX, CRAFT.hover())
    psi, distance = np.asarray(out.attitude_error), np.asarray(out.distance)
    assert psi[0] < 1
    assert distance[0] == pytest.approx(0.6)
    assert psi.max() < 1
    times = [2000, 3000, 4000, 5000]
    assert (np.diff(np.log(distance[times])) < -1.0).all(), "each second at least e times nearer"
    assert distance[-1] < 1e-6
    assert psi[-1] < 1e-12


@pytest.mark.thorough
def test_published_recovery_from_upside_down_succeeds():
    """From upside down, Psi = 1.9995: upright within two seconds and back at its place, after losing height."""
    x, out = flights()(GeometricTracking(reference=FixedPlace()), upside_down())
    psi = np.asarray(out.attitude_error)
    assert psi[0] == pytest.approx(1.9995, abs=1e-4)
    assert psi[1750:].max() < 0.1
    assert np.asarray(out.distance)[-1] < 1e-3
    assert np.asarray(x.position)[:, 2].max() > 0.3, "down is positive"
    # Psi < 1 from some instant on: the second proposition then takes over.
    first = np.argmax(psi < 1)
    assert (psi[first:] < 1).all()
    assert first < 1500


@pytest.mark.thorough
def test_attitude_error_decays_at_the_linear_rate():
    """At a fixed place position and attitude decouple; log Psi falls at the rate of the slowest linear mode."""
    law = GeometricTracking(reference=FixedPlace())
    start = replace(CRAFT.hover(), attitude=np.array([np.cos(0.4), 0.0, 0.0, np.sin(0.4)]))
    _, out = flights()(law, start)
    psi = np.asarray(out.attitude_error)
    # about yaw alone: J e'' + kW e' + kR e = 0 for small e; Psi ~ e²/2
    roots = np.roots([0.1377, 2.54, 8.81])
    slope = (np.log(psi[2500]) - np.log(psi[1500])) / 1.0
    assert slope == pytest.approx(2 * roots.max().real, rel=0.02)


@pytest.mark.thorough
def test_attitude_command_is_a_rotation_matrix():
    rng, law = np.random.default_rng(4), HELIX
    x = draw_state(rng, law, 1.0)
    command = command_attitude(
        law.command_force(law.reference.at(1.0), x, np.eye(3)), heading_vector(law.reference.at(1.0))
    )
    np.testing.assert_allclose(command.R.T @ command.R, np.eye(3), atol=1e-14)
    assert np.linalg.det(np.asarray(command.R)) == pytest.approx(1)


def test_hover_at_reference_balances_weight_without_moment():
    law = GeometricTracking(reference=FixedPlace((1.0, -2.0, -5.0), heading=0.8))
    out = law.track(law.reference.at(0.0), CRAFT.hover((1.0, -2.0, -5.0), heading=0.8))
    assert out.demand.thrust == pytest.approx(4.34 * 9.81)
    np.testing.assert_allclose(out.demand.moment, 0, atol=1e-12)
    assert out.attitude_error == pytest.approx(0, abs=1e-15)
    turned = law.track(law.reference.at(0.0), CRAFT.hover((1.0, -2.0, -5.0), heading=0.5))
    assert turned.demand.moment[2] > 0


def test_position_correction_force_is_bounded():
    law = GeometricTracking(reference=FixedPlace(), most=25.0)
    far = replace(CRAFT.hover(), position=np.array([100.0, 0, 0]))
    R = np.eye(3)
    A = law.command_force(law.reference.at(0.0), far, R)
    np.testing.assert_allclose(A.value + 4.34 * 9.81 * DOWN, [-25.0, 0, 0], atol=1e-9)
    near = replace(CRAFT.hover(), position=np.array([0.1, 0, 0]))
    same = GeometricTracking(reference=FixedPlace())
    forces = [each.command_force(law.reference.at(0.0), near, R) for each in (law, same)]
    for a, b in zip(*forces, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.thorough
def test_final_heading_matches_the_commanded_heading():
    x, _ = flights()(HELIX, CRAFT.hover())
    heading = np.asarray(to_euler(quaternion.to_matrix(x.attitude[-1])))[2]
    assert np.cos(heading - np.pi * 9.999) == pytest.approx(
        1, abs=2e-2
    )  # pitched, the nose is a little off the heading

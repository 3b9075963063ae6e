"""A rigid body over the earth: conserved quantities, motion, and rejected parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.integrate import rk4
from trimtab.core.quaternion import to_matrix
from trimtab.core.record import replace
from trimtab.core.rotation import from_euler
from trimtab.core.time import seconds
from trimtab.environment.earth import Earth
from trimtab.environment.geodetic import TangentPlane, gravity
from trimtab.environment.wind import Wind
from trimtab.vehicles.rigid_body import NO_WRENCH, BluntBody, RigidBody, Wrench

ORIGIN = TangentPlane(0.7, -1.2, 100.0)
BODY = RigidBody(mass=3.0, inertia=np.array([0.2, 0.5, 0.6]), products=np.array([0.02, -0.01, 0.03]), origin=ORIGIN)
START = BODY.start(
    0.7001, -1.1999, 900.0, velocity=[30.0, -8.0, 4.0], angles=[0.3, -0.2, 1.0], rate=[1.0, -2.0, 0.5], over_ground=True
)
PUSH = Wrench(jnp.array([4.0, -1.0, -20.0]), jnp.array([0.1, 0.2, -0.1]))
DRAGGED = replace(
    BODY, aerodynamics=BluntBody(roll_damping=-1.0, pitch_damping=-0.5, yaw_damping=-0.7), wind=Wind(north=5.0)
)


def flown(body, x, wrench, duration, steps):
    h = duration / steps
    step = jax.jit(lambda t, x: rk4(lambda t, x: body.dynamics(t, x, wrench), t, x, h))
    for k in range(steps):
        x = step(k * h, x)
    return x


@pytest.mark.thorough
def test_unforced_body_conserves_energy_and_momenta():
    J = np.asarray(BODY.inertia_matrix())
    x = flown(BODY, START, NO_WRENCH, 10.0, 2000)
    for before, after in (
        (START.rate @ J @ START.rate, x.rate @ J @ x.rate),
        (to_matrix(START.attitude) @ J @ START.rate, to_matrix(x.attitude) @ J @ x.rate),
        (np.cross(START.position, START.velocity)[2], np.cross(x.position, x.velocity)[2]),
        (energy(START), energy(x)),
    ):
        np.testing.assert_allclose(after, before, rtol=1e-9)


def energy(x):
    earth, r = BODY.earth, float(jnp.sqrt(x.position @ x.position))
    s = x.position[2] / r
    potential = earth.gm / r * (1 - earth.j2 * (earth.semi_major / r) ** 2 * (3 * s * s - 1) / 2)
    return x.velocity @ x.velocity / 2 - potential


def test_inertia_matrix_has_negative_products_of_inertia():
    np.testing.assert_array_equal(BODY.inertia_matrix(), [[0.2, -0.02, -0.03], [-0.02, 0.5, 0.01], [-0.03, 0.01, 0.6]])
    J, b = np.asarray(BODY.inertia_matrix()), np.array([0.3, -1.0, 2.0])
    still = replace(START, rate=jnp.zeros(3))
    turn = BODY.accelerations(0.0, still, Wrench(jnp.zeros(3), jnp.asarray(b)))[1]
    np.testing.assert_allclose(turn, np.linalg.solve(J, b), rtol=1e-13)


@pytest.mark.thorough
@pytest.mark.parametrize("body", [BODY, DRAGGED], ids=["in a vacuum", "in the air"])
def test_motion_is_the_derivative_of_the_ground_pose(body):
    def advance(x):
        return body.dynamics(2.0, x, PUSH)

    def at(t):
        """The motion at t, along a path that is exact to second order about 2 s."""
        s, k = t - 2.0, advance(START)
        slope = jax.jvp(lambda x, t: body.dynamics(t, x, PUSH), (START, 2.0), (k, 1.0))[1]
        x = jax.tree.map(lambda a, d, e: a + s * d + s * s / 2 * e, START, k, slope)
        m = body.motion(t * seconds(1), x, PUSH)
        return m.p_WB, from_euler(*m.attitude), m.w_WB_B, m

    @jax.jit
    def derivatives(t):
        first = jax.jacfwd(lambda t: at(t)[:3])
        return first(t), jax.jacfwd(lambda t: first(t)[0])(t), at(t)

    (velocity, turning, alpha), acceleration, (_, R, _, m) = derivatives(2.0)
    np.testing.assert_allclose(R @ m.v_WB_B, velocity, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(R @ m.a_WB_B, acceleration, rtol=1e-6, atol=1e-6)
    turning = R.T @ turning
    np.testing.assert_allclose([turning[2, 1], turning[0, 2], turning[1, 0]], m.w_WB_B, atol=1e-9)
    np.testing.assert_allclose(alpha, m.alpha_WB_B, atol=1e-6)


@pytest.mark.thorough
def test_body_supported_against_gravity_stays_at_rest():
    """Over the turning earth a body at rest is pushed by its weight, with the centrifugal force in it."""
    x = BODY.start(0.7, -1.2, 100.0, velocity=np.zeros(3), angles=np.zeros(3), rate=np.zeros(3), over_ground=True)
    hold = Wrench(-BODY.mass * jnp.asarray(gravity(0.7, 100.0)), jnp.zeros(3))
    m = BODY.motion(0, x, hold)
    np.testing.assert_allclose(m.p_WB, 0, atol=2e-9)
    np.testing.assert_allclose(m.v_WB_B, 0, atol=1e-12)
    np.testing.assert_allclose(m.w_WB_B, 0, atol=1e-19)
    np.testing.assert_allclose(m.a_WB_B, 0, atol=5 * 2.37e-6 * 9.84)  # the field's higher harmonics


@pytest.mark.thorough
def test_dynamics_are_independent_of_quaternion_norm():
    longer = replace(START, attitude=2.5 * START.attitude)
    one, other = (DRAGGED.dynamics(0.0, x, PUSH) for x in (START, longer))
    np.testing.assert_allclose(other.velocity, one.velocity, rtol=1e-14)
    np.testing.assert_allclose(other.rate, one.rate, rtol=1e-14)


@pytest.mark.thorough
def test_drag_opposes_velocity_relative_to_wind():
    flow = DRAGGED.flight(0.0, START).flow
    force = DRAGGED.aerodynamics.wrench(flow).force
    q = 0.5 * flow.air.density * flow.speed**2
    np.testing.assert_allclose(force, -q * 0.01824 * 0.1 * flow.velocity / flow.speed, rtol=1e-13)
    drifting = DRAGGED.start(
        0.7, -1.2, 900.0, velocity=[5.0, 0.0, 0.0], angles=np.zeros(3), rate=np.zeros(3), over_ground=True
    )
    pushed = DRAGGED.aerodynamics.wrench(DRAGGED.flight(0.0, drifting).flow)
    np.testing.assert_allclose(pushed.force, 0, atol=1e-9)
    assert np.isfinite(jax.jit(jax.jacfwd(lambda x: DRAGGED.dynamics(0.0, x, PUSH).velocity))(drifting).velocity).all()


def test_flight_recovers_the_start_conditions():
    flight = BODY.flight(0.0, START)
    np.testing.assert_allclose(flight.velocity, [30.0, -8.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(flight.angles, [0.3, -0.2, 1.0], atol=1e-12)
    assert flight.latitude == pytest.approx(0.7001, abs=1e-12)
    assert flight.height == pytest.approx(900.0, abs=1e-8)


def test_rejects_physically_impossible_inertia():
    with pytest.raises(InputError, match="are not possible for a body"):
        replace(BODY, inertia=np.array([0.1, 0.1, 0.5])).check()
    with pytest.raises(InputError, match="are not possible for a body"):
        replace(BODY, products=np.array([0.9, 0.0, 0.0])).check()
    RigidBody(earth=Earth()).check()

"""Byrnes-Isidori and Brockett: the hovercraft of [1] Kulis 2006 section 2.3, and systems whose verdict is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.signals import PlanarForce
from trimtab.design.model import model_of_functions
from trimtab.design.stabilisability import (
    Cascade,
    brockett,
    byrnes_isidori,
    controllability_rank,
    find_cascade,
    is_reachable,
    smooth_feedback,
    uncontrollable_eigenvalues,
)
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

CRAFT = Hovercraft()
M, J, D = CRAFT.mass, CRAFT.inertia, CRAFT.arm


def derivative(momenta, pose, force):
    """Full dynamics of the project's vehicle, in momenta: x1 = (PX, PY, Pi), x2 = (heading, north, east)."""
    x = HovercraftState(momenta[0] / M, momenta[1] / M, momenta[2] / J, pose[1], pose[2], pose[0])
    d = CRAFT.dynamics(0.0, x, PlanarForce(force[0], force[1]))
    x1 = jnp.stack([M * d.surge_velocity, M * d.sway_velocity, J * d.yaw_rate])
    return x1, jnp.stack([d.heading, d.north, d.east])


def f1(x1, u):
    return derivative(x1, jnp.zeros(3), u)[0]


def f2(x1, x2):
    return derivative(x1, x2, jnp.zeros(2))[1]


def turning(x, u):
    """x = (PX, PY, Pi, heading)."""
    x1, x2 = derivative(x[:3], jnp.array([x[3], 0.0, 0.0]), u)
    return jnp.concatenate([x1, x2[:1]])


@pytest.mark.thorough
def test_byrnes_isidori_excludes_a_smooth_stabiliser():
    """Ranks 3 and 2 < n1 = 3. [1] section 2.3."""
    v = byrnes_isidori(f1, f2, 3, 3, 2)
    assert (v.rank_f2, v.rank_inputs, v.n1) == (3, 2, 3)
    assert v.h1
    assert v.h2
    assert v.is_excluded


@pytest.mark.thorough("0.001")
@pytest.mark.parametrize("scale", [1e-3, 1e-2])
def test_hovercraft_rates_are_reachable_only_on_a_line(scale):
    """Exact: (b1, b2, b3, 0) is reached if and only if b3 = -d b2. [1] section 2.3."""
    draws = np.random.default_rng(3).uniform(-scale, scale, (5, 3))
    for b1, b2, off in draws:
        assert is_reachable(turning, [b1, b2, -D * b2, 0.0], 2)
        assert not is_reachable(turning, [b1, b2, -D * b2 + off, 0.0], 2)


@pytest.mark.thorough
def test_brockett_excludes_smooth_stabiliser_of_hovercraft():
    """Controllability rank 3 of 4 with the eigenvalue 0 left over, and the image has holes."""
    v = brockett(turning, 4, 2)
    assert v.controllability_rank == 3
    assert v.uncontrollable_unstable == ()
    assert not v.is_onto
    assert v.is_excluded
    along = v.missed_targets / np.linalg.norm(v.missed_targets, axis=1, keepdims=True)
    hole = np.array([0.0, D, 1.0, 0.0]) / np.hypot(D, 1.0)
    assert np.any(np.abs(along @ hole) > 1 - 1e-9)


def test_jacobian_of_f2_matches_the_source():
    """[1] section 2.3: df2/dx1 at the origin is [[0, 0, 1/J], [1/m, 0, 0], [0, 1/m, 0]]."""
    step = 1e-6
    columns = [(np.asarray(f2(step * e, jnp.zeros(3)))) / step for e in np.eye(3)]
    np.testing.assert_allclose(np.array(columns).T, [[0, 0, 1 / J], [1 / M, 0, 0], [0, 1 / M, 0]], rtol=1e-6, atol=1e-9)


@pytest.mark.thorough
def test_third_actuator_lifts_the_exclusion():
    def f1_full(x1, u):
        return f1(x1, u[:2]) + jnp.array([0.0, 0.0, 1.0]) * u[2]

    v = byrnes_isidori(f1_full, f2, 3, 3, 3)
    assert v.rank_inputs == 3
    assert not v.is_excluded


def test_byrnes_isidori_hypotheses_fail_on_counterexamples():
    # x2' = x1^2 has no slope at 0; x2' = x1 + x2 vanishes along a line
    flat = byrnes_isidori(lambda x, u: u[:1] * 0, lambda a, b: a**2, 1, 1, 1)
    assert (flat.h1, flat.h2, flat.is_excluded) == (False, False, False)
    line = byrnes_isidori(lambda x, u: u[:1] * 0, lambda a, b: a + b, 1, 1, 1)
    assert (line.h1, line.h2, line.is_excluded) == (False, True, False)


@pytest.mark.thorough
def test_brockett_on_systems_with_a_known_verdict():
    # Brockett 1983: the nonholonomic integrator, and the unicycle, fail; a double integrator passes;
    # x' = u^3 has no slope but reaches everything; x' = x with a useless input is unstable for ever
    assert brockett(lambda x, u: jnp.stack([u[0], u[1], x[0] * u[1] - x[1] * u[0]]), 3, 2).is_excluded
    assert brockett(lambda x, u: jnp.stack([u[0] * jnp.cos(x[2]), u[0] * jnp.sin(x[2]), u[1]]), 3, 2).is_excluded
    good = brockett(lambda x, u: jnp.stack([x[1], u[0]]), 2, 1)
    assert (good.is_onto, good.is_excluded, good.controllability_rank) == (True, False, 2)
    cubic = brockett(lambda x, u: u**3, 1, 1)
    assert (cubic.is_onto, cubic.is_excluded, cubic.controllability_rank) == (True, False, 0)
    stuck = brockett(lambda x, u: jnp.stack([x[0], u[0]]), 2, 1)
    assert stuck.is_excluded
    np.testing.assert_allclose(stuck.uncontrollable_unstable, [1.0])


def test_controllability_matches_kalman_and_hautus_results():
    A, B = np.array([[1.0, 0.0], [0.0, 2.0]]), np.array([[1.0], [0.0]])
    assert controllability_rank(A, B) == 1
    np.testing.assert_allclose(uncontrollable_eigenvalues(A, B), [2.0])
    assert controllability_rank(A, np.array([[1.0], [1.0]])) == 2
    assert uncontrollable_eigenvalues(A, np.array([[1.0], [1.0]])) == ()


def cascade(f, states, inputs="u"):
    return find_cascade(model_of_functions(f, tuple(states.split()), tuple(inputs.split())))


def test_cascade_includes_states_that_drive_the_rates():
    """a' = b + u, b' = -b, c' = a b: b belongs to x1, as a' depends on it; c drives nothing."""
    assert cascade(lambda x, u: jnp.stack([x[1] + u[0], -x[1], x[0] * x[1]]), "a b c") == Cascade((0, 1), (2,))
    assert cascade(lambda x, u: jnp.stack([x[2] + u[0], -x[1], x[0] * x[1]]), "a b c") is None
    assert cascade(lambda x, u: jnp.stack([u[0] * (1 + x[0]), x[0]]), "a b") is None  # B is not constant


@pytest.mark.thorough
def test_smooth_feedback_verdict_depends_on_input_count():
    """One input for two states that drive two others is too few; a chain of two integrators is fine."""
    lacking = model_of_functions(lambda x, u: jnp.stack([u[0] + x[1], -x[1], x[0], x[1]]), ("a", "b", "c", "d"), ("u",))
    found = smooth_feedback(lacking)
    assert found.cascade == Cascade((0, 1), (2, 3))
    assert (found.byrnes_isidori.rank_inputs, found.byrnes_isidori.n1, found.is_excluded) == (1, 2, True)
    fine = smooth_feedback(model_of_functions(lambda x, u: jnp.stack([u[0], x[0]]), ("a", "c"), ("u",)))
    assert not fine.is_excluded


def test_controllability_rank_keeps_weak_directions():
    """A chain whose powers fall by 1e-4 each time: Kalman's matrix loses the last ones in rounding."""
    A, B = 1e-4 * np.eye(6, k=-1), np.eye(6)[:, :1]
    assert controllability_rank(A, B) == 6
    assert controllability_rank(A, np.eye(6)[:, 2:3]) == 4
    assert controllability_rank(np.diag([1.0, 1.0, 2.0]), np.ones((3, 1))) == 2

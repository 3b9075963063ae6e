"""Total-state filters: derivative of the process, and consistency."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, TICK, frames, monte_carlo, ticks, turn

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.estimators.inertial.direct import AidedInertialDirect
from trimtab.logs.consistency import CONSISTENT, nees_verdict

FORM = to_arrays(AidedInertialDirect(noise=MEMS, start=NEAR))


@pytest.mark.thorough
def test_covariance_propagation_uses_the_process_jacobian():
    """Against automatic derivatives of propagate() itself, with the heading held for the second filter."""
    g = np.random.default_rng(0)
    x1, x2 = g.standard_normal(2), g.standard_normal(6)
    imu_reading = g.standard_normal(3)
    A, B = g.standard_normal((2, 2)), g.standard_normal((6, 6))
    node = replace(FORM.first(), x1=x1, x2=x2, imu_reading=imu_reading, P1=A @ A.T, P2=B @ B.T)

    def moved(x1, x2, P1=node.P1, P2=node.P2):
        return FORM.propagate(replace(node, x1=x1, x2=x2, P1=P1, P2=P2), DT, imu_reading, jnp.zeros(2))

    F1 = jax.jacfwd(lambda a: moved(a, x2).x1)(x1)
    F2 = jax.jacfwd(lambda b: moved(x1, b).x2)(x2)
    none = moved(x1, x2, np.zeros((2, 2)), np.zeros((6, 6)))
    got = moved(x1, x2)
    np.testing.assert_allclose(got.P1, F1 @ node.P1 @ F1.T + none.P1, rtol=1e-12)
    np.testing.assert_allclose(got.P2, F2 @ node.P2 @ F2.T + none.P2, rtol=1e-11, atol=1e-14)


@pytest.mark.thorough
def test_innovations_are_measured_minus_predicted():
    node = FORM.correct_heading(FORM.first(), np.float64(0.01))
    assert node.heading_fix.innovation[0] == np.float64(0.01)
    node = FORM.correct_position(FORM.first(), np.array([0.01, -0.02]))
    np.testing.assert_allclose(node.position_fix.innovation, [0.01, -0.02], rtol=1e-15)
    assert node.position_fix.used == 1
    refused = FORM.correct_position(node, np.array([1.0, 0.0])).position_fix
    assert (refused.used, refused.rejected, refused.rejected_in_a_row) == (1, 1, 1)


def test_predicted_position_includes_the_lever_arms():
    """What is predicted is the IMU's position and the lever arm, turned by the heading."""
    form = replace(FORM, arms=replace(FORM.arms, imu=np.array([0.1, 0.0]), aiding=np.array([0.3, 0.4])))
    node = replace(form.first(), x1=np.array([np.pi / 2, 0.0]), P1=np.zeros((2, 2)))
    z = np.array([0.5, 0.25])
    node = replace(node, x2=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    told = jax.jit(lambda node, z: form.correct_position(node, z).position_fix)(node, z)
    np.testing.assert_allclose(told.innovation, z - np.array([1.0 - 0.4, 0.2]), atol=1e-15)


@pytest.mark.thorough
def test_nees_over_500_seeds_is_within_the_95_percent_bounds():
    nees, _, _ = monte_carlo(FORM, turn(ticks(250)), n=250, every=15, reads=True, runs=500)
    verdict = nees_verdict(np.asarray(nees), 8)
    assert verdict.verdict == CONSISTENT, verdict


@pytest.mark.thorough
def test_step_lowers_to_generated_c():
    form = to_arrays(AidedInertialDirect())
    state, now = form.init(key(0)), np.int64(TICK)
    one = np.ones(1, bool)
    t = np.full(1, TICK)
    stacked = frames(form, t, (t, np.zeros((1, 3)), one), (t, np.zeros((1, 1)), one), (t, np.zeros((1, 2)), one))
    frame = jax.tree.map(lambda a: a[0], stacked)
    assert lower_function(lambda f, s, x: f.step(now, s, x), (form, state, frame)).text("f")

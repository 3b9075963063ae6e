"""Heading from positions alone: Jacobian of the process, consistency, and behaviour at rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, TICK, frames, monte_carlo, rest, ticks, weave
from scipy.linalg import expm

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.estimators.inertial.coupled import AidedInertialCoupled, coupled_process_noise, coupled_transition
from trimtab.estimators.inertial.mechanisation import LeverArms
from trimtab.logs.consistency import CONSISTENT, OPTIMISTIC, nees_verdict

FORM = to_arrays(AidedInertialCoupled(noise=MEMS, start=NEAR))
HERTZ = 153
"""Ticks between positions, near 1 s."""


def test_transition_matches_matrix_exponential():
    c, s = np.cos(0.7), np.sin(0.7)
    B, f = np.array([[c, -s], [s, c]]), np.array([1.5, -0.4])
    A = np.zeros((8, 8))
    A[0, 5] = 1
    A[1:3, 0] = [-(B @ f)[1], (B @ f)[0]]
    A[1:3, 6:], A[3:5, 1:3] = B, np.eye(2)
    np.testing.assert_allclose(jax.jit(coupled_transition)(0.3, 0.7, f), expm(0.3 * A), atol=1e-14)


@pytest.mark.thorough
def test_transition_is_the_jacobian_of_the_process():
    """To the order of what a step turns; errors of biases are true minus estimated."""
    imu_reading = np.array([0.4, 1.5, -0.4])
    form = replace(FORM, smoothing=np.float64(0.0))
    node = replace(form.first(), x=np.random.default_rng(0).standard_normal(8), imu_reading=imu_reading)
    F = jax.jacfwd(lambda x: form.propagate(replace(node, x=x), DT, imu_reading, jnp.zeros(2)).x)(node.x)
    signs = np.diag([1.0, 1, 1, 1, 1, -1, -1, -1])
    want = coupled_transition(DT, node.x[0], imu_reading[1:] - node.x[6:])
    np.testing.assert_allclose(signs @ F @ signs, want, atol=3 * DT**2)


def test_process_noise_equals_that_of_the_dual_filters():
    Q = np.asarray(jax.jit(coupled_process_noise)(np.array([9.0, 8, 1, 1, 3, 4]), 0.3, 0.0))
    np.testing.assert_allclose(Q, np.diag([9.0, 1, 1, 0, 0, 8, 3, 4]), atol=1e-14)


@pytest.mark.thorough
def test_lever_arm_makes_heading_observable():
    """The aided point 1 m ahead: its lateral position measures the heading."""
    form = replace(FORM, arms=LeverArms(aiding=np.array([1.0, 0.0])), rest_sigmas=np.float64(0.0))
    node = form.correct_position(form.first(), np.array([1.0, 0.02]))
    slopes = jax.jacfwd(lambda p: jnp.stack([jnp.cos(p), jnp.sin(p)]))(0.0)
    s = 0.0237**2 + 5.6e-4 + 0.02**2 * float(slopes[1]) ** 2
    assert node.x[0] == pytest.approx(0.02**2 / s * 0.02, rel=1e-9)


@pytest.mark.thorough
def test_nees_over_500_seeds_is_within_the_95_percent_bounds():
    """Positions only, 10 Hz, an accelerating vehicle; on its own model."""
    nees, _, _ = monte_carlo(FORM, weave(ticks(300)), n=300, every=15, reads=False, runs=500)
    verdict = nees_verdict(np.asarray(nees), 8)
    assert verdict.verdict == CONSISTENT, verdict


@pytest.fixture(scope="module")
def accelerating():
    n = int(24 / DT)
    return monte_carlo(FORM, weave(ticks(n)), n=n, every=HERTZ, reads=False, runs=60, keep=50)


@pytest.mark.thorough
def test_heading_is_estimated_from_positions_at_one_hertz(accelerating):
    """Heading 0.64 deg rms, NEES 7.1 of 8 from a 0.02 rad start error, on its own trajectory."""
    nees, flown, _ = accelerating
    error = np.asarray(flown.error)[:, :, 0]
    late = np.rad2deg(np.sqrt(np.mean(error[:, error.shape[1] // 2 :] ** 2)))
    assert 0.35 < late < 0.9
    assert np.asarray(nees)[:, error.shape[1] // 2 :].mean() == pytest.approx(8, abs=1.3)


@pytest.fixture(scope="module")
def resting():
    n = int(40 / DT)
    found = {}
    for how in ("consider", "correct"):
        form = replace(FORM, rest=how)
        found[how] = monte_carlo(form, rest(ticks(n)), n=n, every=HERTZ, reads=False, runs=40, keep=200)
    return found


@pytest.mark.thorough
def test_heading_drift_at_rest_is_covered_by_covariance(resting):
    """30 deg in 60 s. Correcting heading and gyro bias at rest is overconfident; considering them stays consistent."""
    own = {}
    for how, (_, flown, _) in resting.items():
        error, P = np.asarray(flown.error)[:, -1, 0], np.asarray(flown.P)[:, -1, 0, 0]
        own[how] = np.mean(error**2 / P)
    assert np.rad2deg(np.sqrt(np.asarray(resting["consider"][1].P)[:, -1, 0, 0].mean())) == pytest.approx(
        0.7 * 40, rel=0.05
    )
    assert own["consider"] < 1.6
    assert own["correct"] > 1.5 * own["consider"]
    assert nees_verdict(np.asarray(resting["consider"][0]), 8).verdict == CONSISTENT


@pytest.mark.thorough
def test_gate_patience_recovers_rejected_positions():
    """0.5 rad start error at 1 Hz: linearisation throws some runs off so far that all positions are refused."""
    n = int(24 / DT)
    lost = []
    for patience in (0, 3):
        intake = replace(FORM.intake, patience_position=np.int32(patience))
        form = replace(FORM, intake=intake, start=replace(FORM.start, sigma_heading=np.float64(0.5)))
        _, flown, _ = monte_carlo(form, weave(ticks(n)), n=n, every=HERTZ, reads=False, runs=60, keep=50)
        lost.append(int((np.abs(np.rad2deg(np.asarray(flown.error)[:, -1, 0])) > 10).sum()))
    assert lost[0] > 3
    assert lost[1] == 0


@pytest.mark.thorough
def test_large_initial_heading_error_makes_filter_optimistic():
    """NEES 11 from 0.5 rad, linearisation."""
    n = int(24 / DT)
    form = replace(FORM, start=replace(FORM.start, sigma_heading=np.float64(0.5)))
    nees, _, _ = monte_carlo(form, weave(ticks(n)), n=n, every=HERTZ, reads=False, runs=100, keep=50)
    verdict = nees_verdict(np.asarray(nees)[:, 3:], 8)
    assert verdict.verdict == OPTIMISTIC
    assert verdict.mean > 9


@pytest.mark.thorough
def test_nees_over_500_seeds_is_consistent_for_40_s():
    n = int(40 / DT)
    nees, _, _ = monte_carlo(FORM, weave(ticks(n)), n=n, every=15, reads=False, runs=500, keep=100)
    assert nees_verdict(np.asarray(nees), 8).verdict == CONSISTENT


@pytest.mark.thorough
def test_step_lowers_to_generated_c():
    form = to_arrays(AidedInertialCoupled())
    state, now = form.init(key(0)), np.int64(TICK)
    one = np.ones(1, bool)
    t = np.full(1, TICK)
    stacked = frames(form, t, (t, np.zeros((1, 3)), one), (t, np.zeros((1, 1)), one), (t, np.zeros((1, 2)), one))
    frame = jax.tree.map(lambda a: a[0], stacked)
    assert lower_function(lambda f, s, x: f.step(now, s, x), (form, state, frame)).text("f")

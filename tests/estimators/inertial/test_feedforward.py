"""The thesis's INS: its numbers with the printed covariance and with the mended one, and its consistency."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from estimators.flights import DT, MEMS, NEAR, QUICK, Truth, draws, monte_carlo, own_model, ticks, turn, weave

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.feedforward import AidedInertialFeedforward
from trimtab.logs.consistency import CONSISTENT, OPTIMISTIC, PESSIMISTIC, nees_verdict, nis_verdict, whiteness

N = 1500
RUNS = 12


@pytest.fixture(scope="module")
def turning():
    """Heading errors (deg) and NIS of both covariances on a platform at 166 deg/s; the gyro's bias is constant."""
    truth = turn(ticks(N))
    sensors = to_arrays(InertialNoise(gyro_walk=0.0))
    found = {}
    for covariance in ("literal", "consistent"):
        form = to_arrays(AidedInertialFeedforward(noise=InertialNoise(covariance=covariance)))
        form = replace(form, start=replace(form.start, sigma_heading=0.0126, sigma_gyro_bias=0.02))

        def run(k, form=form):
            flown = own_model(form, truth, draws(k, N), every=15, sensors=sensors)
            return flown.error[:, 0], flown.heading_nis, flown.heading_innovation

        out = jax.jit(jax.vmap(run), compiler_options=QUICK)(jnp.arange(RUNS))
        found[covariance] = [np.asarray(a)[:, 300:] for a in out]
    return found


@pytest.mark.thorough
@pytest.mark.parametrize(("covariance", "heading", "nis"), [("literal", 0.58, 0.34), ("consistent", 0.13, 0.98)])
def test_heading_error_and_nis_match_for_both_covariances(turning, covariance, heading, nis):
    """Heading 0.58 deg and NIS 0.34 as printed, 0.13 deg and 0.98 with the unit error mended."""
    error, told, _ = turning[covariance]
    assert np.rad2deg(np.sqrt(np.mean(error**2))) == pytest.approx(heading, rel=0.08)
    assert told.mean() == pytest.approx(nis, abs=0.02)


@pytest.mark.thorough
def test_magnetometer_heading_error_matches_table_6_7(turning):
    """Magnetometer: 0.45 to 0.70 deg, with the printed covariance ([1] table 6.7)."""
    error = turning["literal"][0]
    assert 0.45 <= np.rad2deg(np.sqrt(np.mean(error**2))) <= 0.70


@pytest.mark.thorough
def test_consistency_verdict_separates_published_and_corrected_covariance(turning):
    assert nis_verdict(turning["literal"][1], 1).verdict == PESSIMISTIC
    assert not whiteness(turning["literal"][2][0]).white
    mended = nis_verdict(turning["consistent"][1], 1)
    assert mended.mean == pytest.approx(1.0, abs=0.03)
    assert mended.verdict != OPTIMISTIC


@pytest.mark.thorough
def test_nees_over_500_seeds_is_within_the_95_percent_bounds():
    """On its own model: turning without force, so that heading errors do nothing to velocity."""
    form = to_arrays(AidedInertialFeedforward(noise=MEMS, start=NEAR))
    nees, _, nis = monte_carlo(form, turn(ticks(250)), n=250, every=15, reads=True, runs=500)
    verdict = nees_verdict(np.asarray(nees), 8)
    assert verdict.verdict == CONSISTENT, verdict
    assert verdict.inside >= 0.8
    assert nis_verdict(np.asarray(nis), 2).verdict == CONSISTENT


@pytest.mark.thorough
@pytest.mark.parametrize("form", ["feedforward", "feedback", "direct"])
def test_nees_of_each_dual_form_is_consistent_for_30_s(form):
    from trimtab.estimators.inertial.direct import AidedInertialDirect
    from trimtab.estimators.inertial.feedback import AidedInertialFeedback

    cls = {"feedforward": AidedInertialFeedforward, "feedback": AidedInertialFeedback, "direct": AidedInertialDirect}
    n = int(30 / DT)
    nees, _, nis = monte_carlo(
        to_arrays(cls[form](noise=MEMS, start=NEAR)), turn(ticks(n)), n=n, every=15, reads=True, runs=500, keep=100
    )
    assert nees_verdict(np.asarray(nees), 8).verdict == CONSISTENT
    assert nis_verdict(np.asarray(nis), 2).verdict == CONSISTENT


@pytest.mark.thorough
def test_feedforward_never_resets_the_ins():
    """Without noise or aiding errors the INS drifts with its biases while the output does not."""
    form = to_arrays(AidedInertialFeedforward(noise=MEMS, start=NEAR))
    truth = weave(ticks(600))
    bias = np.array([0.01, 0.1, -0.1])

    def step(node, row):
        imu_reading, phi, r = row
        node = form.propagate(node, DT, imu_reading, jnp.zeros(2))
        node = form.correct_position(form.correct_heading(node, phi), r)
        return node, (node.heading, node.position, form.belief(node).x)

    first = replace(
        form.first(),
        imu_reading=truth.imu_reading[0] + bias,
        heading=truth.heading[0],
        velocity=truth.velocity[0],
        position=truth.position[0],
    )
    rows = Truth(truth.imu_reading + bias, truth.heading, truth.velocity, truth.position)
    rows = tuple(jnp.asarray(a)[1:] for a in (rows.imu_reading, rows.heading, rows.position))
    run = jax.jit(lambda first: jax.lax.scan(step, jax.tree.map(jnp.asarray, first), rows)[1], compiler_options=QUICK)
    heading, position, x = run(first)
    assert heading[-1] - truth.heading[-1] == pytest.approx(0.01 * 599 * DT, rel=1e-3)
    assert np.linalg.norm(position[-1] - truth.position[-1]) > 0.3
    np.testing.assert_allclose(x[-1, 3:5], truth.position[-1], atol=0.01)
    np.testing.assert_allclose(x[-1, 0], truth.heading[-1], atol=1e-3)


@pytest.mark.thorough
def test_filter_functions_lower_to_generated_c():
    form = to_arrays(AidedInertialFeedforward())
    node = form.first()
    assert lower_function(lambda f, n: f.propagate(n, np.float64(DT), np.zeros(3), np.zeros(2)), (form, node)).text("f")
    assert lower_function(lambda f, n: f.correct_heading(n, np.float64(0.1)), (form, node)).text("f")
    assert lower_function(lambda f, n: f.correct_position(n, np.zeros(2)), (form, node)).text("f")

"""The bounded internal states of the hypersonic vehicle along the large climb: values, ends, residual, errors.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import jax
import numpy as np
import pytest
from laws.climb_reference import CLIMB, CRAFT, DT, H0, SCALES, V0, linear, noncausal

from trimtab.core.errors import InputError
from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.design.stable_inversion import bounded_residual
from trimtab.laws.path_command import FilteredClimb
from trimtab.laws.path_inversion import internal_rates
from trimtab.scenarios.hypersonic._internal import internal_linear, level_trim, noncausal_table
from trimtab.vehicles.hypersonic_aerodynamics import FlexibleModes

DEG = np.pi / 180


def test_level_trim_matches_reference_values():
    """Oracle, trim, for the search used here."""
    at = level_trim(CRAFT, H0, V0)
    got = [at.zeta[0] / DEG, at.u.Phi, at.u.delta_e / DEG, at.zeta[2], at.zeta[4]]
    np.testing.assert_allclose(got, [1.596784, 0.264449, 12.427146, 0.903851, 0.755137], rtol=1e-5)


def test_internal_linearisation_matches_reference_rows():
    """The oracle's rows of A and B for alpha and Q."""
    linear = internal_linear(CRAFT, level_trim(CRAFT, H0, V0))
    A = np.concatenate([linear.A21, linear.A22], axis=1)
    np.testing.assert_allclose(A[0], np.eye(9)[4], atol=1e-9)
    np.testing.assert_allclose(linear.B2[:2], [[-1.29835e-4, 0], [-4.261384e-3, 4.119672e-3]], rtol=1e-5, atol=1e-9)
    Q = [-6.295672e-6, 1.687744e-5, 3.491600e-5, 7.075971, 0, -0.05939869, -1.439968e-4, -0.2099934, -4.199867e-4]
    np.testing.assert_allclose(A[1], Q, rtol=1e-6, atol=1e-12)


@pytest.mark.thorough
def test_noncausal_solution_matches_reference_values():
    """[1] eq. 7: at 30 s of +5000 ft, +1000 ft/s, the oracle's, to its digits."""
    table, report, _ = noncausal()
    at = CLIMB.at(30.0)
    np.testing.assert_allclose([at.h, at.V], [85328.212272, 7893.233969], atol=5e-7)
    wanted = [0.0220153134, -9.409e-6, 0.804015540, -4.8789e-3, 0.855558791, -5.949e-4]
    digits = [5e-11, 5e-10, 5e-10, 5e-8, 5e-10, 5e-8]
    assert (np.abs(report.solution.zeta[round(30 / DT)] - wanted) <= digits).all()
    assert (np.abs(np.asarray(table.at(30.0)) - wanted) <= digits).all()


@pytest.mark.thorough
def test_noncausal_solution_has_small_residual_and_trim_ends():
    """[1] eq. 7: below 1e-5 per unit scale, and 4e-6 in each component; ends are the trims."""
    _, report, _ = noncausal()
    assert report.residual < 1e-5
    assert np.abs(bounded_residual(report.solution, DT)).max() < 4e-6
    assert report.left < 1e-9
    start = level_trim(CRAFT, H0, V0).zeta
    np.testing.assert_allclose(report.solution.zeta[0] / SCALES, start / SCALES, atol=1e-9)


@pytest.mark.thorough
def test_right_end_is_the_trim_after_the_climb():
    """A small quick climb, whose command has reached its end."""
    table, report = noncausal_table(CRAFT, FilteredClimb(dh=200.0, dV=40.0, wh=0.25, wV=0.25), 150.0, dt=0.01)
    assert report.right < 1e-8
    end = level_trim(CRAFT, H0 + 200, V0 + 40).zeta
    np.testing.assert_allclose(table.nodes[-1] / SCALES, end / SCALES, atol=1e-8)


@pytest.mark.thorough
def test_iteration_changes_shrink_tenfold():
    """[1] eq. 7: 5 to 7 iterations, the first of 3e-2, each at least ten times smaller than the one before."""
    changes = np.array(noncausal()[1].solution.changes)
    assert 5 <= len(changes) <= 7
    np.testing.assert_allclose(changes[0], 3.25e-2, rtol=0.01)
    assert (changes[1:] < changes[:-1] / 10).all()
    assert changes[-1] < 1e-10


def test_noncausal_solution_moves_before_the_command():
    """Noncausal: alpha moves before the step and grows as e^(3.289 t)."""
    zeta = noncausal()[1].solution.zeta
    early = np.abs(zeta[[800, 850, 900, 950], 0] - zeta[0, 0])
    assert CLIMB.at(4.99).h == H0
    np.testing.assert_allclose(np.log(early[1:] / early[:-1]) / 0.25, 3.2894, rtol=1e-3)


@pytest.mark.thorough
def test_forward_integration_diverges_at_the_unstable_rate():
    """[1] eqs. 4-8: the exact internal dynamics integrated forward from the exact start leave at e^(3.289 t)."""
    report = noncausal()[1]
    wanted = CLIMB.at(DT / 2 * np.arange(4001))

    def psi(i, zeta):
        p = jax.tree.map(lambda a: a[i], wanted)
        return jax.numpy.stack(internal_rates(CRAFT, p.h, p.h_rate, p.V, p.h_acceleration, p.V_rate, zeta))

    def step(zeta, k):
        a = psi(2 * k, zeta)
        b = psi(2 * k + 1, zeta + DT / 2 * a)
        c = psi(2 * k + 1, zeta + DT / 2 * b)
        d = psi(2 * k + 2, zeta + DT * c)
        new = zeta + DT / 6 * (a + 2 * b + 2 * c + d)
        return new, new

    start = jax.numpy.asarray(level_trim(CRAFT, H0, V0).zeta)
    forward = jax.jit(lambda z: jax.lax.scan(step, z, np.arange(2000))[1], compiler_options=FAST_COMPILE_OPTIONS)(start)
    off = np.abs(np.asarray(forward)[:, 0] - report.solution.zeta[1:2001, 0])
    assert off[1000] > 5e-7  # at the step: the start that the past would have had to prepare
    assert off[1400] > 2e-4
    np.testing.assert_allclose(np.log(off[1300] / off[1100]), 3.2894, rtol=0.02)
    gone = off[1900] > 0.1 or not np.isfinite(off[1900])
    assert gone


@pytest.mark.thorough
def test_table_nodes_interpolate_the_solution_accurately():
    """Largest error between nodes, in scales: 2.7e-7, a tenth of it in alpha; half the spacing: a sixteenth."""
    _, report, _ = noncausal()
    assert report.interpolation.max() < 3e-7
    assert report.interpolation[0] < 1e-8
    quick = FilteredClimb(dh=1000.0, dV=200.0)
    coarse, fine = (noncausal_table(CRAFT, quick, 20.0, keep=k)[1].interpolation.max() for k in (0.1, 0.05))
    assert 10 < coarse / fine < 22


def test_linear_solution_differs_from_exact_for_large_climb():
    """[1] eq. 7: about the trim."""
    big = np.abs(noncausal()[1].solution.zeta - linear()[1].solution.zeta) / SCALES
    assert 0.03 < big[:, 0].max() < 0.08
    assert len(linear()[1].solution.changes) == 2
    assert linear()[1].residual < 1e-5


@pytest.mark.thorough
def test_other_coupling_readings_give_bounded_solutions():
    for kmode in ("paper", "author"):
        craft = replace(CRAFT, modes=FlexibleModes(kmode=kmode))
        _, report = noncausal_table(craft, FilteredClimb(dh=500.0, dV=50.0), 12.0)
        assert report.residual < 1e-5
        assert report.solution.unstable == 1


@pytest.mark.parametrize(
    ("climb", "settings", "text"),
    [
        (CLIMB, {"beyond": 1.0}, "extends only 1 s beyond the table"),
        (CLIMB, {"beyond": 0.0}, "too short for the unstable mode"),
        (CLIMB, {"keep": 0.0123}, "0.0123 s between nodes, and a step of 0.005 s"),
        (CLIMB, {"dt": 0.0}, "a step of 0 s"),
        (CLIMB, {"seconds": 0.0}, "a duration of 0 s"),
        (FilteredClimb(dh=1000.0, start=-20.0), {}, "not level"),
        (FilteredClimb(V0=3000.0), {}, "level trim at 85000 ft, 3000 ft/s: no trim was found"),
    ],
)
def test_rejects_invalid_table_inputs(climb, settings, text):
    with pytest.raises(InputError, match=text):
        noncausal_table(CRAFT, climb, **{"seconds": 10.0, **settings})


@pytest.mark.thorough
def test_rejects_a_climb_without_a_final_trim():
    """At the end of a long table the speed is too low for level flight; the error names the bounds."""
    slowing = FilteredClimb(dV=-4500.0, wV=2.0)
    with pytest.raises(InputError, match=r"3202.08 ft/s: no trim was found: not satisfied: .*; at a bound: .*delta_e"):
        noncausal_table(CRAFT, slowing, 20.0)

"""Gain, filter and certificate of the hypersonic vehicle.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design import composite
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.certificate_file import certificate_json, parse_certificate
from trimtab.design.lqr import kalman_bucy
from trimtab.design.observability import constant_rank
from trimtab.estimators.flexible.model import modal_dynamics
from trimtab.laws.path_inversion import invert_path
from trimtab.laws.stable_inversion import K_FLOWN
from trimtab.scenarios.hypersonic import _certified_loop
from trimtab.scenarios.hypersonic import _design as hypersonic
from trimtab.scenarios.hypersonic.mismatch import off_nominal_plant
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicState

D, SMALL = hypersonic.SCALE, 1e-5 * np.eye(4)


@pytest.fixture(scope="module")
def linear():
    return hypersonic.error_model()[0]


def feedback(linear, strict=1.0, method="lqr"):
    found = hypersonic.feedback_gain(linear, method=method, strict=strict)
    Qe, Re, _ = hypersonic.weights()
    return composite.Feedback(linear.A, linear.B, found.K, found.P, Qe, np.linalg.inv(Re))


def observer(linear, density):
    A, C = linear.A[5:, 5:], linear.A[4:5, 5:]
    found = kalman_bucy(A, C, SMALL, density)
    return composite.Observer(A, C, SMALL, found.P, found.L, np.array([[1 / density]]), np.arange(5, 9))


@pytest.mark.thorough
def test_exact_linearisation_matches_reference_matrices(linear):
    """[1] eqs. 4-8: A[4,:] = e_Q, B[4,:] = [-1/V, 0] to 1e-9, and the printed rows."""
    assert linear.states == ("h", "h'", "V", "alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
    assert linear.inputs == ("h''", "V'")
    np.testing.assert_allclose(linear.A[3], np.eye(9)[4], atol=1e-9)
    np.testing.assert_allclose(linear.B[3], [-1 / 7702.0808, 0], atol=1e-9)
    Q = [-6.295672e-6, 1.687744e-5, 3.491600e-5, 7.075971, 0, -0.05939869, -1.439968e-4, -0.2099934, -4.199867e-4]
    one = [8.613738e-4, -2.309172e-3, -4.777208e-3, 3683.672, 0, -264.1231, -0.6402984, 28.73129, 0.05746259]
    two = [0.02311599, -7.183074e-3, -0.1282020, -7393.370, 0, 19.55524, 0.04740663, -330.8660, -0.6617320]
    np.testing.assert_allclose(linear.A[[4, 6, 8]], [Q, one, two], rtol=1e-6, atol=1e-12)
    rows = [[-4.261384e-3, 4.119672e-3], [0.5830425, -0.5636536], [15.64664, -1.753341]]
    np.testing.assert_allclose(linear.B[[4, 6, 8]], rows, rtol=1e-6)


@pytest.mark.thorough
def test_feedback_gain_matches_the_reference(linear):
    """The oracle's gain and poles; and that feedback of the estimated modes is required."""
    K = [
        [0.0893010, 0.688045, -0.355907, 1742.964, 536.101, -0.581358, -0.140480, -1.351494, -0.363934],
        [-0.0184104, -0.132192, -0.465382, -168.6866, -51.9745, 0.0504659, 0.0135084, 0.129350, 0.0334523],
    ]
    found = hypersonic.feedback_gain(linear, strict=1.0)
    np.testing.assert_allclose(found.K, K, rtol=4e-6)  # half a unit of the shortest printed entry
    want = [-3.9716, -2.8106, -0.4996, -0.4262, -0.2266, -0.5200 + 18.509j, -0.3361 + 16.031j]
    for p in want:
        assert np.abs(found.poles - p).min() < 8e-5 + 5e-4 * (np.imag(p) != 0)
    blind = found.K.copy()
    blind[:, 5:] = 0
    assert np.linalg.eigvals(linear.A + linear.B @ blind).real.max() == pytest.approx(2.05, abs=5e-3)


@pytest.mark.thorough
def test_robust_term_of_either_sign_shifts_the_poles(linear):
    """[1] eqs. 16-18: the published u_h makes K/2 of K, the minus sign 1.5 K."""
    K = hypersonic.feedback_gain(linear, strict=1.0).K
    for factor, rightmost in ((0.5, -0.125), (1.5, -0.236)):
        poles = np.linalg.eigvals(linear.A + factor * linear.B @ K)
        assert poles.real.max() == pytest.approx(rightmost, abs=5e-4)


@pytest.mark.thorough
def test_integral_gain_matches_the_hamiltonian_solution(linear):
    """[1] eq. 13, 11 states: against P from the stable subspace of the scaled Hamiltonian matrix."""
    A, B = hypersonic.error_matrices(linear, integral=True)
    Qe, Re, d = hypersonic.weights(integral=True)
    np.testing.assert_array_equal(A[9:], np.eye(11)[[0, 2]])
    np.testing.assert_allclose(np.diag(Qe)[9:], [1 / 1000**2, 1 / 100**2])
    As, Bs = A * d / d[:, None], B / d[:, None]
    H = np.block([[As, -Bs @ np.linalg.inv(Re) @ Bs.T], [-Qe * np.outer(d, d), -As.T]])
    values, vectors = np.linalg.eig(H)
    stable = vectors[:, values.real < 0]
    P = np.real(stable[11:] @ np.linalg.inv(stable[:11]))
    found = hypersonic.feedback_gain(linear, integral=True, strict=1.0)
    np.testing.assert_allclose(found.K * d, -np.linalg.inv(Re) @ Bs.T @ P, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.sort(found.poles.real), np.sort(values.real[values.real < 0]), rtol=1e-6)


def test_composite_inequality_holds_with_the_chosen_weight(linear):
    """[1] eqs. 14, 15: LQR leaves Q_e - Q to 1e-9 scaled; strict with Q = 1.01 Q_e; z for a weight."""
    Qe, _, _ = hypersonic.weights()
    for strict in (1.0, 1.01):
        left = -composite.inequality_matrix(feedback(linear, strict))
        np.testing.assert_allclose((left - (Qe - strict * Qe)) * np.outer(D, D), 0, atol=1e-9)
    f, o = feedback(linear, 1.01), observer(linear, 10.0)
    allowed = np.sqrt(np.diag(Qe))
    assert np.linalg.eigvalsh(composite.inequality_matrix(f) / np.outer(allowed, allowed))[0] == pytest.approx(
        0.01, rel=1e-6
    )
    size = np.sqrt(np.diag(composite.weighted_matrix(f, o, 4.3)))
    assert np.linalg.eigvalsh(composite.weighted_matrix(f, o, 4.3) / np.outer(size, size))[0] > 0


def test_least_weights_match_reference_values(linear):
    """[1] eqs. 14, 15: lambda* for R_c = 10 and 5e-7, with the reference gain and with Q = 1.01 Q_e; weight 1 fails."""
    for strict, density, want in ((1, 10.0, 4.22), (1, 5e-7, 2.78), (1.01, 10.0, 4.25), (1.01, 5e-7, 2.80)):
        f, o = feedback(linear, strict), observer(linear, density)
        assert composite.least_weight(f, o) == pytest.approx(want, abs=5e-3)
        size = np.sqrt(np.diag(composite.weighted_matrix(f, o, 1.0)))
        for weight, holds in ((1.0, False), (1.01 * want, True)):
            z = composite.weighted_matrix(f, o, weight) / np.outer(size, size)
            assert (np.linalg.eigvalsh(z)[0] > 0) == holds


def test_least_decrease_weights_depend_on_the_robust_term(linear):
    """lambda*/2 is exact with the published u_h; 2 lambda* and 4.5 lambda* suffice without and with minus."""
    f, o = feedback(linear), observer(linear, 10.0)
    least = composite.least_weight(f, o)
    assert composite.least_decrease_weight(f, o, 0.5) == pytest.approx(least / 2, rel=1e-6)
    assert composite.least_decrease_weight(f, o, 0.0) < 2 * least
    assert composite.least_decrease_weight(f, o, -0.5) < 4.5 * least


def test_printed_inequality_holds_where_unit_weight_fails(linear):
    """[1] eqs. 14, 15: the printed (15) on the flexible block is satisfied, so it proves nothing.

    Its largest eigenvalues: -1.17e-3 and -1.75e-3 with these two filters.
    """
    f = feedback(linear)
    got = [np.linalg.eigvalsh(composite.printed_inequality(f, observer(linear, r)))[-1] for r in (10.0, 5e-7)]
    np.testing.assert_allclose(got, [-1.168e-3, -1.747e-3], rtol=1e-3)
    assert got[1] < -1.4e-3 < got[0]


@pytest.mark.thorough
def test_modal_error_block_matches_the_dynamics_and_is_observable(linear):
    """[1] eq. 9: A_eta, C, poles, rank 4."""
    system = hypersonic.certified_system()
    A, C = system.A_eta, system.C
    wanted = [np.asarray(M) for M in modal_dynamics(Hypersonic())]
    np.testing.assert_allclose(A, wanted[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(C[0], wanted[1], rtol=1e-9)
    assert constant_rank(A, C).rank == 4


@pytest.mark.thorough
@pytest.mark.parametrize(
    "settings", [{}, {"method": "lmi", "filter": "accurate", "mode_error": 0.0}, {"integral": "true"}]
)
def test_certificates_are_proved_exactly(settings):
    """[1] eqs. 14, 15 by exact arithmetic from the file; 4 and 5 are recomputed."""
    text = certificate_json(hypersonic.certificate(**settings))
    certificate, written = parse_certificate(text, "file")
    proof = prove_certificate(certificate, hypersonic.certified_system(**settings), written)
    assert proof.holds, [c for c in proof.conditions if not c.holds]
    numbers = {c.name: c for c in proof.conditions}
    assert numbers["A + B K Hurwitz"].how == numbers["P > 0"].how == "exact, leading minors"
    if settings.get("method") == "lmi":
        assert 1e-9 < numbers["(14)"].number < 1e-6  # far less than in X, Y: floats could not tell it from nothing
    else:
        assert numbers["(14)"].number == pytest.approx(0.0099, rel=1e-3)


@pytest.mark.thorough
def test_integer_and_float_flight_conditions_give_equal_certificates():
    """h_ft=90000 as an integer of Python or JSON, not 90000.0."""
    whole, real = ({"filter": "none", "h_ft": h, "V_ft_per_s": V} for h, V in ((90_000, 8_000), (90e3, 8e3)))
    certificate = hypersonic.certificate(**whole)
    assert np.array_equal(certificate.K, hypersonic.certificate(**real).K)
    back, written = parse_certificate(certificate_json(certificate), "file")
    for settings in (whole, real):
        proof = prove_certificate(back, hypersonic.certified_system(**settings), written)
        assert proof.holds, [c for c in proof.conditions if not c.holds]
    elsewhere = prove_certificate(back, hypersonic.certified_system(**whole | {"h_ft": 85_000}), written)
    assert not elsewhere.holds


@pytest.mark.thorough
def test_weight_below_the_least_is_not_proved(linear):
    """[1] eq. 15, with the filter as printed."""
    made = hypersonic.certificate(filter="printed")
    o = made.observer
    assert o.weight == pytest.approx(1.01 * o.least_weight, rel=1e-12)
    less = made._replace(observer=o._replace(weight=float(Fraction(99, 100) * Fraction(o.least_weight))))
    proof = prove_certificate(less, hypersonic.certified_system(filter="printed"))
    broken = [c for c in proof.conditions if not c.holds]
    assert any(c.name.startswith("(15)") and c.number < 0 for c in broken)


@pytest.mark.thorough
def test_uncertainty_bounds_over_the_envelope_match_analysis(linear, monkeypatch):
    """kappa_G is 1/0.98 - 1 for mass alone; without parameter errors all bounds vanish."""
    K = hypersonic.feedback_gain(linear).K
    nominal = hypersonic.envelope_numbers(Hypersonic(), K, 0.0)
    assert nominal["kappa_G"].value < 1e-15  # no parameter error
    assert nominal["rho0 (ft/s^2)"].value < 1e-13
    assert nominal["rho1 (ft/s^2)"].value < 1e-13
    for module in (hypersonic, _certified_loop):
        monkeypatch.setattr(module, "UNCERTAINTY", {"m": 0.02})
    kappa = hypersonic.envelope_numbers(Hypersonic(), K, 1.0)["kappa_G"]
    assert kappa.value == pytest.approx(1 / 0.98 - 1, rel=1e-9)
    assert (kappa.low, kappa.high) == (0.0, 1.0)


@pytest.mark.thorough
def test_uncertainty_bounds_hold_and_are_tight_for_random_plants(linear):
    """|M_F| <= rho0 + rho1 |e/scale| at random points, errors and plants of the box; the scenario's own plant too."""
    K, craft, rng = hypersonic.feedback_gain(linear).K, Hypersonic(), np.random.default_rng(0)
    numbers = hypersonic.envelope_numbers(craft, K, 1.0)
    rho0, rho1 = (numbers[f"{name} (ft/s^2)"].value for name in ("rho0", "rho1"))
    step = jax.jit(left_by_inversion)
    most = 0.0
    for _ in range(200):
        plant = hypersonic.uncertain_plant(craft, rng.choice([-1.0, 1.0], 5) * rng.uniform(0.9, 1.0))
        h, V, alpha, gamma, _ = hypersonic.GRID[rng.integers(len(hypersonic.GRID))]
        e = rng.standard_normal(9) * D * 0.03
        left = step(plant, (h, V, alpha, gamma), rng.choice([-2.0, 2.0], 2) + K @ e)
        bound = rho0 + rho1 * np.linalg.norm(e / D)
        most = max(most, float(np.linalg.norm(left)) / bound)
        assert np.linalg.norm(left) <= bound
    assert most > 0.6  # they are no idle bounds


def left_by_inversion(plant, at, v):
    """Return the difference of the plant's (h'', V') from v, which the law demands of its assumed vehicle."""
    h, V, alpha, gamma = at
    u = invert_path(Hypersonic(), h, V * jnp.sin(gamma), V, alpha, v[0], v[1]).u
    x = HypersonicState(h, V, alpha, alpha + gamma, 0.0, 0.0, 0.0, 0.0, 0.0)
    return hypersonic.accelerations(plant, x, jnp.stack([u.Phi, u.delta_e])) - v


def test_scenario_plant_is_a_corner_of_the_uncertainty_box():
    flown, corner = off_nominal_plant(), hypersonic.uncertain_plant(Hypersonic(), (1.0, 1.0, -1.0, 1.0, -1.0))
    np.testing.assert_allclose(jax.tree.leaves(corner), jax.tree.leaves(flown), rtol=1e-15)


@pytest.mark.thorough
def test_rejects_unknown_design_options(linear):
    with pytest.raises(InputError, match="'magic'"):
        hypersonic.feedback_gain(linear, method="magic")
    for name, value in {"method": "magic", "filter": "best", "integral": "yes", "kmode": "mine"}.items():
        with pytest.raises(InputError, match=f"'{value}'"):
            hypersonic.certificate(**{name: value})
    for name, value in {"h_ft": 79e3, "V_ft_per_s": 1e4, "uncertainty": 10.0}.items():
        with pytest.raises(InputError, match=name):
            hypersonic.certificate(**{name: value})


@pytest.mark.thorough
def test_certified_gain_equals_the_flown_gain():
    linear, _ = hypersonic.error_model()
    np.testing.assert_allclose(hypersonic.feedback_gain(linear).K, np.array(K_FLOWN), rtol=5e-6)
    np.testing.assert_allclose(np.array(hypersonic.certificate().K, float), np.array(K_FLOWN), rtol=5e-6)

"""The design tools on the hypersonic vehicle: trim, Lie derivatives, exact linearisation and internal dynamics.

[1] is Aerospace 2022, 9(4), 206, its equations corrected as docs/errata-hypersonic.md says; oracle: tests/oracles.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import FAST_COMPILE_OPTIONS, replace
from trimtab.design.lie import affine_fields, curved_inputs, extend_inputs, lie_derivative, relative_degree
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_vehicle
from trimtab.design.normal_form import normal_form
from trimtab.design.trim import trim
from trimtab.design.zero_dynamics import zero_dynamics
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState
from trimtab.vehicles.hypersonic_aerodynamics import FlexibleModes

H, V, DEG = 85000.0, 7702.0808, math.pi / 180
FREE = ("alpha", "theta", "eta1", "eta2", "Phi", "delta_e")
BOUNDS = {"Phi": (0.02, 1.5), "delta_e": (-20 * DEG, 25.8 * DEG), "alpha": (-0.1, 0.1), "theta": (-0.1, 0.1)}
INTERNAL = ("alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
RADIUS = {"h": 500.0, "V": 50.0, "alpha": 0.01, "theta": 0.01, "q": 0.01, "Phi": 0.05, "delta_e": 0.05}


def model_of(kmode="parker", **changes):
    vehicle = replace(Hypersonic(**changes), modes=FlexibleModes(kmode=kmode))
    x = HypersonicState(H, V, 0.03, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0)
    return model_of_vehicle(vehicle, x, HypersonicInput(0.2, 0.1), outputs=("h", "V"))


@pytest.fixture(scope="module")
def model():
    return model_of()


@pytest.fixture(scope="module")
def level(model):
    return trim(model, free=FREE, bounds=BOUNDS).require_trim()


@pytest.fixture(scope="module")
def form(model, level):
    return normal_form(model, level.x, level.u, internal=INTERNAL, radius=RADIUS)


def test_trim_matches_oracle(model, level):
    """Oracle, trim: to 1e-5 relative, residual below 1e-10."""
    x, u = model.state(level.x), model.input(level.u)
    got = [x.alpha / DEG, u.Phi, u.delta_e / DEG]
    np.testing.assert_allclose(got, [1.596784, 0.264449, 12.427146], rtol=1e-5)
    np.testing.assert_allclose([x.theta, x.eta1, x.eta2], [x.alpha, 0.903851, 0.755137], rtol=1e-5)
    assert np.abs(model.f(level.x, level.u)).max() < 1e-10


@pytest.mark.thorough
def test_trim_depends_on_gravity_but_not_on_kmode(level):
    """Oracle, trim."""
    for kmode in ("paper", "author"):
        found = trim(model_of(kmode), free=FREE, bounds=BOUNDS).require_trim()
        np.testing.assert_allclose([*found.x, *found.u], [*level.x, *level.u], rtol=1e-9, atol=1e-12)
    heavy = trim(model_of(g=32.174), free=FREE, bounds=BOUNDS).require_trim()
    np.testing.assert_allclose(
        [heavy.x[2] / DEG, heavy.u[0], heavy.u[1] / DEG], [1.644566, 0.268090, 12.539973], rtol=1e-5
    )


def test_missing_trim_reports_the_reasons(model):
    """Too slow to fly level: the elevator ends at its bound, and lift is missing."""
    found = trim(model, x={"V": 3000.0}, free=FREE, bounds=BOUNDS)
    assert not found.is_found
    assert set(found.active) & {"alpha", "theta", "delta_e", "Phi"}
    assert "not satisfied: " in found.why[0]
    assert "at a bound: " in found.why[1]


@pytest.mark.thorough
def test_lie_derivatives_match_published_equations(model, level):
    """[1] eqs. 4-8, off the trim, for the field expanded about the actual elevator: f = x'(u) - g u, g = dx'/du."""
    x = jnp.asarray(model.point({"theta": 0.05, "alpha": 0.03, "q": 0.01})[0])
    u = np.array([0.3, 0.2])
    f, g = affine_fields(model, u)
    V, a, th = (float(x[i]) for i in (1, 2, 3))
    gam, qS, m, grav = th - a, 6.7429e-5 * V**2 / 2 * 17, 300.0, 1.39e16 / 20988500.0**2
    TP = -3.7693e5 * a**3 + 2.6814e4 * a**2 + 3.5542e4 * a + 6.3785e3
    T0 = -3.7225e4 * a**3 - 1.7277e4 * a**2 - 2.4216e3 * a - 1.0090e2
    slope = 2 * 0.81993 * u[1] + 2.7699e-4
    D0 = qS * (5.8224 * a**2 - 0.045315 * a + 0.010131 - 0.81993 * u[1] ** 2)  # the tangent's share of drag
    L0 = qS * (4.6773 * a - 0.018714)
    f2 = (T0 * math.cos(a) - D0) / m - grav * math.sin(gam)
    Lf2h = math.sin(gam) * f2 + math.cos(gam) * ((T0 * math.sin(a) + L0) / m - grav * math.cos(gam))
    altitude, speed = (lambda z: z[0]), (lambda z: z[1])
    Lfh = lie_derivative(altitude, f)
    np.testing.assert_allclose(Lfh(x), V * math.sin(gam), rtol=1e-12)
    np.testing.assert_allclose(lie_derivative(altitude, f, 2)(x), Lf2h, rtol=1e-9)
    np.testing.assert_allclose(lie_derivative(speed, f)(x), f2, rtol=1e-9)
    got = [[lie_derivative(y, gj)(x) for gj in g] for y in (Lfh, speed)]
    lift = qS / m * (0.76224 * math.cos(gam) - slope * math.sin(gam))
    want = [[TP / m * math.sin(th), lift], [TP * math.cos(a) / m, -qS / m * slope]]
    np.testing.assert_allclose(got, want, rtol=1e-9)
    assert all(float(lie_derivative(altitude, gj)(x)) == 0.0 for gj in g)


@pytest.mark.thorough
def test_relative_degree_and_decoupling_matrix(model, form):
    """[1] eqs. 4-8: degrees 2 and 1, dv/du and its determinant at the trim; what is not affine."""
    found = form.degree
    assert (found.degrees, found.total, found.is_defined) == ({"h": 2, "V": 1}, 3, True)
    np.testing.assert_allclose(found.matrix, [[0.685649, 86.387771], [24.596085, -40.341697]], rtol=2e-6)
    np.testing.assert_allclose(found.determinant, -2152.4612, rtol=1e-6)
    assert curved_inputs(model, form.x0, form.u0, radius=RADIUS) == {"delta_e": ("V",)}


@pytest.mark.thorough
def test_extended_input_makes_the_model_affine(model, form):
    longer = extend_inputs(model, ("delta_e",))
    x, u = np.append(form.x0, form.u0[1]), np.array([form.u0[0], 0.0])
    assert curved_inputs(longer, x, u, radius={**RADIUS, "delta_e'": 0.1}) == {}
    found = relative_degree(longer, x, u, radius={**RADIUS, "delta_e'": 0.1})
    assert not found.is_defined  # the fuel comes first in both: then it must be extended too
    both = extend_inputs(model, ("Phi", "delta_e"))
    z = np.concatenate([form.x0, form.u0])
    found = relative_degree(both, z, np.zeros(2), radius=RADIUS)
    assert (found.degrees, found.is_defined) == ({"h": 3, "V": 2}, True)
    np.testing.assert_allclose(found.determinant, -2152.4612, rtol=1e-6)


@pytest.mark.thorough
def test_exact_linearisation_matches_oracle_rows(form):
    """[1] eqs. 4-8: A[4,:] = e_Q and B[4,:] = [-1/V, 0] to 1e-9; and the oracle's rows."""
    linear = linearise(form.model())
    assert linear.states == ("h", "h'", "V", *INTERNAL)
    np.testing.assert_allclose(linear.A[3], np.eye(9)[4], atol=1e-9)
    np.testing.assert_allclose(linear.B[3], [-1 / V, 0], atol=1e-9)
    Q = [-6.295672e-6, 1.687744e-5, 3.491600e-5, 7.075971, 0, -0.05939869, -1.439968e-4, -0.2099934, -4.199867e-4]
    one = [8.613738e-4, -2.309172e-3, -4.777208e-3, 3683.672, 0, -264.1231, -0.6402984, 28.73129, 0.05746259]
    two = [0.02311599, -7.183074e-3, -0.1282020, -7393.370, 0, 19.55524, 0.04740663, -330.8660, -0.6617320]
    np.testing.assert_allclose(linear.A[[4, 6, 8]], [Q, one, two], rtol=1e-6, atol=1e-12)
    rows = [[-4.261384e-3, 4.119672e-3], [0.5830425, -0.5636536], [15.64664, -1.753341]]
    np.testing.assert_allclose(linear.B[[4, 6, 8]], rows, rtol=1e-6)
    np.testing.assert_allclose(linear.A[:3], np.eye(9)[[1, 8, 8]] * [[1], [0], [0]], atol=1e-9)
    np.testing.assert_allclose(linear.A[[5, 7]], np.eye(9)[[6, 8]], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kmode", "unstable", "rest", "digits"),
    [
        ("parker", 3.28943, [-3.28922, -0.34454 + 18.5028j, -0.30658 + 16.0052j], 1e-4),
        ("paper", 3.2893, [-3.2893, -0.414 + 20.372j, -0.322 + 16.346j], 1e-3),
        ("author", 3.301, [-3.301, -0.400 + 20.076j, -0.330 + 16.461j], 1e-3),
    ],
)
def test_internal_dynamics_have_one_unstable_pole(kmode, unstable, rest, digits, level):
    """[1] eqs. 4-8: exactly one pole on the right, 3.2894 +- 1e-3 (`parker`)."""
    found = zero_dynamics(model_of(kmode), level.x, level.u, internal=INTERNAL, radius=RADIUS)
    assert found.verdict == "non-minimum phase"
    assert (found.poles.real > 0).sum() == 1
    if kmode == "parker":
        assert abs(found.poles[0] - 3.2894) < 1e-3
    want = [unstable, *rest, *(np.conj(p) for p in rest if np.imag(p))]
    for poles in (found.poles, found.zeros.zeros):
        assert len(poles) == 6
        for p in want:
            assert np.abs(poles - p).min() < digits
    np.testing.assert_allclose(found.zeros.zeros, found.poles, rtol=1e-6)
    assert found.why[0].endswith((", in alpha, q", ", in q, alpha"))


@pytest.mark.thorough
def test_inversion_reaches_commanded_derivatives(form, model):
    """[1] eqs. 4-8: |(h'', V') - v| below 1e-9 over the grid, with the general inversion."""
    grid = [(h, V, a * DEG) for h in (80e3, 95e3) for V in (7e3, 9e3) for a in (0.0, 2.0, 4.0)]
    states = jnp.array([[h, V, a, a + 0.002, 0.0, 0, 0, 0, 0] for h, V, a in grid])
    v = jnp.array([1.5, -2.0])

    def miss(x):
        u = form.invert(x, v)
        rate = model.f(x, u)
        gam, gam_rate = x[3] - x[2], rate[3] - rate[2]
        return jnp.stack([rate[1] * jnp.sin(gam) + x[1] * gam_rate * jnp.cos(gam), rate[1]]) - v

    got = jax.jit(jax.vmap(miss), compiler_options=FAST_COMPILE_OPTIONS)(states)
    assert np.abs(got).max() < 1e-9


def test_open_loop_poles_match_published_values(model, level):
    """[1] eqs. 4-8, u held."""
    poles = linearise(model, level.x, level.u).poles()
    want = [1.6957, -1.7658, -8.0e-4 + 0.0419j, 0.0, -0.3053 + 15.960j, -0.3455 + 18.393j]
    for p, digits in zip(want, [1e-4, 1e-4, 1e-4, 1e-6, 1e-3, 1e-3], strict=True):
        assert np.abs(poles - p).min() < digits

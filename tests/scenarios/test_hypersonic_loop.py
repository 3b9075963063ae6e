"""The hypersonic vehicle's loop as matrices, and its proofs."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.estimators.flexible.discrete import FlexibleModeFilter
from trimtab.scenarios.hypersonic import _certified_loop as certified
from trimtab.scenarios.hypersonic import _design as hypersonic
from trimtab.scenarios.hypersonic import _loop as loop
from trimtab.scenarios.hypersonic._internal import level_trim
from trimtab.vehicles.hypersonic import Hypersonic

CRAFT = hypersonic.NOMINAL


@pytest.fixture(scope="module")
def certificate():
    return hypersonic.certificate()


@pytest.fixture(scope="module")
def at():
    return level_trim(CRAFT, hypersonic.H, hypersonic.V)


def proved(certificate, **settings):
    system = hypersonic.certified_system(**settings)
    return {name: compute() for name, compute in system.loop_lines(certificate)}


@pytest.mark.thorough
def test_loop_poles_are_those_of_gain_and_filter(certificate, at):
    """Separation, for the model itself: the thirteen poles of the whole loop are those of A + B K and A_eta - L C."""
    A = loop.continuous_loop(CRAFT, CRAFT, certificate.K, certificate.observer.L, at)
    wanted = np.concatenate([certificate.poles, certificate.observer.poles])
    for pole in np.linalg.eigvals(A):
        assert np.abs(wanted - pole).min() < 1e-6 * abs(pole)


@pytest.mark.thorough
def test_sampled_loop_converges_to_the_continuous_loop(certificate, at):
    """The poles are exp(s T) of those of A + B K up to the hold's delay, which halves with the period."""

    def apart(period):
        F, N = loop.sampled_loop(CRAFT, FlexibleModeFilter(R=5e-7 / (period * 1e-7), period=period), certificate.K, at)
        assert (F.shape, N.shape) == ((20, 20), (20,))
        values = np.linalg.eigvals(F).astype(complex)
        rates = np.log(values[np.abs(values) > 0.1]) / (period * 1e-7)
        return np.array([np.abs(rates - pole).min() / abs(pole) for pole in certificate.poles])

    coarse, fine = apart(ms(4)), apart(ms(2))
    assert coarse.max() < 0.03
    np.testing.assert_allclose(coarse / fine, 2.0, rtol=0.1)


@pytest.mark.thorough
def test_loop_matrix_is_a_convex_combination_of_vertices(certificate, at):
    """The loop is affine in each coefficient: inside the box it is the weighted mean of the corners."""
    parts = np.random.default_rng(0).uniform(-1, 1, 5)
    L = certificate.observer.L

    def matrix(parts):
        # 1/m is what it is affine in: the mass whose inverse is between those at the ends
        low, high = (1 / (1 + side * certified.UNCERTAINTY["m"]) for side in (-1, 1))
        mass = (1 / ((low + high) / 2 + parts[0] * (high - low) / 2) - 1) / certified.UNCERTAINTY["m"]
        plant = certified.uncertain_plant(CRAFT, (mass, *parts[1:]))
        return loop.continuous_loop(plant, CRAFT, certificate.K, L, at)

    mean = 0.0
    for corner in itertools.product((-1.0, 1.0), repeat=5):
        mean = mean + np.prod((1 + np.array(corner) * parts) / 2) * matrix(corner)
    size = loop.SAMPLED_SIZES[:13]
    apart = (mean - matrix(parts)) * size / size[:, None]
    assert np.abs(apart).max() < 1e-9 * np.abs(mean * size / size[:, None]).max()


def test_modal_boxes_cover_their_range():
    """Neighbouring boxes share edges, the outermost reach the range's ends, and each has both ends of 2 zeta w."""
    boxes = list(certified._modal_boxes(CRAFT, 0.03))
    assert len(boxes) == 9
    w = np.array([[[p.modes.w1, p.modes.w2] for p in box] for box in boxes]) / [CRAFT.modes.w1, CRAFT.modes.w2]
    assert w.min() == pytest.approx(0.97)
    assert w.max() == pytest.approx(1.03)
    for mode in (0, 1):
        ends = sorted({(round(b[:, mode].min(), 12), round(b[:, mode].max(), 12)) for b in w})
        assert [high for _, high in ends[:-1]] == [low for low, _ in ends[1:]]
    damping = {round(2 * p.modes.zeta1 * p.modes.w1 / (2 * 0.02 * 16.5), 12) for box in boxes for p in box}
    assert damping == {round(0.97 * 0.9, 12), round(1.03 * 1.1, 12)}


@pytest.mark.thorough
def test_shipped_loop_conditions_are_all_proved(certificate):
    lines = proved(certificate)
    assert all(line.holds for line in lines.values()), lines
    sampled = lines["the sampled loop decays"]
    assert sampled.how == "exact, 20 states at 200 Hz"
    assert sampled.number == pytest.approx(0.9 * 0.22667, rel=1e-3)  # of the slowest motion
    assert lines["every plant of the modes' box decays"].how == "exact, 144 vertices of 9 boxes"
    assert "w1, w2 3 %" in lines["every plant of the modes' box decays"].why
    assert lines["every plant of the coefficients' box decays"].how == "exact, 32 vertices of 1 boxes"
    assert "h 11.5," in lines["inside a level of V no input saturates"].why


@pytest.mark.thorough
def test_loop_includes_integral_action(at):
    """As in the scenarios: 22 and 15 states; the poles of the loop are those of gain and filter."""
    c = hypersonic.certificate(integral="true")
    A = loop.continuous_loop(CRAFT, CRAFT, c.K, c.observer.L, at)
    wanted = np.concatenate([c.poles, c.observer.poles])
    assert len(A) == len(wanted) == 15
    for pole in np.linalg.eigvals(A):
        assert np.abs(wanted - pole).min() < 1e-6 * abs(pole)
    lines = proved(c, integral="true")
    assert all(line.holds for line in lines.values()), lines
    sampled = lines["the sampled loop decays"]
    assert sampled.how == "exact, 22 states at 200 Hz"
    assert sampled.number == pytest.approx(-0.9 * c.poles.real.max(), rel=2e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("filter", ["accurate", "printed"])
def test_fragile_filters_are_not_proved_for_1_percent_mode_error(filter):
    """With these filters the vehicle is lost, as in flights; the sampled loop of the exact model still decays."""
    settings = {"filter": filter, "mode_error": 0.01}
    lines = proved(hypersonic.certificate(**settings), **settings)
    assert lines["the sampled loop decays"].holds
    box = lines["every plant of the modes' box decays"]
    assert not box.holds
    assert box.number < -0.05  # grows, at a corner


@pytest.mark.thorough
def test_shipped_filter_is_proved_for_5_percent_mode_error(certificate):
    lines = proved(certificate, mode_error=0.05)
    assert lines["every plant of the modes' box decays"].holds
    lines = proved(certificate, mode_error=0.2)
    assert not lines["every plant of the modes' box decays"].holds


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda c: c._replace(K=-c.K), "the sampled loop decays"),
        (lambda c: c._replace(K=0.1 * c.K), "every plant of the coefficients' box decays"),
        (lambda c: c._replace(observer=c.observer._replace(L=-c.observer.L)), "every plant of the modes' box decays"),
        (lambda c: c._replace(P=-c.P), "inside a level of V no input saturates"),
    ],
)
def test_each_proof_condition_fails_for_its_mutation(certificate, change, line):
    condition = proved(change(certificate))[line]
    assert not condition.holds
    assert condition.why


@pytest.mark.thorough
def test_flights_from_the_proved_level_converge_without_saturation(certificate, at):
    """The vehicle itself, not its linear model, from 40 points where V is the proved level: no input reaches a limit,
    and V falls below a hundredth in 15 s."""
    line = proved(certificate)["inside a level of V no input saturates"]
    o, L = certificate.observer, certificate.observer.L
    S = np.zeros((13, 13))
    S[:9, :9], S[9:, 9:] = certificate.P / 2, o.weight * np.linalg.inv(o.P)
    size = 1 / np.sqrt(np.diag(S))
    root = np.linalg.cholesky(S * np.outer(size, size))
    points = np.linalg.solve(root.T, np.random.default_rng(0).standard_normal((13, 40))).T * size
    points = points * np.sqrt(line.number / np.einsum("ni,ij,nj->n", points, S, points))[:, None]
    rest, K = jnp.array(loop.rest_state(CRAFT, CRAFT, at)[:13]), jnp.array(certificate.K)
    S = jnp.array(S)

    def errors(z):
        x = z - rest
        h_rate = z[1] * jnp.sin(z[3] - z[2])
        return jnp.concatenate([jnp.stack([x[0], h_rate, x[1], x[2], x[4]]), x[5:9], z[5:9] - z[9:13]])

    def states(e):
        """Return the states: theta from h' = V sin gamma, the estimate from its error."""
        theta = at.zeta[0] + e[3] + jnp.arcsin(e[1] / (at.V + e[2]))
        flight = jnp.stack([at.h + e[0], at.V + e[2], at.zeta[0] + e[3], theta, e[4]])
        return jnp.concatenate([flight, rest[5:9] + e[5:9], rest[5:9] + e[5:9] - e[9:]])

    def fly(e):
        def rates(z):
            return loop._loop_rates(CRAFT, CRAFT, K, jnp.array(L), at, z)

        def step(z, _):
            u, h = loop.input_at_errors(CRAFT, K, at, errors(z)), 0.005
            a = rates(z)
            b = rates(z + h / 2 * a)
            c = rates(z + h / 2 * b)
            d = rates(z + h * c)
            return z + h / 6 * (a + 2 * b + 2 * c + d), (u, errors(z) @ S @ errors(z))

        return jax.lax.scan(step, states(e), None, 3000)[1]

    u, V = jax.jit(jax.vmap(fly))(jnp.array(points))
    assert float(V[:, 0].max()) == pytest.approx(line.number, rel=1e-6)
    limits = np.array([[0.02, 1.5], [-0.3490658503988659, 0.450294947014537]])
    assert (np.asarray(u).min(axis=(0, 1)) > limits[:, 0]).all()
    assert (np.asarray(u).max(axis=(0, 1)) < limits[:, 1]).all()
    assert float(V[:, -1].max()) < 0.01 * line.number


@pytest.mark.thorough
def test_loop_matrix_depends_on_the_plant(at, certificate):
    heavy = replace(Hypersonic(), m=330.0)
    A = loop.continuous_loop(heavy, CRAFT, certificate.K, certificate.observer.L, at)
    assert not np.allclose(A, loop.continuous_loop(CRAFT, CRAFT, certificate.K, certificate.observer.L, at))

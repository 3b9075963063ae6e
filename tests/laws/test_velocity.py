"""Velocity laws against [1] Z. Kulis 2006, section 2.2, and the derivations on the docs page."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.signals import Estimate, PlanarState
from trimtab.laws.velocity import (
    ForwardMomentum,
    ForwardMomentumMatched,
    ReverseMomentum,
    ZeroVelocity,
    slow_manifold_rate,
)
from trimtab.vehicles.hovercraft import Hovercraft

M, J, D = 2.6, 0.096, 0.32
LAWS = [ZeroVelocity(), ForwardMomentum(), ForwardMomentumMatched(), ReverseMomentum()]
PROVED = LAWS[:3]


def named(law):
    return type(law).__name__


def estimate(u, v, r):
    return Estimate(t=0, age=0.0, fresh=True, valid=True, state=PlanarState(u, v, r, 0.0))


def closed_loop(law):
    """Return (u, v, r) -> their derivatives, from independent equations of motion."""

    def rate(x):
        u, v, r = x
        F = law.step(0, (), estimate(u, v, r))[1].demand
        return jnp.stack([v * r + F.FX / M, -u * r + F.FY / M, -D * F.FY / J])

    return rate


def value(law):
    return lambda x: law.step(0, (), estimate(*x))[1].lyapunov


def decay(law):
    """Return dW/dt at a state, by automatic differentiation."""
    return jax.jit(jax.vmap(lambda x: jnp.dot(jax.grad(value(law))(x), closed_loop(law)(x))))


def eigenvalues(law):
    rest = law.equilibrium()
    at = jnp.array([rest.surge_velocity, rest.sway_velocity, rest.yaw_rate], float)
    A = jax.jacfwd(closed_loop(law))(at)
    return np.sort_complex(np.linalg.eigvals(np.asarray(A)))


STATES = np.random.default_rng(0).uniform(-1, 1, (2000, 3)) * [2.0, 2.0, 8.0]


def test_zero_velocity_law_satisfies_its_energy_identity():
    """[1, eq. 2.17], 1e-9: V' = -k1 u^2 - k2 (v - d r)^2."""
    u, v, r = STATES.T
    np.testing.assert_allclose(decay(ZeroVelocity(0.7, 3.1))(STATES), -0.7 * u**2 - 3.1 * (v - D * r) ** 2, atol=1e-9)


def test_forward_momentum_law_satisfies_its_energy_identity():
    """[1, eq. 2.23] with lambda = 1 + kappa, 1e-9."""
    k1, k2, PXr = 0.7, 3.1, 1.9
    kappa = PXr / (k2 * D)
    u, v, r = STATES.T
    form = v**2 - 2 * D * v * r + (1 + kappa) * D**2 * r**2
    got = decay(ForwardMomentum(k1, k2, PXr))(STATES)
    np.testing.assert_allclose(got, -k1 * (u - PXr / M) ** 2 - k2 * form, atol=1e-9)


def test_matched_momentum_law_satisfies_its_energy_identity():
    """[1, eq. 2.29]: without cross terms, 1e-9."""
    k1, PXr = 0.7, 1.9
    u, v, r = STATES.T
    k2 = PXr / (2 * D)
    got = decay(ForwardMomentumMatched(k1, PXr))(STATES)
    np.testing.assert_allclose(got, -k1 * (u - PXr / M) ** 2 - k2 * (v**2 + D**2 * r**2), atol=1e-9)


def test_forward_lyapunov_function_decreases_for_all_gains():
    """W' < 0 off the equilibrium for 400 random gains; most violate the thesis' k2 > PXr/d."""
    draws = np.random.default_rng(1)
    gains = np.exp(draws.uniform(np.log(0.05), np.log(20), (400, 3)))
    assert (gains[:, 1] <= gains[:, 2] / D).sum() > 200

    def worst(g):
        law = ForwardMomentum(g[0], g[1], g[2])
        at = jnp.asarray(STATES[:300]) + jnp.array([1.0, 0.0, 0.0]) * g[2] / M
        return decay(law)(at).max()

    assert jax.vmap(worst)(gains).max() < 0


def test_published_lambda_fails_with_published_gains():
    """[1] table 6.2 against [1, eq. 2.24]: lambda = 1 - kappa is negative, so that W has no minimum."""
    law = ForwardMomentum()
    kappa = law.reference / (law.k2 * D)
    assert kappa == pytest.approx(2.1875)
    assert 1 - kappa < 0
    flipped = value(law)(jnp.array([law.reference / M, 0.0, 1.0])) - (1 + kappa) * J / 2 + (1 - kappa) * J / 2
    assert flipped < 0


CLOSED_FORM = [
    (ZeroVelocity(1.0, 2.5), [-3.6282, -0.3846, 0.0]),
    (ForwardMomentum(1.0, 4.0, 2.8), [-2.9026 - 2.4360j, -2.9026 + 2.4360j, -0.3846]),
    (ReverseMomentum(1.5, 1.0, 1.44, -1.98), [-0.5769, -0.5757 - 1.4856j, -0.5757 + 1.4856j]),
]


@pytest.mark.parametrize(("law", "expected"), CLOSED_FORM, ids=lambda p: named(p) if hasattr(p, "k1") else "")
def test_eigenvalues_match_closed_forms(law, expected):
    """[1, eqs. 2.31 to 2.33], 1e-3."""
    np.testing.assert_allclose(eigenvalues(law), np.sort_complex(np.array(expected, complex)), atol=1e-3)


@pytest.mark.parametrize("gains", [(1.5, 1.0, 1.44, -1.98), (0.4, 2.2, 0.7, -3.0), (2.0, 0.3, 5.0, -0.2)])
def test_reverse_eigenvalues_match_the_published_closed_form(gains):
    """[1, eq. 2.33] written out."""
    k1, k2, theta, PXr = gains
    a = D**2 * theta * M - J
    root = np.sqrt(complex(k2**2 * a**2 + 4 * k2 * PXr * D * M * J))
    s = [-k1 / M, (-k2 * a + root) / (2 * M * J), (-k2 * a - root) / (2 * M * J)]
    np.testing.assert_allclose(eigenvalues(ReverseMomentum(*gains)), np.sort_complex(np.array(s)), atol=1e-9)


def test_reverse_is_stable_only_above_the_minimum_theta():
    least = J / (D**2 * M)
    assert eigenvalues(ReverseMomentum(theta=least * 1.01)).real.max() < 0
    assert eigenvalues(ReverseMomentum(theta=least * 0.99)).real.max() > 0


@pytest.mark.thorough
def test_decay_on_slow_manifold_has_predicted_slope(continuous, starts):
    """The slope of 1/(2 r^2) over 1000 to 2000 s is 1.911 within 1 %.

    The law is smooth and the fast modes are damped, so RK4 at 0.1 s with the law inside the derivative is exact
    enough; halving the step changes the slope by less than 1e-6 of it.
    """
    law = ZeroVelocity(1.0, 2.5)
    assert float(slow_manifold_rate(law)) == pytest.approx(1.9110, abs=1e-4)
    slopes = []
    for h in (0.1, 0.05):
        r = np.asarray(continuous(law, starts(0.2, -0.7, 2.0), 2000.0, h, every=round(1 / h)).yaw_rate)[0]
        t = np.arange(r.size) * 1.0
        slopes.append(np.polyfit(t[1000:], 1 / (2 * r[1000:] ** 2), 1)[0])
    assert slopes[0] == pytest.approx(1.911, rel=0.01)
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)


@pytest.mark.thorough("ForwardMomentum", "ForwardMomentumMatched")
@pytest.mark.parametrize("law", PROVED, ids=named)
def test_lyapunov_never_grows_along_ideal_runs(law, sampled, starts):
    u, v, r = STATES[:50].T
    _, output = sampled(law, starts(u, v, r), 10.0, every=5)
    W = np.asarray(output.lyapunov)
    assert np.diff(W, axis=1).max() <= 1e-9
    assert (W[:, -1] < 0.1 * W[:, 0]).all()


@pytest.mark.thorough("ForwardMomentum", "ForwardMomentumMatched")
@pytest.mark.parametrize("law", LAWS[1:], ids=named)
def test_momentum_laws_reach_their_equilibrium(law, continuous, starts):
    """Random starts in |PX|, |PY| <= 5 kg m/s, |Pi| <= 0.8 kg m^2/s; for ReverseMomentum evidence, not proof."""
    u, v, r = np.random.default_rng(2).uniform(-1, 1, (3, 200)) * [[5 / M], [5 / M], [0.8 / J]]
    end = jax.tree.map(lambda a: a[:, -1], continuous(law, starts(u, v, r), 200.0, 0.01, every=100))
    rest = law.equilibrium()
    np.testing.assert_allclose(end.surge_velocity, rest.surge_velocity, atol=1e-3)
    np.testing.assert_allclose(end.sway_velocity, 0.0, atol=1e-3)
    np.testing.assert_allclose(end.yaw_rate, 0.0, atol=1e-3)


def test_reverse_distance_is_not_a_lyapunov_function():
    """The distance grows at some states, as documented."""
    assert decay(ReverseMomentum())(STATES).max() > 0


def test_matched_law_equals_forward_law_at_matched_gain():
    PXr = 1.7
    a, b = ForwardMomentumMatched(0.9, PXr), ForwardMomentum(0.9, PXr / (2 * D), PXr)
    for x in STATES[:20]:
        fa, fb = (law.step(0, (), estimate(*x))[1].demand for law in (a, b))
        assert (float(fa.FX), float(fa.FY)) == pytest.approx((float(fb.FX), float(fb.FY)))


def test_rejects_parameters_outside_the_proofs():
    for law in LAWS:
        getattr(law, "check", lambda: None)()
    for bad in (ForwardMomentum(reference=-1.0), ForwardMomentumMatched(reference=0.0), ForwardMomentum(reference=0.0)):
        with pytest.raises(InputError, match="must be positive"):
            bad.check()
    with pytest.raises(InputError, match="must be negative"):
        ReverseMomentum(reference=1.0).check()
    with pytest.raises(InputError, match=r"theta must be above .* 0\.3606"):
        ReverseMomentum(theta=0.36).check()
    heavier = replace(Hovercraft(), inertia=0.5)
    with pytest.raises(InputError, match="theta"):
        ReverseMomentum(model=heavier).check()

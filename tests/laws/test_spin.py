"""ConstantSpin, its start condition, and its supervisor, against [1] Z. Kulis 2006, sections 2.2.6 and 2.3."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.rng import key
from trimtab.core.signals import Estimate, PlanarState
from trimtab.laws.spin import (
    BRAKE,
    SPIN,
    ConstantSpin,
    SupervisedSpin,
    limit_point_value,
    lyapunov,
    safe_reference_bound,
    switching_energy,
    switching_energy_sharp,
)
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

M, J, ARM = 2.6, 0.096, 0.32
D = ARM**2 * M
CRAFT = Hovercraft()
RNG = np.random.default_rng(0)


def W_numpy(u, v, r, reference):
    return M * (u**2 + v**2) / 2 + J * (r - reference) ** 2 / 2


def on_energy_sphere(n, energy):
    """Return states (u, v, r) with exactly this kinetic energy, in random directions."""
    a = RNG.standard_normal((3, n))
    a *= np.sqrt(2 * energy) / np.linalg.norm(a, axis=0)
    return a[0] / np.sqrt(M), a[1] / np.sqrt(M), a[2] / np.sqrt(J)


def estimate(u, v, r, valid=True):
    return Estimate(t=0, age=0.0, fresh=True, valid=valid, state=PlanarState(u, v, r, 0.0))


def rate(law):
    def f(x):
        u, v, r = x
        F = law.step(0, (), estimate(u, v, r))[1].demand
        return jnp.stack([v * r + F.FX / M, -u * r + F.FY / M, -ARM * F.FY / J])

    return f


def test_spin_law_satisfies_its_energy_identity():
    """[1, eq. 2.37], 1e-9."""
    law = ConstantSpin(0.7, 3.1, -2.2)
    x = RNG.uniform(-1, 1, (2000, 3)) * [2.0, 2.0, 8.0]
    got = jax.vmap(lambda x: jnp.dot(jax.grad(lambda x: law.lyapunov(PlanarState(*x, 0.0)))(x), rate(law)(x)))(x)
    u, v, r = x.T
    np.testing.assert_allclose(got, -0.7 * u**2 - 3.1 * (v - ARM * (r + 2.2)) ** 2, atol=1e-9)


@pytest.mark.thorough
def test_eigenvalues_at_the_good_point_match_published_values():
    """PI(0.5, 3.5; 3 rad/s), 1e-3."""
    A = jax.jacfwd(rate(ConstantSpin(0.5, 3.5, 3.0)))(jnp.array([0.0, 0.0, 3.0]))
    expected = np.sort_complex(np.array([-4.6751, -0.2984 + 2.6642j, -0.2984 - 2.6642j]))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(np.asarray(A))), expected, atol=1e-3)


@pytest.mark.parametrize("reference", [3.0, -1.5])
def test_exactly_two_limit_points_are_equilibria(reference):
    law = ConstantSpin(reference=reference)
    spinning, sliding = HovercraftState(yaw_rate=reference), HovercraftState(sway_velocity=-ARM * reference)
    for p in (spinning, sliding):
        np.testing.assert_allclose(rate(law)(jnp.array([p.surge_velocity, p.sway_velocity, p.yaw_rate])), 0, atol=1e-12)
    # W' = 0 needs u = 0 and v = d (r - reference), hence FX = FY = 0; then u' = v r must vanish too
    r = np.linspace(-10, 10, 2001)
    v = ARM * (r - reference)
    np.testing.assert_allclose(np.unique(np.round(r[np.abs(v * r) < 1e-9], 6)), sorted({0.0, reference}), atol=1e-9)


def test_bad_point_attracts_negative_and_repels_positive_yaw_rates(continuous, starts):
    """On the slow manifold r' = -c r^2 (r - reference): from r < 0 to the bad point, from r > 0 away from it."""
    law = ConstantSpin(reference=3.0)
    r = np.array([-0.05, 0.05])
    end = continuous(law, starts(0.0, ARM * (r - 3.0), r), 200.0, 0.01, every=100)
    assert -0.01 < end.yaw_rate[0, -1] < 0
    assert end.sway_velocity[0, -1] == pytest.approx(-ARM * 3.0, abs=0.01)
    assert end.yaw_rate[1, -1] == pytest.approx(3.0, abs=1e-6)


def test_limit_point_constants_match_published_values():
    """[1, eq. 2.48], 1e-4: W_bad(Pir = 0.288), eps(3 rad/s), and the sharp ratio."""
    assert float(limit_point_value(CRAFT, 0.288 / J)) == pytest.approx(1.63008, abs=1e-4)
    assert float(switching_energy(CRAFT, 3.0)) == pytest.approx(0.220142, abs=1e-4)
    assert float(switching_energy_sharp(CRAFT, 3.0) / switching_energy(CRAFT, 3.0)) == pytest.approx(1.74321, abs=1e-4)
    assert float(switching_energy(CRAFT, 1.5)) == pytest.approx(0.0550355, abs=1e-6)
    assert float(limit_point_value(CRAFT, 1.5)) == pytest.approx(0.40752, abs=1e-5)
    assert float(switching_energy_sharp(CRAFT, 3.0)) == pytest.approx(0.383754, abs=1e-6)


@pytest.mark.parametrize("reference", [3.0, -0.7])
def test_switching_energies_are_safe_and_sharp_one_is_tight(reference):
    """Largest W/W_bad over 200 000 states of that energy: 0.777 as published, 1 (to 1 %) for the sharp one."""
    bad = W_numpy(0.0, -ARM * reference, 0.0, reference)
    for energy, low, high in ((switching_energy, 0.76, 0.78), (switching_energy_sharp, 0.99, 1.0)):
        u, v, r = on_energy_sphere(200_000, float(energy(CRAFT, reference)))
        assert low < (W_numpy(u, v, r, reference) / bad).max() < high
    worst = -np.sign(reference) * np.sqrt(2 * float(switching_energy_sharp(CRAFT, reference)) / J)
    assert W_numpy(0.0, 0.0, worst, reference) == pytest.approx(bad, rel=1e-12)


def test_starts_below_the_limit_point_value_reach_the_spin(continuous, starts):
    """100 of 100 starts with W < W_bad reach the good point. [1] section 2.2.6.

    The law is smooth: RK4 at 0.01 s with the law inside the derivative, against its fastest eigenvalue -4.7.
    """
    law, W_bad = ConstantSpin(reference=3.0), 1.63008
    u, v, r = on_energy_sphere(100, W_bad) * RNG.uniform(0.02, 0.999, 100) ** 0.5
    r = r + 3.0
    assert (W_numpy(u, v, r, 3.0) < W_bad).all()
    end = continuous(law, starts(u, v, r), 100.0, 0.01, every=100)
    close = np.abs(end.yaw_rate[:, -1] - 3.0) < 1e-3
    assert close.sum() == 100
    assert np.abs(end.sway_velocity[:, -1]).max() < 1e-3


def test_provision_is_tight_at_the_worst_state():
    """[1, eq. 2.69]: coefficient 0.339846 within 1e-5; equality at the worst state."""
    assert float(safe_reference_bound(CRAFT, 0.0, 1.0)) == pytest.approx(0.339846, abs=1e-5)
    for W, reference in ((0.3, 2.0), (1.1, -0.8), (0.02, 4.0)):
        v = float(safe_reference_bound(CRAFT, W, reference))
        A = np.sqrt(2 * W / J) + abs(reference)
        assert v == pytest.approx(0.339846 * A, abs=1e-5 * A)
        worst = np.sign(reference) * A
        assert W_numpy(0, 0, worst, reference) == pytest.approx(W)
        new = np.sign(reference) * v
        assert W_numpy(0, 0, worst, new) == pytest.approx((J + D) * v**2 / 2, rel=1e-12)


def test_provision_is_never_violated():
    """0 violations in 400 references and energies (W < W_bad) times 3000 states.

    New references just above the bound, anywhere up to the present one, and above it; a change of sign fails always.
    """
    reference = RNG.uniform(0.1, 6, 400)
    W = RNG.uniform(0.001, 0.999, 400) * (J + D) * reference**2 / 2
    least = np.asarray(safe_reference_bound(CRAFT, W, reference))
    ball = np.array(on_energy_sphere(3000, 1.0)) * RNG.uniform(0, 1, 3000) ** (1 / 3)
    u, v, off = np.sqrt(W)[:, None, None].swapaxes(0, 1) * ball[:, None, :]
    r = off + reference[:, None]
    for new in (least * (1 + 1e-9), RNG.uniform(least, reference), reference * RNG.uniform(1, 3, 400)):
        assert (W_numpy(u, v, r, new[:, None]) < (J + D) * new[:, None] ** 2 / 2).all()
    flipped = W_numpy(u, v, r, -least[:, None]) >= (J + D) * least[:, None] ** 2 / 2
    assert flipped.any(axis=1).all()


def test_provision_is_insufficient_above_the_limit_point_value():
    """For W > W_bad a reference at twice the bound still has W above its limit point value, as documented."""
    reference, r = 0.5, -4.0
    W = W_numpy(0.0, 0.0, r, reference)
    assert (J + D) * reference**2 / 2 < W
    new = 2 * float(safe_reference_bound(CRAFT, W, reference))
    assert W_numpy(0.0, 0.0, r, new) > (J + D) * new**2 / 2


def test_provision_is_below_the_reference_exactly_when_safe():
    """V < |reference| if and only if W < W_bad."""
    reference, W = RNG.uniform(-6, 6, 100_000), RNG.uniform(0, 3, 100_000)
    safe = (J + D) * reference**2 / 2 > W
    assert 0.2 < safe.mean() < 0.99
    np.testing.assert_array_equal(np.asarray(safe_reference_bound(CRAFT, W, reference)) < np.abs(reference), safe)


@pytest.mark.thorough
def test_provision_has_a_finite_slope_everywhere():
    slope = jax.grad(lambda W, r: safe_reference_bound(CRAFT, W, r), argnums=(0, 1))
    assert np.isfinite(slope(0.0, 1.0)).all()
    assert np.isfinite(slope(0.5, 1.0)).all()


def supervise(law, estimates):
    state, outputs = law.init(key(0)), []
    for e in estimates:
        state, output = law.step(0, state, e)
        outputs.append(output)
    return outputs


@pytest.mark.parametrize(("threshold", "rate_ratio"), [("published", 0.36749), ("sharp", 0.48520)])
def test_supervisor_switches_at_its_threshold(threshold, rate_ratio):
    """On the slow manifold V = (J + D) r^2/2, so that the gate is a ratio of yaw rates."""
    law = SupervisedSpin(threshold=threshold)
    over, under = (estimate(0.0, ARM * r, r) for r in (3 * rate_ratio * 1.0001, 3 * rate_ratio * 0.9999))
    fast = estimate(1.0, 1.0, 6.0)
    o = supervise(law, [over, over, under, under, fast])
    assert [int(x.mode) for x in o] == [BRAKE, BRAKE, SPIN, SPIN, SPIN], "latched"
    assert [int(x.switches) for x in o] == [0, 0, 1, 1, 1]
    for x, e in zip(o, [over, over, under, under, fast], strict=True):
        now = law.braking if int(x.mode) == BRAKE else law.spinning
        same = now.step(0, (), e)[1]
        assert (float(x.demand.FX), float(x.demand.FY)) == (float(same.demand.FX), float(same.demand.FY))
        assert float(x.lyapunov) == float(same.lyapunov)


def test_supervisor_waits_for_a_valid_estimate():
    law = SupervisedSpin()
    o = supervise(law, [estimate(0.0, 0.0, 0.0, valid=False), estimate(0.0, 0.0, 0.0)])
    assert [int(x.mode) for x in o] == [BRAKE, SPIN]


def test_supervisor_spins_from_any_start(sampled, starts):
    u, v, r = RNG.uniform(-1, 1, (3, 40)) * [[2.0], [2.0], [8.0]]
    x, o = sampled(SupervisedSpin(), starts(u, v, r), 40.0, every=20)
    np.testing.assert_allclose(x.yaw_rate[:, -1], 3.0, atol=0.01)
    mode = np.asarray(o.mode)
    assert (np.diff(mode, axis=1) >= 0).all()
    assert (mode[:, 0] == BRAKE).any()
    together = np.diff(mode, axis=1) == 0
    assert np.diff(np.asarray(o.lyapunov), axis=1)[together].max() <= 1e-9, "V falls, then W falls"


@pytest.mark.thorough
def test_lyapunov_method_matches_the_function():
    s = PlanarState(0.1, -0.3, 1.2, 0.0)
    assert float(ConstantSpin(reference=2.0).lyapunov(s)) == pytest.approx(float(lyapunov(CRAFT, s, 2.0)))

"""First particles, prediction, resampling, moments and likelihood against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.estimators.inertial.mechanisation import PreintegratedMotion
from trimtab.estimators.ranging import particle_cloud as pc
from trimtab.estimators.ranging.particle import Particle
from trimtab.estimators.ranging.particle_cloud import initialise_cloud
from trimtab.estimators.ranging.position import SQUARE
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import Geometry, predict_range

G = Geometry(SQUARE, np.array([0.2, 0.0]), 0.0, True)


def cloud(n=50, seed=0):
    g = np.random.default_rng(seed)
    x = 0.1 * g.standard_normal((n, 13))
    A = 0.05 * g.standard_normal((n, 13, 13))
    w = g.random(n)
    return pc.Cloud(x, A @ A.transpose(0, 2, 1) + 1e-4 * np.eye(13), w / w.sum())


@pytest.mark.parametrize("u", [0.01, 0.5, 0.99])
def test_systematic_resampling_matches_reference(u):
    """Every particle is copied floor or ceil of N w times: Arulampalam 2002, algorithm 2."""
    w = cloud().weight
    index = np.asarray(jax.jit(pc.systematic_indices)(w, u))
    want = np.searchsorted(np.cumsum(w), (np.arange(50) + u) / 50)
    np.testing.assert_array_equal(index, want)
    counts = np.bincount(index, minlength=50)
    assert (np.abs(counts - 50 * w) < 1).all()


def test_particle_with_all_weight_is_the_only_survivor():
    w = np.zeros(50)
    w[17] = 1.0
    assert set(np.asarray(pc.systematic_indices(w, 0.3))) == {17}
    assert float(pc.effective_sample_size(w)) == 1.0
    assert float(pc.effective_sample_size(np.full(50, 0.02))) == pytest.approx(50)


@pytest.mark.thorough
def test_resampling_keeps_mean_and_covariance():
    """One Gaussian made 20000 particles: half of its heading variance is spread, and the sum is what it was."""
    one = cloud(1)
    n = 20000
    many = pc.Cloud(np.repeat(one.x, n, 0), np.repeat(one.P, n, 0), np.full(n, 1 / n))
    z = np.random.default_rng(1).standard_normal(n)
    mean, P = jax.jit(lambda c: pc.cloud_moments(pc.resample(c, 0.5, z, 0.5)))(many)
    sigma = np.sqrt(np.diag(one.P[0]))
    assert np.abs((mean - one.x[0]) / sigma).max() < 0.03
    assert np.abs((P - one.P[0]) / np.outer(sigma, sigma)).max() < 0.03


def test_cloud_moments_match_the_mixture():
    c = cloud()
    mean, P = jax.jit(pc.cloud_moments)(c)
    away = c.x - np.asarray(mean)
    np.testing.assert_allclose(mean[1:], c.weight @ c.x[:, 1:], atol=1e-14)
    want = np.einsum("n,nij->ij", c.weight, c.P) + np.einsum("n,ni,nj->ij", c.weight, away, away)
    np.testing.assert_allclose(P, want, atol=1e-12)


def test_predicted_covariance_matches_the_jacobian():
    """F P F' with the derivative of the state's own prediction; each block of F counts here."""
    m = PreintegratedMotion(
        0.1, 0.2, np.array([0.1, -0.2]), np.array([0.01, 0.02]), 0.1 * np.eye(2), 0.005 * np.eye(2), np.zeros(2)
    )
    x, P = cloud().x[0], np.asarray(cloud().P[0])

    def predict(x):
        return pc.predict_particle(x, P, m, np.zeros((8, 8)))

    F, new_P = (np.asarray(a) for a in jax.jit(lambda x: (jax.jacfwd(lambda x: predict(x)[0])(x), predict(x)[1]))(x))
    np.testing.assert_allclose(new_P, F @ P @ F.T, atol=1e-12)
    np.testing.assert_allclose(F[0], np.eye(13)[0] - 0.1 * np.eye(13)[5], atol=1e-14)


@pytest.mark.thorough
def test_weights_match_scipy_likelihoods():
    """Particles without spread: Gauss and a floor, as scipy has them."""
    c = replace(cloud(20), P=np.zeros((20, 13, 13)))
    errors = RangeErrorModel(noise=0.05, gate=1e9, second_order=False)
    z = np.array([3.4, 3.5, 0.0, 3.5])
    updated, believed = pc.update_cloud(c, z, G, errors, 0.1, 6.0, jnp.ones(13))
    want = np.array(c.weight)
    for k, x in enumerate(c.x):
        cos, sin = np.cos(x[0]), np.sin(x[0])
        place = x[3:5] + 0.2 * np.array([cos, sin])
        for i in (0, 1, 3):
            h = (1 + x[8]) * float(predict_range(SQUARE[i], place, 0.0, cone=True).range) + x[9 + i]
            want[k] *= 0.9 * stats.norm.pdf(z[i], h, 0.05) + 0.1 / 6.0
    np.testing.assert_allclose(updated.weight, want / want.sum(), rtol=1e-9)
    assert float(believed[2]) == 0.0


@pytest.mark.thorough
def test_cloud_functions_lower_to_generated_c():
    c = cloud(10)
    assert lower_function(lambda c, z: pc.resample(c, 0.5, z, 0.5), (c, np.zeros(10))).text("f")
    errors = RangeErrorModel()

    def f(c, z):
        return pc.update_cloud(c, z, G, errors, 0.1, 6.0, jnp.ones(13))

    assert lower_function(f, (c, np.ones(4))).text("f")


PARTICLES = to_arrays(Particle(N=120))


@pytest.mark.thorough
def test_initial_particles_lie_at_range_intersections():
    """Half of the particles of each pair on either side of it, headings all around."""
    place = np.array([0.3, -0.2])
    ranges = np.sqrt(((SQUARE[:, :2] - place) ** 2).sum(1) + 2.7048**2)
    ranges[2:] = 0.0
    form = replace(PARTICLES, cone=False, units=np.zeros((1, 3)))
    first = jax.jit(lambda: initialise_cloud(form, key(0), 0, ranges, 0))()
    mirrored = np.array([3.0 - 0.3, -0.2])
    near = np.linalg.norm(np.asarray(first.x)[:, 3:5] - place, axis=1) < 1e-6
    far = np.linalg.norm(np.asarray(first.x)[:, 3:5] - mirrored, axis=1) < 1e-6
    assert (near | far).all()
    assert 40 <= near.sum() <= 80
    heading = np.sort(np.asarray(first.x)[:, 0])
    assert np.diff(heading).max() < 3 * 2 * np.pi / 120


@pytest.mark.thorough
def test_wrong_range_spoils_only_particles_of_its_pairs():
    """Of four ranges one is wrong: three of the six pairs are not, so a quarter of the particles is right."""
    place = np.array([0.3, -0.2])
    ranges = np.sqrt(((SQUARE[:, :2] - place) ** 2).sum(1) + 2.7048**2) + np.array([0.0, 1.0, 0.0, 0.0])
    form = replace(PARTICLES, cone=False, units=np.zeros((1, 3)))
    first = jax.jit(lambda: initialise_cloud(form, key(0), 1, ranges, 0))()
    near = np.linalg.norm(np.asarray(first.x)[:, 3:5] - place, axis=1) < 1e-6
    assert 15 <= near.sum() <= 45
    assert np.isfinite(np.asarray(first.P)).all()

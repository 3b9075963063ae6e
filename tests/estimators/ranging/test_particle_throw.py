"""The first particles against where two circles meet."""

import jax
import numpy as np

from trimtab.core.record import replace, to_arrays
from trimtab.core.rng import key
from trimtab.estimators.ranging.particle import Particle, initialise_cloud
from trimtab.estimators.ranging.position import SQUARE

FORM = to_arrays(Particle(N=120))


def test_the_throw_is_where_two_ranges_meet():
    """Half of the particles of each pair on either side of it, headings all around."""
    place = np.array([0.3, -0.2])
    ranges = np.sqrt(((SQUARE[:, :2] - place) ** 2).sum(1) + 2.7048**2)
    ranges[2:] = 0.0
    form = replace(FORM, cone=False, units=np.zeros((1, 3)))
    cloud = jax.jit(lambda: initialise_cloud(form, key(0), 0, ranges, 0))()
    mirrored = np.array([3.0 - 0.3, -0.2])
    near = np.linalg.norm(np.asarray(cloud.x)[:, 3:5] - place, axis=1) < 1e-6
    far = np.linalg.norm(np.asarray(cloud.x)[:, 3:5] - mirrored, axis=1) < 1e-6
    assert (near | far).all()
    assert 40 <= near.sum() <= 80
    heading = np.sort(np.asarray(cloud.x)[:, 0])
    assert np.diff(heading).max() < 3 * 2 * np.pi / 120


def test_a_wrong_range_spoils_only_its_pairs():
    """Of four ranges one is wrong: three of the six pairs are not, so a quarter of the particles is right."""
    place = np.array([0.3, -0.2])
    ranges = np.sqrt(((SQUARE[:, :2] - place) ** 2).sum(1) + 2.7048**2) + np.array([0.0, 1.0, 0.0, 0.0])
    form = replace(FORM, cone=False, units=np.zeros((1, 3)))
    cloud = jax.jit(lambda: initialise_cloud(form, key(0), 1, ranges, 0))()
    near = np.linalg.norm(np.asarray(cloud.x)[:, 3:5] - place, axis=1) < 1e-6
    assert 15 <= near.sum() <= 45
    assert np.isfinite(np.asarray(cloud.P)).all()

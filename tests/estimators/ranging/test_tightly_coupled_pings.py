"""A ping's effect on a running filter, loss of track and recovery. Flights are in test_tightly_coupled.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.record import replace, to_arrays
from trimtab.estimators.ranging.position import PAIR
from trimtab.estimators.ranging.range_model import predict_range, unit_geometry
from trimtab.estimators.ranging.start import tree_where
from trimtab.estimators.ranging.tightly_coupled import (
    TightlyCoupled,
    correction_mask,
    find_agreeing_ranges,
    update_running,
)

FORM = to_arrays(TightlyCoupled(begins="given"))
YES = np.ones(4, bool)
_tracked = jax.jit(lambda node, z: update_running(FORM, node, z, 0, YES))
_agreeing = jax.jit(lambda node, z: find_agreeing_ranges(FORM, node, z, 0))


def node(sure=True):
    """At 0.3, -0.2 with heading 0.4; sure: within centimetres, correlated as a filter's."""
    first = FORM.first()
    A = 0.02 * np.random.default_rng(0).standard_normal((13, 13)) * (np.arange(13) < 8)[:, None]
    P = np.asarray(first.P) + (A @ A.T if sure else 0)
    P = P if not sure else P - np.diag(np.r_[np.diag(np.asarray(first.P))[:8] - 1e-4, np.zeros(5)])
    x = jnp.zeros(13).at[jnp.array([0, 3, 4])].set(jnp.array([0.4, 0.3, -0.2]))
    return jax.tree.map(jnp.asarray, replace(first, x=x, P=P))


def ranges(off=(0.0, 0.0, 0.0, 0.0)):
    place = np.array([0.3 + 0.2 * np.cos(0.4), -0.2 + 0.2 * np.sin(0.4)])
    g = unit_geometry(FORM, 0)
    return np.array([float(predict_range(b, place, g.down, cone=True).range) for b in np.asarray(g.beacons)]) + off


def least(P):
    return np.linalg.eigvalsh(np.asarray(P)).min()


@pytest.mark.thorough
def test_moved_beacon_is_excluded_then_restored():
    n, seen = node(), []
    for k in range(70):
        n = _tracked(n, ranges((0.0, 0.0, 0.5 if k < 12 else 0.0, 0.0)))
        assert least(n.P) > 0
        seen.append(bool(n.position_fix.moved[2]))
    first, last = seen.index(True), len(seen) - seen[::-1].index(True)
    assert first == 7  # the eighth in a row
    assert last == 51  # forty that fit
    assert float(n.P[11, 11]) == pytest.approx(0.005**2, rel=0.01)
    assert n.position_fix.tracking


@pytest.mark.thorough
def test_contradiction_by_most_beacons_ends_tracking():
    n = node()
    for _ in range(8):
        assert n.position_fix.tracking
        n = _tracked(n, ranges((0.7, -0.5, 0.6, 0.0)))
    assert not n.position_fix.tracking
    np.testing.assert_allclose(np.diag(n.P)[:5], np.asarray(FORM.start.variances())[:5])
    np.testing.assert_array_equal(np.asarray(n.P)[:5, 5:], 0.0)
    assert least(n.P) > 0


@pytest.mark.thorough
def test_ranges_must_be_consistent_while_covariance_is_large():
    agree, place, good = _agreeing(node(sure=False), ranges())
    assert good
    assert list(np.asarray(agree)) == [True] * 4
    np.testing.assert_allclose(place, [0.3 + 0.2 * np.cos(0.4), -0.2 + 0.2 * np.sin(0.4)], atol=1e-4)
    agree, _, good = _agreeing(node(sure=False), ranges((0.0, 1.5, 0.0, 0.0)))
    assert good
    assert list(np.asarray(agree)) == [True, False, True, True]
    agree, _, good = _agreeing(node(sure=False), ranges((0.8, -0.7, 0.0, 0.0)))
    assert not good
    assert not np.asarray(agree).any()


def test_correction_mask_selects_the_observable_states():
    """Two units: all but the beacons' errors. One unit at rest: neither heading nor gyro bias."""
    assert list(np.asarray(correction_mask(FORM, node()))) == [1] * 9 + [0] * 4
    one = replace(FORM, units=PAIR[:1])
    assert list(np.asarray(correction_mask(one, node()))) == [0, 1, 1, 1, 1, 0, 1, 1, 1] + [0] * 4
    pushed = replace(node(), steady=np.array([30.0, 0.0]))
    assert list(np.asarray(correction_mask(one, pushed))) == [1] * 9 + [0] * 4


def test_scale_variance_grows_linearly_with_time():
    """Its variance grows by scale_walk^2 for each second, in steps of any length."""
    wandering = replace(FORM, errors=replace(FORM.errors, scale_walk=1e-2))
    propagate = jax.jit(lambda n, dt: wandering.propagate(n, dt, jnp.zeros(3), jnp.zeros(2)))
    start = node()
    once, often = propagate(start, 0.5), start
    for _ in range(5):
        often = propagate(often, 0.1)
    grown = float(once.P[8, 8] - start.P[8, 8])
    assert grown == pytest.approx(0.5e-4, rel=1e-9)
    assert float(often.P[8, 8] - start.P[8, 8]) == pytest.approx(grown, rel=1e-9)
    np.testing.assert_array_equal(np.diag(once.P)[9:], np.diag(start.P)[9:])


def test_tree_where_selects_complete_trees():
    assert tree_where(np.bool_(True), {"a": 1.0}, {"a": 2.0})["a"] == 1.0


@pytest.mark.thorough
def test_ping_update_lowers_to_generated_c():
    assert lower_function(lambda n, z: update_running(FORM, n, z, 0, YES), (node(), ranges())).text("f")

"""Late and disordered measurements against a plain filter that gets them sorted."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.core.record import quantity, record, replace
from trimtab.estimators.inertial import measurement_history as ring
from trimtab.estimators.inertial.feedback import AidedInertialFeedback
from trimtab.estimators.inertial.measurement_history import HEADING, IMU, POSITION, Event
from trimtab.estimators.inertial.mechanisation import InertialStart
from trimtab.estimators.inertial.sensor_watch import NEVER

TICK = 65536


@record
class Node:
    """Rate-driven angle and a drifting position, one scalar filter each. Source: this test."""

    t: Any = quantity("100 ns", "Time.", kind="time")
    imu_reading: Any = quantity("1", "IMU.", shape=(3,))
    untrusted: Any = quantity("1", "Doubt.", shape=(2,))
    x: Any = quantity("1", "Angle, position.", shape=(2,))
    P: Any = quantity("1", "Variances.", shape=(2,))


class Toy:
    """A linear filter small enough to be written twice."""

    intake = SimpleNamespace(heading="heading", position="position")
    AIDED_BY = "positions"

    def first(self):
        return Node(np.int64(NEVER), np.zeros(3), np.zeros(2), np.zeros(2), np.ones(2))

    def propagate(self, node, dt, imu_reading, untrusted):
        x = node.x + dt / 2 * (node.imu_reading[:2] + imu_reading[:2])
        return replace(node, imu_reading=imu_reading, x=x, P=node.P + 0.3 * dt * (1 + untrusted))

    def correct_heading(self, node, z, variance):
        return self._correct(node, 0, z)

    def correct_position(self, node, z, variance):
        return self._correct(node, 1, z[0])

    def _correct(self, node, i, z):
        on = jnp.arange(2) == i
        K = node.P / (node.P + 0.01)
        return replace(
            node, x=jnp.where(on, node.x + K * (z - node.x), node.x), P=jnp.where(on, node.P * (1 - K), node.P)
        )


FORM = Toy()


@jax.jit
def take(h, t, kind, value, untrusted):
    """One event of any kind; whether it was used."""

    def one(k):
        event = Event(t, k, value, untrusted)
        reached = ring.newest_imu_index(h)
        put, now, late, known = ring.enter_event(h, reached, event)
        new, node = ring.replay_events(FORM, put, now)
        return new, node, ~late & ~known

    return jax.lax.switch(kind - 1, [lambda: one(IMU), lambda: one(HEADING), lambda: one(POSITION)])


def play(events, slots=32):
    """The node after all events, in the order in which they come, and which of them were used."""
    h = jax.tree.map(jnp.asarray, ring.empty_history(FORM.first(), slots))
    node, used = FORM.first(), []
    for t, kind, value, *untrusted in events:
        value = np.resize(np.append(value, np.zeros(5)), 5)
        h, node, use = take(
            h, np.int64(t), np.int32(kind), value, np.asarray(untrusted[0] if untrusted else np.zeros(2), float)
        )
        used.append(bool(use))
    return node, used, h


def plain(events):
    """Sorted, with the IMU interpolated by numpy; up to the newest IMU sample."""
    events = sorted(events, key=lambda e: (e[0], e[1] != IMU))
    times = np.array([e[0] for e in events if e[1] == IMU])
    imu_reading = np.array([e[2] for e in events if e[1] == IMU])
    x, P, last = np.zeros(2), np.ones(2), times[0]
    for t, kind, value, *_ in events:
        if not times[0] <= t <= times[-1]:
            continue
        now, before = (np.array([np.interp(s, times, imu_reading[:, j]) for j in range(2)]) for s in (t, last))
        dt = (t - last) * 1e-7
        x, P, last = x + dt / 2 * (before + now), P + 0.3 * dt, t
        if kind != IMU:
            i = kind - HEADING
            K = P[i] / (P[i] + 0.01)
            x[i], P[i] = x[i] + K * (value[0] - x[i]), P[i] * (1 - K)
    return x, P


def flight(seed, n=24):
    g = np.random.default_rng(seed)
    imu = [(k * TICK, IMU, g.standard_normal(3)) for k in range(n)]
    headings = [(k * TICK, HEADING, g.standard_normal(1)) for k in range(0, n, 3)]
    positions = [(int(t), POSITION, g.standard_normal(2)) for t in g.integers(TICK, (n - 1) * TICK, 5)]
    return imu, headings, positions


@pytest.mark.thorough
def test_inertial_increment_excludes_the_jump_of_a_fix():
    """Feedback form started with a velocity. A fix between the two times moves the position, not the increment."""
    form = AidedInertialFeedback(start=InertialStart(velocity_north=0.5, velocity_east=-0.2))
    h = jax.tree.map(jnp.asarray, ring.empty_history(form.first(), 32))
    rate = 0.3
    events = [(k * TICK, IMU, np.array([rate, 0.0, 0.0, 0.0, 0.0])) for k in range(20)]
    fixes = [(0, HEADING, np.zeros(5)), (10 * TICK - 9, POSITION, np.array([0.4, 0.0, 1e-6, 0.0, 1e-6]))]
    enter = {
        k: jax.jit(lambda h, t, v, k=k: _take(form, h, Event(t, k, v, np.zeros(2)))) for k in (IMU, HEADING, POSITION)
    }
    for t, kind, value in sorted(events + fixes, key=lambda e: e[0]):
        h = enter[kind](h, np.int64(t), value)
    begin, end = np.int64(5 * TICK + 1234), np.int64(18 * TICK + 4321)
    seconds = (int(end) - int(begin)) * 1e-7
    increment = jax.jit(lambda *between: ring.inertial_increment(form, h, *between))
    moved, turned = increment(begin, end)
    before = jax.jit(ring.node_before)
    nodes = [before(h, t) for t in (begin, end)]
    assert turned == pytest.approx(rate * seconds, rel=1e-9)
    assert np.linalg.norm(nodes[1].position - nodes[0].position) > 0.1  # the fix was believed
    speeds = [np.asarray(before(h, np.int64(t)).velocity) for t in range(int(begin), int(end), 5000)]
    np.testing.assert_allclose(moved, np.mean(speeds, axis=0) * seconds, atol=2e-3)
    nothing, none = increment(end, end)
    assert not np.any(nothing)
    assert none == 0


def _take(form, h, event):
    put, now, *_ = ring.enter_event(h, ring.newest_imu_index(h), event)
    return ring.replay_events(form, put, now)[0]


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(4))
def test_late_and_unordered_measurements_match_sorted_filter(seed):
    """Positions come up to 15 samples late, in any order; the result is the sorted filter's (1e-9)."""
    imu, headings, positions = flight(seed)
    g = np.random.default_rng(100 + seed)
    arrivals = [(e[0], 0, e) for e in imu] + [(e[0], 1, e) for e in headings]
    arrivals += [(e[0] + int(g.integers(0, 15 * TICK)), 2, e) for e in positions]
    come = [e for *_, e in sorted(arrivals, key=lambda a: a[:2])]
    assert come != sorted(come, key=lambda e: e[0])
    node, used, h = play(come, slots=64)
    assert all(used)
    x, P = plain(come)
    np.testing.assert_allclose(node.x, x, atol=1e-9)
    np.testing.assert_allclose(node.P, P, rtol=1e-9)
    order = (np.arange(64) + int(h.head)) % 64
    assert (np.diff(np.asarray(h.t)[order]) >= 0).all()
    in_time, *_ = play(sorted(come, key=lambda e: (e[0], e[1])), slots=64)
    np.testing.assert_allclose(node.x, in_time.x, atol=1e-12)


@pytest.mark.thorough
def test_aiding_measurement_waits_for_the_imu():
    imu, *_ = flight(9, n=4)
    early = [(int(2.5 * TICK), POSITION, np.array([3.0, 0.0])), (int(2.2 * TICK), HEADING, np.array([1.0]))]
    waiting, *_ = play([*imu[:3], *early])
    np.testing.assert_allclose(waiting.x, plain(imu[:3])[0], atol=1e-12)  # nothing yet
    node, used, _ = play([*imu[:3], *early, imu[3]])
    assert all(used)
    x, P = plain([*imu, *early])
    np.testing.assert_allclose(node.x, x, atol=1e-12)
    np.testing.assert_allclose(node.P, P, rtol=1e-12)


@pytest.mark.thorough
def test_rejects_events_older_than_the_history():
    imu, *_ = flight(10, n=20)
    node, used, _ = play([*imu, (2 * TICK, POSITION, np.ones(2))], slots=8)
    assert not used[-1]
    np.testing.assert_allclose(node.x, plain(imu)[0], atol=1e-12)
    _, used, _ = play([(0, POSITION, np.ones(2)), *imu[1:3], (TICK // 2, HEADING, np.ones(1))], slots=8)
    assert used == [False, True, True, False]


@pytest.mark.thorough
def test_duplicate_event_is_used_once():
    imu, *_ = flight(11, n=6)
    fix = (2 * TICK, POSITION, np.ones(2))
    node, used, _ = play([*imu, fix, fix])
    assert used[-2:] == [True, False]
    np.testing.assert_allclose(node.x, plain([*imu, fix])[0], atol=1e-12)


@pytest.mark.thorough
def test_excess_fixes_do_not_evict_the_last_state():
    """Ten times more fixes than slots while the IMU is silent: those that fit wait, and the IMU still gets in."""
    imu, *_ = flight(12, n=3)
    fixes = [(2 * TICK + 1000 * k, POSITION, np.array([k / 80, 0.0])) for k in range(1, 81)]
    node, used, _ = play([*imu, *fixes, (4 * TICK, IMU, np.ones(3))], slots=8)
    assert used[-1]
    assert 0 < sum(used[3:-1]) < 8
    kept = [f for f, u in zip(fixes, used[3:-1], strict=True) if u]
    np.testing.assert_allclose(node.x, plain([*imu, *kept, (4 * TICK, IMU, np.ones(3))])[0], atol=1e-12)


def test_untrusted_sample_affects_both_adjacent_intervals():
    doubtful = np.array([1.0, 1.0])
    node, *_ = play([(0, IMU, np.zeros(3)), (TICK, IMU, np.zeros(3), doubtful), (2 * TICK, IMU, np.zeros(3))])
    np.testing.assert_allclose(node.P, 1 + 2 * 0.3 * 2 * TICK * 1e-7, rtol=1e-12)
    node, *_ = play([(k * TICK, IMU, np.zeros(3), doubtful * (k == 1)) for k in range(4)])
    np.testing.assert_allclose(node.P, 1 + 0.3 * (2 * 2 + 1) * TICK * 1e-7, rtol=1e-12)


@pytest.mark.thorough
def test_history_lowers_to_generated_c():
    h = ring.empty_history(FORM.first(), 8)
    assert lower_function(lambda h, r: ring.replay_events(FORM, h, r), (h, np.int32(3))).text("f")
    event = Event(np.int64(5), POSITION, np.zeros(3), np.zeros(2))
    assert lower_function(lambda h, r: ring.insert_event(h, r, event), (h, np.int32(3))).text("f")

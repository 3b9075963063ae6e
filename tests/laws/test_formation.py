"""A craft of a formation: its place, the leader's route, and a decentralised command."""

import jax
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import Estimate, Peers, PeerView
from trimtab.core.time import NEVER, ms, to_seconds
from trimtab.laws.formation import Formation
from trimtab.laws.separation import Separation
from trimtab.loop.swarm import Each
from trimtab.sensors.planar_pose import PlanarPoseState

STEP = ms(20)
ALONE = Formation(number=np.int32(1), north=8.0, east=-6.0, waiting_distance=1e6)
QUICK = replace(ALONE, separation=Separation(distance=0.5, speed=3.0))
"""Whom the barrier leaves alone."""


def view(own, stamps, points, velocities=None):
    """Return an estimate from a place (2,) and messages."""
    points = np.asarray(points, float)
    velocities = np.zeros_like(points) if velocities is None else np.asarray(velocities, float)
    state = PlanarPoseState(0.0, 0.0, 0.0, 0.0, *own)
    return PeerView(state, Peers((np.asarray(stamps, np.int64), *points.T, *velocities.T)))


def estimate(t, state):
    return Estimate(t=np.int64(t), age=0.0, fresh=True, valid=True, state=state)


def follow(law, lead, lateness, seconds):
    """Return the distance to the place over time (n,), behind a leader at lead(t) -> place, velocity."""
    state, ways, step = law.init(None), [], jax.jit(law.step)
    for k in range(round(seconds / 0.02)):
        t = k * STEP
        stamp = max(t - lateness, 0)
        place, velocity = lead(to_seconds(stamp))
        q = (float(state.north), float(state.east)) if k else (5.0, -2.0)
        state, _ = step(np.int64(t), state, estimate(t, view(q, [stamp, t], [place, [50, 50]], [velocity, [0, 0]])))
        north, east = lead(to_seconds(t))[0]
        ways.append(np.hypot(north + law.north - state.north, east + law.east - state.east))
    return np.array(ways)


@pytest.mark.thorough
@pytest.mark.parametrize("lateness", [0, ms(700)])
def test_position_error_decays_behind_a_steady_leader_despite_delay(lateness):
    def lead(t):
        return np.array([0.1 * t, -0.05 * t]), np.array([0.1, -0.05])

    ways = follow(QUICK, lead, lateness, 30)
    per_step = 1 - QUICK.k * 0.02
    first = 100
    np.testing.assert_allclose(
        ways[first:], ways[first] * per_step ** np.arange(len(ways) - first), rtol=0.03, atol=3e-3
    )


@pytest.mark.thorough
def test_error_behind_a_circling_leader_stays_within_documented_bound():
    pace, radius, age = 0.1, 4.0, 0.5

    def lead(t):
        a = pace / radius * t
        return radius * np.array([np.cos(a), np.sin(a)]), pace * np.array([-np.sin(a), np.cos(a)])

    late = follow(QUICK, lead, ms(500), 60)[-500:]
    bound = pace**2 / radius * age * (1 / QUICK.k + age / 2)
    assert 0.3 * bound < late.max() <= 1.05 * bound


@pytest.mark.thorough
def test_leader_circles_and_sends_its_reference_point():
    law = Formation(radius=3.0, leader_speed=0.15)
    state, step = law.init(None), jax.jit(law.step)
    for k in range(3000):
        t = k * STEP
        q = (float(state.north), float(state.east)) if k else (3.0, 0.0)
        state, out = step(np.int64(t), state, estimate(t, view(q, [NEVER], [[0, 0]])))
        if k % 500 == 499 and k > 1500:
            angle = law.leader_speed / law.radius * to_seconds(t)
            aim = 3.0 * np.array([np.cos(angle), np.sin(angle)])
            np.testing.assert_allclose([out.demand.message.north, out.demand.message.east], aim, atol=0.01)
            assert out.demand.message.t == t


@pytest.mark.thorough
def test_leader_waits_for_all_messages_and_for_lagging_craft():
    law = replace(ALONE, waiting_distance=0.5)
    state, _ = law.step(np.int64(0), law.init(None), estimate(0, view((1, 1), [NEVER, NEVER], np.zeros((2, 2)))))
    silent, _ = law.step(np.int64(STEP), state, estimate(STEP, view((1, 1), [NEVER, STEP], np.zeros((2, 2)))))
    assert (silent.north, silent.east) == (1 + law.model.percussion_arm, 1)
    heard = view((1.6, 1), [STEP, STEP], [[9, 9], [0, 0]])
    lagging, out = law.step(np.int64(STEP), state, estimate(STEP, heard))
    assert (lagging.north, lagging.east) == (silent.north, silent.east)
    assert out.point_error == pytest.approx(0.6)


@pytest.mark.thorough
def test_command_depends_only_on_own_estimate_and_messages():
    """The derivative of the demands by estimates and messages is block diagonal, one block per craft."""
    n, rng = 4, np.random.default_rng(5)
    law = Each(replace(ALONE, number=np.arange(n, dtype=np.int32)), n, ("number",))
    state = law.init(key(0))
    where = rng.uniform(-9, 9, (2, n))
    own = PlanarPoseState(*rng.normal(0, 0.3, (4, n)), *where)
    tables = tuple(rng.uniform(-9, 9, (4, n, n)))
    stamps = np.full((n, n), ms(900))

    def demand(own, tables):
        given = estimate(ms(1000), PeerView(own, Peers((stamps, *tables))))
        _, out = law.step(np.int64(ms(1000)), state, given)
        return jax.numpy.stack(
            [out.demand.act.FX, out.demand.act.FY, out.demand.message.north, out.demand.message.east]
        )

    by_own, by_tables = jax.jacobian(demand, argnums=(0, 1))(own, tables)
    seen = 0
    for slopes in [*jax.tree.leaves(by_own), *by_tables]:  # (demand, craft, craft, …)
        for i in range(n):
            others = [j for j in range(n) if j != i]
            assert not np.asarray(slopes)[:, i, others].any(), "a command depends on another craft's own estimate"
            seen += np.asarray(slopes)[:, i, i].any()
    assert seen > 5 * n


def test_rejects_a_leader_faster_than_its_followers():
    with pytest.raises(InputError, match=r"must be below separation\.speed"):
        Formation(leader_speed=0.4).check()

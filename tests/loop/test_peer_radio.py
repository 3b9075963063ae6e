"""The radio of a swarm: slots, delay, losses, and held messages."""

import jax
import numpy as np
import pytest

from trimtab.core.rng import key
from trimtab.core.signals import Motion, PeerMessage, SwarmMotion
from trimtab.core.time import NEVER, ms
from trimtab.loop.peer_radio import Arena, PeerRadio, PerfectSwarmNavigation, SwarmNavigation
from trimtab.loop.swarm import Each
from trimtab.sensors.planar_pose import PlanarPose


def listen(radio, slots, speaks=lambda k: True):
    """Return the received stamps (slot, receiver, sender); in slot k every craft sends stamp k or is silent."""
    step, state, heard = jax.jit(radio.step), radio.init(key(1)), []
    for k in range(slots):
        stamp = k if speaks(k) else NEVER
        say = PeerMessage(np.full(radio.count, stamp), *np.full((4, radio.count), float(k)))
        state, peers = step(np.int64(k * radio.slot), state, say)
        heard.append(np.asarray(peers.messages[0]))
        known = heard[-1] != NEVER
        np.testing.assert_array_equal(np.asarray(peers.messages[1])[known], heard[-1][known])
    return np.array(heard)


@pytest.mark.thorough("1")
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_messages_are_sent_in_slots_and_received_after_the_delay(delay):
    n = 4
    heard = listen(PeerRadio(count=n, delay=delay, loss=0.0), 20)
    for k in range(20):
        for receiver in range(n):
            for sender in range(n):
                spoken = [s for s in range(k - delay + 1) if s % n == sender and sender != receiver]
                assert heard[k, receiver, sender] == (spoken[-1] if spoken else NEVER)


@pytest.mark.thorough
def test_message_interval_grows_with_the_number_of_craft():
    for n in (3, 12):
        heard = listen(PeerRadio(count=n, delay=0, loss=0.0), 5 * n)
        fresh = np.flatnonzero(np.diff(heard[:, 0, 1]))
        np.testing.assert_array_equal(np.diff(fresh), n)


@pytest.mark.thorough
def test_loss_rate_matches_and_losses_are_independent_per_receiver():
    n, slots, loss = 5, 4000, 0.3
    heard = listen(PeerRadio(count=n, delay=2, loss=loss), slots)
    came = np.array([[[heard[k, r, (k - 2) % n] == k - 2] for r in range(n)] for k in range(2, slots)])[..., 0]
    others = np.array([[r != (k - 2) % n for r in range(n)] for k in range(2, slots)])
    assert came[others].mean() == pytest.approx(1 - loss, abs=4 * np.sqrt(loss * (1 - loss) / others.sum()))
    assert not came[~others].any(), "somebody heard itself"
    pairs = came[:, :2][others[:, 0] & others[:, 1]]
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(len(pairs))


def test_last_message_is_held_through_losses_and_silence():
    n = 3
    assert (listen(PeerRadio(count=n, delay=1, loss=1.0), 12) == NEVER).all()
    heard = listen(PeerRadio(count=n, delay=0, loss=0.0), 12, speaks=lambda k: k < 6)
    np.testing.assert_array_equal(heard[11], heard[5])


def motion(north, east):
    n = len(north)
    zero = np.zeros((n, 3))
    place = np.stack([north, east, np.zeros(n)], axis=1)
    each = Motion(np.zeros(n, np.int64), place, zero, zero, zero, zero, zero)
    return SwarmMotion(each, PeerMessage(np.arange(n), np.arange(n) * 1.0, *np.zeros((3, n))))


def test_perfect_navigation_gives_all_messages_without_delay():
    sensor = PerfectSwarmNavigation(Each(PlanarPose(), 3))
    _, sample = sensor.step(np.int64(0), sensor.init(key(0)), motion([1.0, 2.0, 3.0], [0.0, 0.0, 5.0]))
    np.testing.assert_array_equal(sample.value.peers.messages[1], [[0, 1, 2]] * 3)
    np.testing.assert_array_equal(sample.value.own.east, [0, 0, 5])


def test_navigation_period_equals_the_radio_slot():
    radio = PeerRadio(count=3, slot=ms(7))
    assert SwarmNavigation(Each(PlanarPose(), 3), radio).period == ms(7)


def test_arena_measures_smallest_spacing_and_largest_formation_error():
    arena = Arena(north=np.array([0.0, 2.0, 0.0]), east=np.array([0.0, 0.0, 3.0]))
    seen = arena.measure(motion([1.0, 3.0, 1.0], [1.0, 1.0, 4.5]))
    assert seen.spacing == pytest.approx(2.0)
    assert seen.formation_error == pytest.approx(0.5)

"""Losses counted from sequence numbers, for senders that number their packets and senders that do not."""

import random

import pytest
from flight.mavlink.line import KEY

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.losses import SequenceGaps


def count(numbers):
    """Count lost and disordered frames for these sequence numbers, taken modulo 256."""
    gaps, lost, disordered = SequenceGaps(), 0, 0
    for number in numbers:
        more, jumps = gaps.follow(number & 0xFF)
        lost, disordered = lost + more, disordered + jumps
    return lost, disordered


def test_random_sequence_numbers_are_not_counted_as_losses():
    """Regression: 32 lost frames were counted for each frame received."""
    draw = random.Random(1)
    lost, disordered = count(draw.randrange(256) for _ in range(10_000))
    assert lost < 100
    assert disordered > 6_000


def test_two_senders_with_one_identity_cause_no_losses():
    for ahead in (40, 100, 200):
        lost, disordered = count(n for k in range(5_000) for n in (k, k + ahead))
        assert lost == 0
        assert disordered > 4_000 or ahead == 200  # the one behind is taken for one that comes late


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.8])
def test_losses_of_a_bad_link_are_counted(share):
    draw = random.Random(2)
    come = [k for k in range(20_000) if draw.random() >= share]
    lost, disordered = count(come)
    between = come[-1] - come[0] + 1 - len(come)
    assert lost == pytest.approx(between, abs=30)
    assert lost <= between
    assert disordered == 0


def test_burst_loss_counts_after_frames_resume_in_order():
    assert count([*range(10), *range(100, 103)]) == (0, 0)
    assert count([*range(10), *range(100, 110)]) == (90, 0)


@pytest.mark.parametrize("gap", [90, 128, 150, 220, 240])
def test_long_burst_losses_are_counted_at_any_length(gap):
    """Regression: after a gap of 128 or more, frames were taken for late ones."""
    assert count([*range(10), 11, *range(12 + gap, 12 + gap + 40)]) == (1 + gap, 0)


@pytest.mark.parametrize("last", [20, 50, 100, 150, 200, 240])
@pytest.mark.parametrize("first", [0, 2])
def test_sender_restart_is_not_counted_as_loss(last, first):
    """Frames of the restarted sender are numbered from 0. Regression: up to 235 of 256 frames were counted as lost."""
    lost, disordered = count([*range(last - 19, last + 1), *range(first, first + 100)])
    assert lost == (15 + first if last == 240 else 0)  # the few numbers up to the end of the count look like a gap
    assert disordered == 0


def test_late_or_duplicate_frames_are_not_losses():
    assert count([*range(10), 11, 10, *range(12, 30)]) == (0, 0)
    assert count([*range(10), 9, *range(10, 30)]) == (0, 0)


def test_two_signing_streams_of_one_identity_cause_no_losses(dialect, clock):
    """During a takeover two autopilots send. Regression: the second was refused for 90 % of lost frames."""
    first, second = (Endpoint(dialect, 1, 191, KEY, link=link, clock=clock) for link in (3, 8))
    vehicle = Endpoint(dialect, 1, 1, KEY, clock=clock)
    clock.now += 1
    for _ in range(37):
        first.pack("HEARTBEAT")
    for k in range(300):
        vehicle.feed(first.pack("HEARTBEAT"))
        if k % 7 == 0:
            vehicle.feed(second.pack("HEARTBEAT"))
    assert vehicle.counts.accepted == 343
    assert (vehicle.counts.lost, vehicle.counts.disordered) == (0, 0)

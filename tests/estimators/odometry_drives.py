"""Drives of a vehicle on wheels among four beacons, with exactly the errors that its filter assumes. NumPy only."""

from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import quantity, record
from trimtab.core.signals import Frame, Sample

BEACONS = np.array([[-20.0, -15.0, -2.0], [18.0, -20.0, -1.0], [22.0, 19.0, -3.0], [-16.0, 21.0, -2.0]])
DRIVE = 1200
"""Steps of a drive, each a tenth of a second."""
TICKS = 1_000_000


@record
class DrivenWay:
    """Source: this test."""

    distance: Any = quantity("m", "Way.")
    turn: Any = quantity("rad", "Angle.", kind="angle")


@record
class RadioRanges:
    """Source: this test."""

    range: Any = quantity("m", "Ranges (n,).")
    arrived: Any = quantity("1", "Which came.", kind="flag")


class Drive(NamedTuple):
    """Truth (n,) and what was measured: odometry since the begin (n,), ranges (n, 4), how late each row's are (s)."""

    heading: Any
    north: Any
    east: Any
    distance: Any
    turn: Any
    range: Any
    arrived: Any
    ahead: Any


def drive(seed: int) -> Drive:
    """Two minutes at 1.5 m/s in loops; a range each 0.4 s, to one beacon after the other, between two odometries."""
    rng, dt, n = np.random.default_rng(seed), 0.1, DRIVE
    t = dt * np.arange(n)
    rate = 0.25 * np.sin(0.11 * t) + 0.2
    speed = 1.5 + 0.3 * np.sin(0.3 * t)
    bias = 5e-3 * rng.standard_normal() + np.cumsum(1e-4 * np.sqrt(dt) * rng.standard_normal(n))
    course, scale, errors = (
        0.03 * rng.standard_normal(),
        0.05 + 0.02 * rng.standard_normal(),
        0.1 * rng.standard_normal(4),
    )
    heading = np.empty(n)
    place = np.empty((n, 2))
    heading[0] = 0.3 + 0.05 * rng.standard_normal()
    place[0] = [1.0, -2.0] + 0.3 * rng.standard_normal(2)
    turns = np.zeros(n)
    for k in range(1, n):
        turns[k] = rate[k] * dt
        true = turns[k] - bias[k] * dt + 3e-3 * np.sqrt(dt) * rng.standard_normal()
        c, way = heading[k - 1] + course + true / 2, speed[k] * dt
        heading[k] = heading[k - 1] + true
        slip = 0.05 * np.sqrt(way) * rng.standard_normal(2)
        place[k] = place[k - 1] + way * np.array([np.cos(c), np.sin(c)]) + slip
    arrived = np.zeros((n, 4), bool)
    arrived[np.arange(4, n, 4), (np.arange(4, n, 4) // 4) % 4] = True
    ahead = np.where(arrived.any(axis=1), 0.05, 0.0)
    c = heading + course + rate * ahead / 2
    antenna = place + (speed * ahead)[:, None] * np.stack([np.cos(c), np.sin(c)], axis=1)
    away = antenna[:, None] - BEACONS[None, :, :2]
    exact = np.sqrt(np.sum(away**2, axis=2) + BEACONS[:, 2] ** 2)
    measured = (1 + scale) * exact + errors + 0.2 * rng.standard_normal(exact.shape)
    way = np.concatenate([[0.0], np.cumsum(speed[1:] * dt)])
    return Drive(
        heading, place[:, 0], place[:, 1], way, np.cumsum(turns), np.where(arrived, measured, 0.0), arrived, ahead
    )


def frames_of(world: Drive) -> Frame:
    """The drive as frames with a leading axis: odometry at each step, a range a little after it."""
    k = np.arange(DRIVE, dtype=np.int64)
    ranged = world.arrived.any(axis=1)
    newest = np.maximum.accumulate(np.where(ranged, k, 0))
    true = np.ones(DRIVE, bool)
    late = np.round(world.ahead * 1e7).astype(np.int64)
    way = Sample(DrivenWay(world.distance, world.turn), k * TICKS, np.zeros(DRIVE), true, true)
    value = RadioRanges(world.range[newest], world.arrived[newest])
    ranges = Sample(value, (k * TICKS + late)[newest], np.zeros(DRIVE), ranged, newest > 0)
    return Frame(t=k * TICKS + late, samples={"odometry": way, "ranging": ranges})

"""Filters of the study and their noise parameters. Most are tuned on the other log, a few are not tuned."""

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from studies.ranges2009._data import OTHER, Plaza, read_plaza
from studies.ranges2009._odometry_lag import LaggedOdometry
from studies.ranges2009._odometry_particle import OdometryParticle
from trimtab.estimators.ranging.odometry import OdometryNoise, OdometryRanging, PlanarStart, RadioErrors

TUNED = Path(__file__).parent / "tuned.json"
BEFORE = {"slip": 0.05, "noise": 0.5}
"""Initial parameters of the tuning."""
TURN, SIGMA_TURN_BIAS, SIGMA_COURSE, SIGMA_SCALE, SIGMA_ERROR = 1e-3, 0.01, 0.02, 0.01, 0.1
"""Parameters that are not tuned, for a small gyro and a careful survey: heading noise (rad/sqrt(s)), and standard
deviations of the turn's bias (rad/s), of the axis relative to the course (rad), of the scale relative to the other
log's, and of a radio's error (m).
"""

START_SIGMA = 2.0
"""Standard deviation of a position from two ranges (m). The scale error alone is 1 % of 80 m."""


@functools.cache
def read_tuned() -> dict[str, dict[str, float]]:
    """Return the parameters tuned on each log, by its name, from ``python -m studies.ranges2009.tune``."""
    return json.loads(TUNED.read_text(encoding="utf-8"))


def assumed_on(name: str) -> dict[str, float]:
    """Return the filter parameters for a log, tuned on the other log."""
    return read_tuned()[OTHER[name]]


def odometry_filter(p: Plaza, assumed: dict[str, Any], scale: Any) -> OdometryRanging:
    """Return the tightly coupled filter, started at the first true pose. assumed: parameters named as in BEFORE."""
    start = PlanarStart(
        heading=p.heading[0],
        north=p.north[0],
        east=p.east[0],
        sigma_turn_bias=SIGMA_TURN_BIAS,
        sigma_course=SIGMA_COURSE,
    )
    return OdometryRanging(
        noise=OdometryNoise(slip=assumed["slip"], turn=TURN),
        errors=RadioErrors(noise=assumed["noise"], scale=scale, sigma_scale=SIGMA_SCALE, sigma_error=SIGMA_ERROR),
        start=start,
        beacons=np.asarray(p.beacons),
    )


def tight_filter(name: str) -> OdometryRanging:
    """Return the tightly coupled filter for a log, tuned on the other one."""
    assumed = assumed_on(name)
    return odometry_filter(read_plaza(name), assumed, assumed["scale"])


def particle_filter(name: str) -> OdometryParticle:
    """Return the particle filter for a log, tuned on the other one, without a known start."""
    t = tight_filter(name)
    return OdometryParticle(noise=t.noise, errors=t.errors, start=t.start, beacons=t.beacons, start_sigma=START_SIGMA)


def lagged_filter(name: str) -> LaggedOdometry:
    """Return the fixed-lag form of the tightly coupled filter for a log, with an estimate that is 4 to 5 s old."""
    return LaggedOdometry(filter=tight_filter(name))


def plaza1() -> OdometryRanging:
    """Return the filter for ``trimtab replay Plaza1.mcap --estimator studies.ranges2009._filters:plaza1``."""
    return tight_filter("Plaza1")


def plaza2() -> OdometryRanging:
    """Return the filter for ``trimtab replay Plaza2.mcap --estimator studies.ranges2009._filters:plaza2``."""
    return tight_filter("Plaza2")

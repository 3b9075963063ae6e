"""Fixed-lag estimate from odometry and ranges: later measurements correct the past position.

Source: Roumeliotis, Burdick, "Stochastic cloning: a generalized framework for processing relative state measurements",
ICRA 2002, for poses kept in the state; Moore, "Discrete-time fixed-lag smoothing algorithms", Automatica 9 (1973).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import to_seconds
from trimtab.estimators.inertial.sensor_watch import NEVER
from trimtab.estimators.ranging.odometry import (
    OdometryRanging,
    OdometryState,
    drive_on,
    fuse_ranges,
    planar_estimate,
)

POSE = 3
"""Number of states of a kept pose: heading, north, east."""


@record
class LaggedState:
    """State of the filter. Source: docs page."""

    drive: OdometryState = part("State of the filter; its states are followed by the kept poses, the newest first.")
    times: Any = quantity("100 ns", "Time of each kept pose (k,).", kind="time")
    speeds: Any = quantity("m/s", "Speed of the odometry at each kept pose (k,).")
    rates: Any = quantity("rad/s", "Rate of turn of the odometry at each kept pose (k,).")


@record
class LaggedOdometry:
    """Fixed-lag smoother: `OdometryRanging` for some seconds ago, corrected by all later measurements.

    The state keeps `kept` poses. Their spacing makes the oldest between `lag` and `lag` plus one spacing old. Their
    covariances with the present state let each range correct them, too. `Estimate.age` gives the age.

    Frames:  beacons in W; level vehicle on a flat floor.
    Valid:   once the oldest pose has that age, even if ranges are rejected. Before, the estimate is the initial pose.
    Source:  Moore 1973; docs page.
    """

    filter: OdometryRanging = part("Filter that estimates the present state.", default=OdometryRanging())
    lag: Scalar = quantity("s", "Minimum age of the estimate.", default=4.0, above=0)
    kept: int = option("Number of poses kept in the state.", default=5)

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the odometry and the ranging."""
        return self.filter.listens

    def check(self) -> None:
        """Raise InputError if the filter is invalid or fewer than two poses are kept."""
        self.filter.check()
        if self.kept < 2:
            raise InputError(
                "LaggedOdometry.kept", f"kept must be at least 2 poses, got {self.kept}", fix="keep 2 or more"
            )

    def init(self, key: Key) -> LaggedState:
        """Return the initial state, before any measurement. Every kept pose is the initial pose."""
        drive = self.filter.init(key)
        copies = np.tile(np.eye(POSE, drive.x.shape[0]), (self.kept, 1))
        T = jnp.asarray(np.concatenate([np.eye(drive.x.shape[0]), copies]))
        k = self.kept
        return LaggedState(
            drive=replace(drive, x=T @ drive.x, P=T @ drive.P @ T.T),
            times=np.full(k, NEVER, np.int64),
            speeds=np.zeros(k),
            rates=np.zeros(k),
        )

    def step(self, t: Any, state: LaggedState, frame: Frame) -> tuple[LaggedState, Estimate]:
        """Return the past estimate at integer time t. Its state is a RobotNavigation with the present counters."""
        drive, came = drive_on(self.filter, state.drive, t, frame)
        s = _keep_pose(self, replace(state, drive=drive))
        drive, ranged = fuse_ranges(self.filter, s.drive, t, frame)
        s = replace(s, drive=drive)
        n = drive.x.shape[0] - POSE * self.kept
        old = np.concatenate([np.arange(drive.x.shape[0] - POSE, drive.x.shape[0]), np.arange(POSE, n)])
        pick = jnp.asarray(np.eye(drive.x.shape[0])[old])
        then = replace(drive, t=s.times[-1], speed=s.speeds[-1], rate=s.rates[-1])
        valid = (s.times[-1] > NEVER) & (to_seconds(drive.t - s.times[-1]) >= self.lag)
        return s, planar_estimate(t, then, pick @ drive.x, pick @ drive.P @ pick.T, came | ranged, valid)


def _keep_pose(form: LaggedOdometry, s: LaggedState) -> LaggedState:
    """Keep the present pose and drop the oldest, if the newest kept pose is at least one spacing old."""
    drive, size = s.drive, s.drive.x.shape[0]
    n = size - POSE * form.kept
    T = np.eye(size)
    T[n:] = 0.0
    T[n : n + POSE, :POSE] = np.eye(POSE)
    T[n + POSE :, n : size - POSE] = np.eye(size - n - POSE)
    spacing = form.lag / (form.kept - 1)
    begins = (drive.t > NEVER) & (s.times[0] == NEVER)
    due = (s.times[0] > NEVER) & (to_seconds(drive.t - s.times[0]) >= spacing)
    move = jnp.asarray(T)
    x, P = jnp.where(due, move @ drive.x, drive.x), jnp.where(due, move @ drive.P @ move.T, drive.P)

    def shift(new: Any, values: Any) -> Any:
        return jnp.where(due, jnp.concatenate([jnp.reshape(new, 1), values[:-1]]), values)

    return replace(
        s,
        drive=replace(drive, x=x, P=P),
        times=jnp.where(begins, drive.t, shift(drive.t, s.times)),
        speeds=shift(drive.speed, s.speeds),
        rates=shift(drive.rate, s.rates),
    )

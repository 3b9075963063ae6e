"""Predicted measurements of a satellite receiver at the filter's state, and their derivatives by the error states.

With a the position of the antenna, l its lever arm, R the attitude and w the angular velocity:

    a = p + R l,   a' = v + R (w × l)
    da = dp - R [l×] dtheta,    da' = dv - R [(w × l)×] dtheta + R [l×] db_gyro

The time of a measurement may be slightly before the time of the state (dt < 0, by less than a sample). The measured
position is then a + dt a', and the measured velocity is a' plus dt times the acceleration.

Source: Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections 14.3.1
(fixes, loosely coupled) and 14.3.2 (ranges, tightly coupled), with a local angular error.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from trimtab.core import quaternion
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.rotation import cross_matrix
from trimtab.estimators.inertial.error_state import (
    ATTITUDE,
    ERRORS,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Nominal,
)

FIX_NUMBERS = 6
"""Number of values in a satellite fix: position and velocity."""
RANGE_NUMBERS = 9
"""Number of values of raw ranges for each satellite: pseudorange, range rate, position, velocity, reception flag."""


@record
class GnssNoise:
    """Noise of the satellite receiver as assumed by the filter. Source: docs page, Gnss."""

    position: Scalar = quantity(
        "m", "Standard deviation of a position fix in the north and east directions.", default=0.4, above=0
    )
    position_down: Scalar = quantity(
        "m", "Standard deviation of a position fix in the down direction.", default=0.7, above=0
    )
    velocity: Scalar = quantity(
        "m/s", "Standard deviation of a velocity fix in the north and east directions.", default=0.05, above=0
    )
    velocity_down: Scalar = quantity(
        "m/s", "Standard deviation of a velocity fix in the down direction.", default=0.08, above=0
    )
    pseudorange: Scalar = quantity("m", "Standard deviation of a pseudorange.", default=0.8, above=0)
    range_rate: Scalar = quantity("m/s", "Standard deviation of a range rate.", default=0.08, above=0)
    constant: Scalar = quantity(
        "m",
        "Constant error (1 sigma) of each position coordinate. It is added to the reported uncertainty.",
        default=0.0,
        low=0,
        off={"gnss-correlated-error": 0.0},
    )


class ExpectedMeasurement(NamedTuple):
    """Prediction of a measurement.

    y: measured minus predicted (m,).  H: derivatives of the prediction by the error states (m, n).  R: variances (m,).
    wanted: True for values that can be used (m,).
    """

    y: Any
    H: Any
    R: Any
    wanted: Any


def antenna_rows(x: Nominal, dt: Any, arm: Any) -> tuple[Any, Any, Any, Any]:
    """Return position and velocity (3,) of the antenna in W, dt (s) after the state's time, and the derivatives of both
    by the error states (3, n)."""
    R, n = quaternion.to_matrix(x.attitude), x.P.shape[0]
    swing = jnp.cross(x.rate, arm)
    none, eye = jnp.zeros((3, n)), jnp.eye(3)
    lever = R @ cross_matrix(arm)
    by_place = none.at[:, POSITION].set(eye).at[:, ATTITUDE].set(-lever)
    by_velocity = none.at[:, VELOCITY].set(eye).at[:, GYRO_BIAS].set(lever)
    by_velocity = by_velocity.at[:, ATTITUDE].set(-R @ cross_matrix(swing))
    velocity = x.velocity + R @ swing
    place = x.position + R @ arm + dt * velocity
    return place, velocity + dt * x.acceleration, by_place + dt * by_velocity, by_velocity


def expect_fix(x: Nominal, value: Any, dt: Any, arm: Any, noise: GnssNoise) -> ExpectedMeasurement:
    """Return the prediction of a fix (6,): position and velocity of the antenna, dt (s) after the state's time."""
    place, velocity, by_place, by_velocity = antenna_rows(x, dt, arm)
    across, down = noise.position**2, noise.position_down**2
    along, sinking = noise.velocity**2, noise.velocity_down**2
    R = jnp.stack([jnp.asarray(v, float) for v in (across, across, down, along, along, sinking)])
    y = value - jnp.concatenate([place, velocity])
    H = jnp.concatenate([by_place, by_velocity])
    return ExpectedMeasurement(y, H, R, jnp.ones(FIX_NUMBERS, bool))


def set_clock(x: Nominal, e: ExpectedMeasurement) -> tuple[Nominal, ExpectedMeasurement]:
    """Return the state with the clock set from the mean of the first ranges and rates, and the resulting predictions.

    A receiver's clock can have any offset. If the filter estimated the offset from a correspondingly large initial
    variance, P would lose precision in the first update.
    """
    y = jnp.where(e.wanted, e.y, 0.0).reshape(2, -1)
    shown = jnp.sum(y, axis=1) / jnp.maximum(jnp.sum(e.wanted) / 2, 1.0)
    return replace(x, clock=x.clock + shown), e._replace(y=e.y - jnp.repeat(shown, y.shape[1]))


def expect_ranges(x: Nominal, value: Any, dt: Any, arm: Any, noise: GnssNoise) -> ExpectedMeasurement:
    """Return the prediction of raw ranges, dt (s) after the state's time.

    value: pseudoranges, range rates, satellite positions (n, 3), velocities (n, 3) and reception flags, (9 n,).
    """
    n = value.shape[0] // RANGE_NUMBERS
    ranges, rates, received = value[:n], value[n : 2 * n], value[8 * n :] > 0.5
    places, velocities = value[2 * n : 5 * n].reshape(n, 3), value[5 * n : 8 * n].reshape(n, 3)
    place, velocity, by_place, by_velocity = antenna_rows(x, dt, arm)
    apart, passing = places - place, velocities - velocity
    distance = jnp.sqrt(jnp.sum(apart * apart, axis=1))
    sight = apart / distance[:, None]
    approach = jnp.sum(sight * passing, axis=1)
    turning = (passing - approach[:, None] * sight) / distance[:, None]
    by_range = -sight @ by_place
    by_rate = -sight @ by_velocity - turning @ by_place
    by_range = by_range.at[:, ERRORS].set(1.0).at[:, ERRORS + 1].set(dt)
    by_rate = by_rate.at[:, ERRORS + 1].set(1.0)
    y = jnp.concatenate([ranges - distance - x.clock[0] - dt * x.clock[1], rates - approach - x.clock[1]])
    ones = jnp.ones(n)
    R = jnp.concatenate([noise.pseudorange**2 * ones, noise.range_rate**2 * ones])
    return ExpectedMeasurement(y, jnp.concatenate([by_range, by_rate]), R, jnp.concatenate([received, received]))

"""Satellite receiver that outputs raw measurements: pseudoranges, and their rates from Doppler."""

import math
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import DEG
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import ms, to_seconds
from trimtab.environment.geodetic import TangentPlane, ned_axes, to_ecef
from trimtab.sensors.gnss import ARM, FIVE_HERTZ, Outages, antenna, wander_error
from trimtab.sensors.late_fix import LateFix, LateState

ORBIT = 20_200e3
"""Height of the GPS satellites above ground (m)."""
ORBITAL_SPEED = 3_870.0
"""Speed of the GPS satellites (m/s)."""


def sky(azimuths: Any, elevations: Any, courses: Any) -> tuple[Any, Any]:
    """Return positions and velocities (n, 3) in W of satellites with these azimuths and elevations (n,) (rad).

    Each satellite is at the distance ORBIT and moves across the line of sight. courses: direction of motion in the
    plane across the line of sight, clockwise from up (rad).
    """
    az, el, course = (np.asarray(a, float)[:, None] for a in (azimuths, elevations, courses))
    sight = np.hstack([np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), -np.sin(el)])
    up = np.hstack([-np.cos(az) * np.sin(el), -np.sin(az) * np.sin(el), -np.cos(el)])
    right = np.hstack([-np.sin(az), np.cos(az), 0 * az])
    return ORBIT * sight, ORBITAL_SPEED * (np.cos(course) * up + np.sin(course) * right)


def satellites_from_ecef(plane: TangentPlane, places_E: Any, velocities_E: Any) -> tuple[Any, Any]:
    """Return satellite positions and velocities (n, 3) in W, from earth-centred, earth-fixed positions and velocities
    as in an almanac."""
    R_EW = np.asarray(ned_axes(plane.latitude, plane.longitude))
    origin = np.asarray(to_ecef(plane.latitude, plane.longitude, plane.height))
    return (np.asarray(places_E) - origin) @ R_EW, np.asarray(velocities_E) @ R_EW


AZIMUTHS = np.array([20.0, 75.0, 130.0, 170.0, 215.0, 265.0, 310.0, 350.0]) * DEG
ELEVATIONS = np.array([65.0, 25.0, 50.0, 15.0, 35.0, 70.0, 20.0, 40.0]) * DEG
COURSES = np.array([0.0, 50.0, 110.0, 160.0, 200.0, 250.0, 300.0, 340.0]) * DEG
PLACES, VELOCITIES = sky(AZIMUTHS, ELEVATIONS, COURSES)
"""Default positions and velocities (8, 3) of eight satellites above the horizon: our choice of a typical sky."""


@record
class GnssRangesReading:
    """Sample of raw satellite measurements, with the positions of the satellites. Source: docs page, Gnss."""

    pseudorange: Any = quantity(
        "m", "Pseudorange to each satellite: distance plus clock error; 0 if the satellite is not received."
    )
    range_rate: Any = quantity("m/s", "Rate of each pseudorange, from the Doppler shift.")
    received: Any = quantity("1", "True for each satellite that is received.", kind="flag")
    satellites: Any = quantity(
        "m", "Positions of the satellites as a flat list (3 n,): north, east, down of each.", frame="W"
    )
    satellite_velocities: Any = quantity(
        "m/s", "Velocities of the satellites as a flat list (3 n,): north, east, down of each.", frame="W"
    )


@record
class GnssRangesState:
    """State of the satellite receiver. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    late: LateState = part("Measurement that has been made but has not arrived yet.")
    correlated: Any = quantity("m", "Time-correlated error of each range.")
    clock: Any = quantity("1", "Clock bias (m) and drift (m/s), times the speed of light.", shape=(2,))


@record
class GnssRanges:
    """Satellite receiver that measures pseudoranges and their rates.

        rho_i  = |s_i - a| + b + e_i + w        b' = d + white, d' = white: the clock, times the speed of light
        rho'_i = u_i · (s_i' - a') + d + w'     u_i = (s_i - a)/|s_i - a|, a the antenna, e_i Gauss–Markov

    Satellites move in straight lines, s = `satellites` + `velocities` t. A real satellite is 500 m off this line after
    a minute. This does not matter, because the receiver uses the same line. In an outage only the first `remaining`
    satellites are received.

    Frames:  satellites in W (`sky`, `satellites_from_ecef`); lever arm in B.
    Not modelled: the signal's time of flight and the earth's rotation during it; cycle slips; atmosphere except in e_i.
    Source:  Groves, 2nd ed., sections 9.4.1 (observables) and 9.3.1; clock: Brown, Hwang, "Introduction to random
             signals and applied Kalman filtering", 4th ed., section 9.3 (two states), for a compensated crystal.
    """

    satellites: Any = quantity("m", "Positions of the satellites (n, 3) at time zero.", frame="W", default=PLACES)
    velocities: Any = quantity("m/s", "Velocities of the satellites (n, 3).", frame="W", default=VELOCITIES)
    noise: Scalar = imperfection(
        "m", "Standard deviation of the white noise of each pseudorange.", "gnss-noise", default=0.8
    )
    rate_noise: Scalar = imperfection(
        "m/s", "Standard deviation of the white noise of each pseudorange rate.", "gnss-noise", default=0.08
    )
    correlated: Scalar = imperfection(
        "m",
        "Standard deviation of the time-correlated error of each pseudorange.",
        "gnss-correlated-error",
        default=0.0,
    )
    correlation_time: Scalar = quantity(
        "s", "Correlation time of the time-correlated pseudorange errors.", default=100.0, above=0
    )
    clock_bias: Scalar = quantity(
        "m", "Clock bias at time zero, times the speed of light.", default=1500.0, off={"gnss-clock": 0.0}
    )
    clock_drift: Scalar = quantity(
        "m/s", "Clock drift at time zero, times the speed of light.", default=20.0, off={"gnss-clock": 0.0}
    )
    clock_noise: Scalar = imperfection(
        "m/s^0.5", "White noise density of the rate of the clock bias.", "gnss-clock", default=0.1
    )
    drift_walk: Scalar = imperfection("m/s^1.5", "Random walk density of the clock drift.", "gnss-clock", default=0.05)
    lever_arm: Any = quantity(
        "m", "Position of the antenna in B, relative to the centre of mass.", frame="B", default=ARM, shape=(3,)
    )
    timing: LateFix = part(
        "Timing of the measurements: interval, latency and time stamp.",
        default=FIVE_HERTZ,
        off={"gnss-latency": lambda sensor: replace(sensor.timing, latency=0.0)},
    )
    outages: Outages = part("Outages of satellite reception.", default=Outages())
    remaining: Scalar = quantity(
        "1", "Number of satellites that are received during an outage.", default=2, low=0, kind="count"
    )
    period: int = period("Time between checks for a new measurement.", default=ms(10))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the period would miss measurements, or the satellites' shapes are not (n, 3)."""
        self.timing.check_period(self.period)
        shape = np.shape(self.satellites)
        if len(shape) != 2 or shape[1] != 3 or np.shape(self.velocities) != shape:
            problem = f"satellites {shape} and velocities {np.shape(self.velocities)} must both have shape (n, 3)"
            raise InputError("satellites", problem, fix="give north, east, down of each satellite for both")

    def init(self, key: Key) -> GnssRangesState:
        """Return the initial state. The time-correlated errors are drawn from their stationary distribution."""
        n = np.shape(self.satellites)[0]
        none, places = np.zeros(n), np.zeros(3 * n)
        late = self.timing.initial_state(GnssRangesReading(none, none, np.zeros(n, bool), places, places))
        clock = jnp.stack([jnp.asarray(self.clock_bias, float), jnp.asarray(self.clock_drift, float)])
        first = self.correlated * normals(key.at("first"), 0, n)
        return GnssRangesState(key.at("white"), late, first, clock)

    def measure(self, motion: Motion) -> GnssRangesReading:
        """Return the measurement h(x) for the vehicle's motion, without error, with an exact clock."""
        return self._observe(motion, jnp.zeros(2), jnp.zeros(()), jnp.zeros(()))

    def step(self, t: Any, state: GnssRangesState, motion: Motion) -> tuple[GnssRangesState, Sample]:
        """Return the newest measurement that has arrived at time t (unit: 100 ns)."""
        n = np.shape(self.satellites)[0]
        w = normals(state.key, self.timing.measurement_number(t), 3 * n + 2)
        noise = state.correlated + self.noise * w[:n]
        reading = self._observe(motion, state.clock, noise, self.rate_noise * w[n : 2 * n])
        hidden = self.outages.is_blocked(t) & (jnp.arange(n) >= self.remaining)
        seen = reading.received & ~hidden
        reading = replace(
            reading,
            received=seen,
            pseudorange=jnp.where(seen, reading.pseudorange, 0.0),
            range_rate=jnp.where(seen, reading.range_rate, 0.0),
        )
        late, sample = self.timing.deliver(t, state.late, reading, received=jnp.any(seen))
        wander = wander_error(self.timing, t, state.correlated, self.correlated, self.correlation_time, w[2 * n : -2])
        return GnssRangesState(state.key, late, wander, self._run_clock(t, state.clock, w[-2:])), sample

    def _observe(self, motion: Motion, clock: Any, noise: Any, rate_noise: Any) -> GnssRangesReading:
        place, velocity = antenna(motion, self.lever_arm)
        satellites = jnp.asarray(self.satellites) + to_seconds(motion.t) * jnp.asarray(self.velocities)
        velocities = jnp.asarray(self.velocities) + jnp.zeros_like(satellites)
        apart = satellites - place
        distance = jnp.sqrt(jnp.sum(apart * apart, axis=1))
        approach = jnp.sum(apart * (velocities - velocity), axis=1) / distance
        return GnssRangesReading(
            pseudorange=distance + clock[0] + noise,
            range_rate=approach + clock[1] + rate_noise,
            received=satellites[:, 2] < place[2] - distance * math.sin(5 * DEG),
            satellites=satellites.reshape(-1),
            satellite_velocities=velocities.reshape(-1),
        )

    def _run_clock(self, t: Any, clock: Any, white: Any) -> Any:
        """Return the state of the clock after one interval if a measurement is made at time t, else unchanged."""
        dt = to_seconds(self.timing.interval)
        step = jnp.stack([self.clock_noise * white[0], self.drift_walk * white[1]]) * math.sqrt(dt)
        after = jnp.stack([clock[0] + dt * clock[1], clock[1]]) + step
        return jnp.where(self.timing.is_made(t), after, clock)

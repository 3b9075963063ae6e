"""Ultrasonic ranging in reverse, as in the older system: beacons chirp at random, and the vehicle only listens.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006; [2] N. B.
Priyantha, A. Chakraborty, H. Balakrishnan, "The Cricket location-support system", MobiCom 2000.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, period, quantity, record, replace, switch
from trimtab.core.rng import Key, uniform2
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import FOREVER, UNITS_PER_SECOND, format_time, ms, seconds, to_seconds
from trimtab.sensors.contention import CarrierSense, simulate_exchange
from trimtab.sensors.time_of_flight import (
    Beacons,
    Medium,
    RangeErrors,
    actual_positions,
    audible_beacons,
    corrupt_ranges,
    measured_range,
    responding_beacons,
    unit_position,
    unit_velocity,
)

CHIRP = 140
"""Random stream of the chirps' times."""


@record
class HeardRanges:
    """Newest range of each beacon, each with its own time. Source: [2] section 4."""

    range: Any = quantity("m", "Newest range to each beacon (n,), cone error included; 0 before the first.")
    arrived: Any = quantity("1", "True for each range that is new (n,).", kind="flag")
    measured: Any = quantity("100 ns", "Time at which each beacon chirped (n,).", kind="time")


@record
class ListeningState:
    """State of the sensor: chirps of the current window, and ranges received. Source: this module."""

    key: Key = part("Key of the random draws.")
    begins: Any = quantity("100 ns", "Time at which each beacon chirps (n,).", kind="time")
    ends: Any = quantity("100 ns", "Time at which each beacon's message ends (n,); never if it is lost.", kind="time")
    taken: Any = quantity("m", "Measured ranges whose messages have not ended yet (n,).")
    audible: Any = quantity("1", "True for each chirp received (n,).", kind="flag")
    held: HeardRanges = part("Most recent sample that was output.")
    any: Scalar = quantity("1", "True once a sample has been output.", kind="flag")


@record
class UltrasonicListening:
    """Ultrasonic unit that never sends. Each beacon chirps once per window at a random time, if the channel is free.

    Ranges arrive one by one, each for the vehicle's position at its chirp. A fix from the ranges of a window is on
    average half a window late, with an error proportional to the speed. The sample's time is that of its newest chirp.

    Frames:  beacons in W, unit in B.    Not modelled: Doppler shift; chirps of inaudible beacons.
    Source:  [2]; [1] section 5.5.6, where it is compared with pinging.
    """

    beacons: Beacons = part(
        "Beacons: positions and errors.",
        default=Beacons(),
        off={"range-noise": lambda sensor: replace(sensor.beacons, crystal=0.0)},
    )
    unit: Any = quantity("m", "Position of the unit.", default=np.zeros(3), frame="B", shape=(3,))
    channel: CarrierSense = part("Rules by which chirps share the radio channel.", default=CarrierSense())
    errors: RangeErrors = part("Errors of single ranges.", default=RangeErrors())
    medium: Medium = part("Air that carries the sound.", default=Medium())
    cone_error: bool = switch("Model the cone error: ranges measured off the beacon's axis are too long.", "cone-error")
    window: int = period("Time in which each beacon chirps once.", default=seconds(1))
    period: int = period("Time between checks for new ranges.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if the window is not a multiple of the period."""
        if self.window % self.period:
            problem = f"{format_time(self.window)} must be a multiple of the period, {format_time(self.period)}"
            raise InputError("UltrasonicListening.window", problem, fix="set period to a divisor of it, e.g. 1 ms")

    def init(self, key: Key) -> ListeningState:
        """Return the initial state, before any range."""
        n = np.shape(self.beacons.map)[0]
        never, o, no = jnp.full(n, FOREVER), jnp.zeros(n), jnp.zeros(n, np.bool_)
        none = HeardRanges(range=o, arrived=no, measured=jnp.zeros(n, np.int64))
        return ListeningState(key=key, begins=never, ends=never, taken=o, audible=no, held=none, any=np.bool_(False))

    def measure(self, motion: Motion) -> HeardRanges:
        """Return the ranges h(x) to all beacons at one time.

        The beacons are at their mapped positions. The only error is the cone error.
        """
        at, positions = unit_position(motion, self.unit), jnp.asarray(self.beacons.map)
        hears = audible_beacons(self.beacons, positions, at)
        ranges = jnp.where(hears, measured_range(positions, at[None, :], self.cone_error), 0.0)
        return HeardRanges(range=ranges, arrived=hears, measured=jnp.full(hears.shape, motion.t, np.int64))

    def chirps(self, t: Any, key: Key) -> tuple[Any, Any]:
        """Return the beacons' chirp times in the window from integer time t, and the end times of their messages (n,).

        A message that is not over when the window ends, or collides, is lost.
        """
        n, number = np.shape(self.beacons.map)[0], t // self.window
        u, _ = uniform2(key, number * n + jnp.arange(n), CHIRP)
        window, message = to_seconds(self.window), self.channel.message_bytes * self.channel.byte_time
        first = u * (window - message)
        sent = simulate_exchange(self.channel, key, number, first, jnp.ones(n, np.bool_), window)
        over = t + jnp.round(sent.end * UNITS_PER_SECOND).astype(np.int64)
        begins = over - jnp.round(message * UNITS_PER_SECOND).astype(np.int64)
        return begins, jnp.where(sent.received, over, FOREVER)

    def step(self, t: Any, state: ListeningState, motion: Motion) -> tuple[ListeningState, Sample]:
        """Return the newest ranges whose messages have ended at integer time t."""
        t = jnp.asarray(t, np.int64)
        done = state.audible & (state.ends <= t)
        held = HeardRanges(
            range=jnp.where(done, state.taken, state.held.range),
            arrived=done,
            measured=jnp.where(done, state.begins, state.held.measured),
        )
        ends = jnp.where(state.ends <= t, FOREVER, state.ends)
        begins, ends = jax.lax.cond(
            t % self.window == 0, lambda: self.chirps(t, state.key), lambda: (state.begins, ends)
        )
        now = (begins <= t) & (begins > t - self.period)
        taken, hears = self._measure_chirps(t, state.key, motion, begins)
        taken, hears = jnp.where(now, taken, state.taken), jnp.where(now, hears, state.audible)
        fresh, any_yet = jnp.any(done), state.any | jnp.any(done)
        newest = jnp.where(any_yet, jnp.max(held.measured), 0)
        state = ListeningState(state.key, begins, ends, taken, hears, held, any_yet)
        return state, Sample(value=held, t=newest, age=to_seconds(t - newest), fresh=fresh, valid=any_yet)

    def _measure_chirps(self, t: Any, key: Key, motion: Motion, begins: Any) -> tuple[Any, Any]:
        """Return ranges (n,) of chirps that began since the last step, and flags (n,) of those received."""
        ago = jnp.clip(to_seconds(t - begins), 0.0, to_seconds(self.period))
        at = unit_position(motion, self.unit) - ago[:, None] * unit_velocity(motion, self.unit)
        positions = actual_positions(self.beacons, key, t)
        number = t // self.window
        exact = measured_range(positions, at, self.cone_error)
        ranges = corrupt_ranges(exact, key, number, self.errors, self.medium, self.beacons.crystal)
        return ranges, responding_beacons(self.beacons, positions, unit_position(motion, self.unit), t)

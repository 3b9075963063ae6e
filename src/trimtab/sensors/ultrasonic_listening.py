"""The older way round: beacons chirp at random, the vehicle only listens.

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
"""Stream of the chirps' times."""


@record
class HeardRanges:
    """The newest range of each beacon, each of another time. Source: [2] section 4."""

    range: Any = quantity("m", "Newest range to each beacon (n,), cone error included; 0 before the first.")
    arrived: Any = quantity("1", "Which are new at this instant (n,).", kind="flag")
    measured: Any = quantity("100 ns", "When each beacon chirped (n,).", kind="time")


@record
class ListeningState:
    """The chirps of this window, and what has been heard. Source: this module."""

    key: Key = part("Of the draws.")
    begins: Any = quantity("100 ns", "When each beacon chirps (n,).", kind="time")
    ends: Any = quantity("100 ns", "When its message is over (n,); never where it is lost.", kind="time")
    taken: Any = quantity("m", "Ranges whose message is not over yet (n,).")
    audible: Any = quantity("1", "Whether the chirp was heard (n,).", kind="flag")
    held: HeardRanges = part("Handed out last.")
    any: Scalar = quantity("1", "Whether anything has been handed out.", kind="flag")


@record
class UltrasonicListening:
    """A unit that never sends: each beacon chirps once a window at a random time, if the channel is free.

    Ranges arrive one by one, each for where the vehicle was then. A fix from the ranges of a window is late by half of
    it on the average, and wrong in proportion to the speed. The sample's time is that of the newest chirp in it.

    Frames:  beacons in W, unit in B.    Not modelled: Doppler shift; chirps of beacons that are not heard.
    Source:  [2]; [1] section 5.5.6, where it is compared with pinging.
    """

    beacons: Beacons = part(
        "The beacons.", default=Beacons(), off={"range-noise": lambda sensor: replace(sensor.beacons, crystal=0.0)}
    )
    unit: Any = quantity("m", "Position of the unit.", default=np.zeros(3), frame="B", shape=(3,))
    channel: CarrierSense = part("How chirps share the radio channel.", default=CarrierSense())
    errors: RangeErrors = part("Errors of single ranges.", default=RangeErrors())
    medium: Medium = part("The air.", default=Medium())
    cone_error: bool = switch("Whether ranges are too long off the axis.", "cone-error")
    window: int = period("Time in which each beacon chirps once.", default=seconds(1))
    period: int = period("How often the unit looks.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Refuse windows that begin between the instants."""
        if self.window % self.period:
            problem = f"{format_time(self.window)} is not a multiple of the period, {format_time(self.period)}"
            raise InputError("UltrasonicListening.window", problem, fix="set period to a divisor of it, e.g. 1 ms")

    def init(self, key: Key) -> ListeningState:
        """Nothing heard."""
        n = np.shape(self.beacons.map)[0]
        never, o, no = jnp.full(n, FOREVER), jnp.zeros(n), jnp.zeros(n, np.bool_)
        none = HeardRanges(range=o, arrived=no, measured=jnp.zeros(n, np.int64))
        return ListeningState(key=key, begins=never, ends=never, taken=o, audible=no, held=none, any=np.bool_(False))

    def measure(self, motion: Motion) -> HeardRanges:
        """The ranges h(x) of all beacons at one time, beacons where the map has them: no error but the cone's."""
        at, positions = unit_position(motion, self.unit), jnp.asarray(self.beacons.map)
        hears = audible_beacons(self.beacons, positions, at)
        ranges = jnp.where(hears, measured_range(positions, at[None, :], self.cone_error), 0.0)
        return HeardRanges(range=ranges, arrived=hears, measured=jnp.full(hears.shape, motion.t, np.int64))

    def chirps(self, t: Any, key: Key) -> tuple[Any, Any]:
        """When the beacons chirp in the window that begins at integer time t, and when their messages are over (n,).

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
        """The newest ranges whose messages are over at integer time t."""
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
        """Ranges (n,) of chirps that began since the last instant, and whether they were heard."""
        ago = jnp.clip(to_seconds(t - begins), 0.0, to_seconds(self.period))
        at = unit_position(motion, self.unit) - ago[:, None] * unit_velocity(motion, self.unit)
        positions = actual_positions(self.beacons, key, t)
        number = t // self.window
        exact = measured_range(positions, at, self.cone_error)
        ranges = corrupt_ranges(exact, key, number, self.errors, self.medium, self.beacons.crystal)
        return ranges, responding_beacons(self.beacons, positions, unit_position(motion, self.unit), t)

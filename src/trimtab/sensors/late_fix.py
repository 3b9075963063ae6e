"""A measurement that is made now and then, and comes out later, with the time at which it was made or without."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Sample
from trimtab.core.time import FOREVER, UNITS_PER_SECOND, format_time, ms, to_seconds


@record
class LateState:
    """A measurement on its way, and the last that came out. Source: this module."""

    coming: Any = part("The one on its way.")
    made: Scalar = quantity("100 ns", "When it was made.", kind="time")
    due: Scalar = quantity("100 ns", "When it comes out.", kind="time")
    held: Any = part("The last that came out.")
    stamp: Scalar = quantity("100 ns", "The time that it bears.", kind="time")
    any: Scalar = quantity("1", "Whether one has come out.", kind="flag")


@record
class LateSensorState:
    """What a noisy sensor remembers whose measurements come out late. Source: this module."""

    key: Key = part("Of the noise.")
    late: LateState = part("What is on its way.")


@record
class LateFix:
    """When a measurement is made, when it comes out, and which of the two times it bears.

    Made at offset, offset + interval, …; out after the latency. A receiver that is not told the time of measurement
    takes that of arrival: stamped "arrival" stands for it, and what it costs is latency times velocity.

    Valid:   latency at most the interval: one measurement is under way at a time.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.2.1: its fixes bore no time. Latencies reconstructed, see docs Errata.
    """

    latency: Scalar = quantity("s", "From measurement to arrival.", default=0.0, low=0)
    interval: int = period("Time between measurements.", default=ms(100))
    offset: int = period("When the first is made.", default=0, low=0)
    stamped: str = option("Which time it bears.", default="measurement", choices=("measurement", "arrival"))

    def check(self) -> None:
        """Refuse a latency of more than one interval."""
        if self.latency > to_seconds(self.interval):
            problem = f"{self.latency:g} s is longer than the interval, {format_time(self.interval)}"
            raise InputError("latency", problem, fix=f"give {to_seconds(self.interval):g} s or less")
        if self.offset >= self.interval:
            problem = (
                f"{format_time(self.offset)} is not before the next measurement, {format_time(self.interval)} later"
            )
            raise InputError("offset", problem, fix="give less than the interval")

    def check_period(self, sensor_period: int) -> None:
        """Refuse the period (100 ns) of a sensor that would miss measurements."""
        if self.interval % sensor_period or self.offset % sensor_period:
            times = f"interval {format_time(self.interval)} and offset {format_time(self.offset)}"
            problem = f"{format_time(sensor_period)} divides not both {times}"
            raise InputError("period", f"{problem}: measurements would be missed", fix="set period to '1 ms'")

    def measurement_number(self, t: Any) -> Any:
        """Number of the measurement made last at integer time t; its random numbers follow from it."""
        return (t - self.offset) // self.interval

    def is_made(self, t: Any) -> Any:
        """Whether there is a measurement at integer time t."""
        return (t % self.interval) == self.offset

    def initial_state(self, like: Any) -> LateState:
        """Nothing under way; like: a value of the structure of what will be measured."""
        none, zero = jax.tree.map(jnp.zeros_like, like), np.int64(0)
        return LateState(coming=none, made=zero, due=np.int64(FOREVER), held=none, stamp=zero, any=np.bool_(False))

    def deliver(self, t: Any, state: LateState, value: Any, *, received: Any = True) -> tuple[LateState, Sample]:
        """The newest sample that is out at integer time t; value: what would be measured now, if it is `received`."""
        t = jnp.asarray(t, np.int64)
        delay = jnp.floor(self.latency * UNITS_PER_SECOND + 0.5).astype(np.int64)
        makes = self.is_made(t) if received is True else self.is_made(t) & received
        out = state.due <= t
        early = makes & (delay == 0)  # made and out at one instant
        held = tree_where(out, state.coming, state.held)
        made, held = jnp.where(early, t, state.made), tree_where(early, value, held)
        fresh = out | early
        stamp = t if self.stamped == "arrival" else made
        new = LateState(
            coming=tree_where(makes, value, state.coming),
            made=jnp.where(makes, t, state.made),
            due=jnp.where(makes & ~early, t + delay, jnp.where(out, np.int64(FOREVER), state.due)),
            held=held,
            stamp=jnp.where(fresh, stamp, state.stamp),
            any=state.any | fresh,
        )
        age = to_seconds(t - new.stamp)
        return new, Sample(value=held, t=new.stamp, age=age, fresh=fresh, valid=new.any)

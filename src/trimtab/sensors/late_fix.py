"""Measurements at intervals, which arrive with latency and are stamped with the time of measurement or of arrival."""

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
    """State of delayed measurements: the measurement in transit, and the last one that arrived. Source: this module."""

    coming: Any = part("Measurement in transit.")
    made: Scalar = quantity("100 ns", "Time at which the measurement in transit was made.", kind="time")
    due: Scalar = quantity("100 ns", "Time at which the measurement in transit arrives.", kind="time")
    held: Any = part("Last measurement that arrived.")
    stamp: Scalar = quantity("100 ns", "Time stamp of the last measurement that arrived.", kind="time")
    any: Scalar = quantity("1", "True once a measurement has arrived.", kind="flag")


@record
class LateSensorState:
    """State of a noisy sensor with latency. Source: this module."""

    key: Key = part("Key of the random number generator for the noise.")
    late: LateState = part("Measurement in transit, and last measurement that arrived.")


@record
class LateFix:
    """Timing of a delayed measurement: when it is made, when it arrives, and which of the two times is its time stamp.

    Measurements are made at offset, offset + interval, …, and arrive after the latency. A receiver that does not know
    the time of measurement uses the time of arrival. `stamped="arrival"` models this; it causes a position error of
    latency times velocity.

    Valid:   for a latency of at most the interval, so that only one measurement is in transit at a time.
    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.2.1: its fixes had no time stamp. The latencies are reconstructed, see docs Errata.
    """

    latency: Scalar = quantity("s", "Latency from measurement to arrival.", default=0.0, low=0)
    interval: int = period("Time between measurements.", default=ms(100))
    offset: int = period("Time of the first measurement.", default=0, low=0)
    stamped: str = option(
        "Time stamp of a sample: the time of measurement, or of arrival.",
        default="measurement",
        choices=("measurement", "arrival"),
    )

    def check(self) -> None:
        """Raise InputError if the latency is longer than the interval, or the offset is not less than the interval."""
        if self.latency > to_seconds(self.interval):
            problem = f"the latency of {self.latency:g} s is longer than the interval, {format_time(self.interval)}"
            raise InputError("latency", problem, fix=f"give a latency of at most {to_seconds(self.interval):g} s")
        if self.offset >= self.interval:
            problem = (
                f"the offset of {format_time(self.offset)} must be less than the interval, {format_time(self.interval)}"
            )
            raise InputError("offset", problem, fix="give an offset below the interval")

    def check_period(self, sensor_period: int) -> None:
        """Raise InputError if a sensor with this period (100 ns) would miss measurements."""
        if self.interval % sensor_period or self.offset % sensor_period:
            times = f"interval {format_time(self.interval)} and offset {format_time(self.offset)}"
            problem = f"the sensor's period of {format_time(sensor_period)} does not divide both {times}"
            raise InputError("period", f"{problem}: measurements would be missed", fix="set period to '1 ms'")

    def measurement_number(self, t: Any) -> Any:
        """Return the number of the last measurement made up to time t (unit: 100 ns).

        The number selects the measurement's random draws.
        """
        return (t - self.offset) // self.interval

    def is_made(self, t: Any) -> Any:
        """Return True if a measurement is made at time t (unit: 100 ns)."""
        return (t % self.interval) == self.offset

    def initial_state(self, like: Any) -> LateState:
        """Return the initial state, with nothing in transit. like: a measurement with the right shapes and types."""
        none, zero = jax.tree.map(jnp.zeros_like, like), np.int64(0)
        return LateState(coming=none, made=zero, due=np.int64(FOREVER), held=none, stamp=zero, any=np.bool_(False))

    def deliver(self, t: Any, state: LateState, value: Any, *, received: Any = True) -> tuple[LateState, Sample]:
        """Return the newest sample that has arrived by time t (unit: 100 ns).

        value: measurement at time t.    received: False if a measurement made at time t is lost.
        """
        t = jnp.asarray(t, np.int64)
        delay = jnp.floor(self.latency * UNITS_PER_SECOND + 0.5).astype(np.int64)
        makes = self.is_made(t) if received is True else self.is_made(t) & received
        out = state.due <= t
        early = makes & (delay == 0)  # measured and received at one instant
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

"""Network of ultrasonic beacons: the vehicle sends a ping, and each beacon replies with its measured range.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import (
    Scalar,
    imperfection,
    option,
    part,
    period,
    quantity,
    record,
    replace,
    switch,
    tree_where,
)
from trimtab.core.rng import Key, normal2, uniform2
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import FOREVER, UNITS_PER_SECOND, format_time, ms, seconds, to_seconds
from trimtab.environment.acoustics import speed_of_sound
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

SYNC, TICK, DRIFT = 130, 131, 132
"""Identifiers of the random streams of an ultrasonic unit's clock, for its error after setting, tick and drift."""


@record
class Ranges:
    """Replies to one ping. The sample's time is the time of the ping. Source: [1] section 5.5."""

    range: Any = quantity("m", "Measured range to each beacon (n,), cone error included; 0 where no reply arrived.")
    arrived: Any = quantity("1", "True for each beacon whose reply arrived (n,).", kind="flag")
    unit: Scalar = quantity("1", "Index of the ultrasonic unit that pinged, from 0.", kind="count")


@record
class UnitClock:
    """Clock of an ultrasonic unit, set every `sync` by the master's radio.

    Source: [1] section 5.5.2: error of 1 us after setting, crystal of 32.768 kHz. The drift is typical of such a
    crystal.
    """

    residual: Scalar = imperfection(
        "s", "Standard deviation of the clock error after setting.", "clock-error", default=1e-6
    )
    drift: Scalar = imperfection(
        "1", "Standard deviation of the crystal's relative error.", "clock-error", default=20e-6
    )
    tick: Scalar = imperfection(
        "s", "Period of the clock's crystal. Slots begin on ticks of the crystal.", "clock-error", default=1 / 32768
    )
    sync: int = period("Time between two settings of the clock.", default=seconds(1))

    def error(self, key: Key, t: Any, unit: Any) -> Any:
        """Return the delay (s) from the nominal start of a slot, at integer time t, to the slot's start by an
        ultrasonic unit's clock."""
        drift, _ = normal2(key, unit, DRIFT)
        residual, _ = normal2(key, t // self.sync * 16 + unit, SYNC)
        tick, _ = uniform2(key, t // self.sync * 16 + unit, TICK)
        return self.residual * residual + self.drift * drift * to_seconds(t % self.sync) + self.tick * tick


@record
class RangingState:
    """State of the ranging: the ping in transit, and the last ping whose replies are complete. Source: this module."""

    key: Key = part("Key of the random number generator.")
    coming: Ranges = part("Replies to the ping in transit.")
    pinged: Scalar = quantity("100 ns", "Time at which the ping in transit was sent.", kind="time")
    due: Scalar = quantity("100 ns", "Time at which the last reply to the ping in transit arrives.", kind="time")
    held: Ranges = part("Replies to the last ping whose replies are complete.")
    measured: Scalar = quantity("100 ns", "Time at which the last ping with complete replies was sent.", kind="time")
    any: Scalar = quantity("1", "True once the replies to a ping have arrived.", kind="flag")


@record
class UltrasonicRanging:
    """Ultrasonic units on the vehicle that ping in turn, one in each slot. The beacons reply with their ranges.

        k = t div slot;   client of slot k = k mod clients: the unit with this index, or a client on another vehicle
        range = distance / ratio(beta) * c_assumed / c + errors;   a reply waits until the channel is free

    The sample of a ping has the time of the ping. The sample is available when the last reply has arrived, or at the
    end of the slot if no reply arrives. Random draws depend only on the key and the slot.

    Frames:  beacons in W, units in B.    Not modelled: Doppler shift; the vehicle's motion during the sound's flight;
             interference of a ping with the echoes of the previous ping.
    Source:  [1] section 5.5. Differences from [1]: docs page, Errata.
    """

    beacons: Beacons = part(
        "Positions and errors of the ultrasonic beacons.",
        default=Beacons(),
        off={"clock-error": lambda sensor: replace(sensor.beacons, crystal=0.0)},
    )
    units: Any = quantity(
        "m", "Positions (m, 3) of the vehicle's ultrasonic units.", default=np.zeros((1, 3)), frame="B"
    )
    channel: CarrierSense = part("Rules by which replies share the radio channel.", default=CarrierSense())
    errors: RangeErrors = part("Errors of each measured range.", default=RangeErrors())
    medium: Medium = part("Air that carries the sound.", default=Medium())
    clock: UnitClock = part("Clock of an ultrasonic unit on the vehicle.", default=UnitClock())
    clients: int = option(
        "Number of ultrasonic units that take turns. Those beyond this vehicle's units are on other vehicles.",
        default=1,
    )
    cone_error: bool = switch("True: ranges measured off a beacon's axis are too long (cone error).", "cone-error")
    collisions: bool = switch("True: replies can be lost in collisions.", "collisions")
    slot: int = period("Length of the slot of one client.", default=ms(100))
    period: int = period("Time between checks for replies.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Raise InputError if `units` is not (m, 3), `clients` not m to 10, or `slot` not a multiple of `period`."""
        shape = np.shape(self.units)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 1:
            raise InputError(
                "UltrasonicRanging.units",
                f"the array of positions has shape {shape}, but must have shape (m, 3)",
                fix="give one row (x, y, z) for each ultrasonic unit",
            )
        if not shape[0] <= self.clients <= 10:
            problem = f"clients must be from {shape[0]}, the number of ultrasonic units, to 10, got {self.clients}"
            raise InputError(
                "UltrasonicRanging.clients", problem, fix=f"set clients to at least {shape[0]}, at most 10"
            )
        if self.slot % self.period:
            problem = (
                f"the slot of {format_time(self.slot)} must be a multiple of the period, {format_time(self.period)}"
            )
            raise InputError("UltrasonicRanging.slot", problem, fix="set period to a divisor of slot, e.g. 1 ms")

    def init(self, key: Key) -> RangingState:
        """Return the initial state, without a ping in transit."""
        n = np.shape(self.beacons.map)[0]
        none = Ranges(range=jnp.zeros(n), arrived=jnp.zeros(n, np.bool_), unit=np.int32(0))
        never = np.int64(FOREVER)
        zero = np.int64(0)
        return RangingState(key=key, coming=none, pinged=zero, due=never, held=none, measured=zero, any=np.bool_(False))

    def pinging_unit(self, t: Any) -> tuple[Any, Any]:
        """Return True if an ultrasonic unit of this vehicle pings at integer time t, and the unit's index."""
        client = (t // self.slot) % self.clients
        m = np.shape(self.units)[0]
        return (t % self.slot == 0) & (client < m), jnp.minimum(client, m - 1).astype(np.int32)

    def measure(self, motion: Motion) -> Ranges:
        """Return the ranges h(x) from the mapped beacons to the ultrasonic unit that pings now, with only the cone
        error."""
        _, unit = self.pinging_unit(motion.t)
        at = unit_position(motion, jnp.asarray(self.units)[unit])
        positions = jnp.asarray(self.beacons.map)
        arrived = audible_beacons(self.beacons, positions, at)
        exact = measured_range(positions, at, self.cone_error)
        return Ranges(range=jnp.where(arrived, exact, 0.0), arrived=arrived, unit=unit)

    def ping(self, t: Any, key: Key, motion: Motion) -> tuple[Ranges, Any]:
        """Return the replies to a ping in the slot of time t (unit: 100 ns), and the delay (s) of the last reply."""
        _, unit = self.pinging_unit(t)
        number = t // self.slot
        lever = jnp.asarray(self.units)[unit]
        late = self.clock.error(key, t, unit)
        at = unit_position(motion, lever) + unit_velocity(motion, lever) * late
        positions = actual_positions(self.beacons, key, t)
        hears = responding_beacons(self.beacons, positions, at, t)
        exact = measured_range(positions, at, self.cone_error)
        ranges = corrupt_ranges(exact, key, number, self.errors, self.medium, self.beacons.crystal)
        window = to_seconds(self.slot)
        ready = late + exact / speed_of_sound(self.medium.actual)
        if self.collisions:
            replies = simulate_exchange(self.channel, key, number, ready, hears, window)
            arrived, end = replies.received, replies.end
        else:
            arrived, end = hears, ready + self.channel.message_bytes * self.channel.byte_time
        last = jnp.where(jnp.any(arrived), jnp.max(jnp.where(arrived, end, 0.0)), window)
        return Ranges(range=jnp.where(arrived, ranges, 0.0), arrived=arrived, unit=unit), jnp.minimum(last, window)

    def step(self, t: Any, state: RangingState, motion: Motion) -> tuple[RangingState, Sample]:
        """Return the newest ranges whose replies have arrived at time t (unit: 100 ns)."""
        t = jnp.asarray(t, np.int64)
        fresh = state.due <= t
        held = tree_where(fresh, state.coming, state.held)
        measured = jnp.where(fresh, state.pinged, state.measured)
        valid = state.any | fresh
        due = jnp.where(fresh, FOREVER, state.due)

        def send() -> tuple[Ranges, Any, Any]:
            replies, last = self.ping(t, state.key, motion)
            return replies, t, t + jnp.ceil(last * UNITS_PER_SECOND).astype(np.int64)

        pings, _ = self.pinging_unit(t)
        coming, pinged, due = jax.lax.cond(pings, send, lambda: (state.coming, state.pinged, due))
        state = RangingState(
            key=state.key, coming=coming, pinged=pinged, due=due, held=held, measured=measured, any=valid
        )
        return state, Sample(value=held, t=measured, age=to_seconds(t - measured), fresh=fresh, valid=valid)

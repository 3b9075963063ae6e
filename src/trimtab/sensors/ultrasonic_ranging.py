"""A network of ultrasonic beacons: the vehicle pings, the beacons reply with their ranges.

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
"""Streams of the clock's draws."""


@record
class Ranges:
    """The replies to one ping; the sample's time is the ping's. Source: [1] section 5.5."""

    range: Any = quantity("m", "Measured range to each beacon (n,), cone error included; 0 where no reply arrived.")
    arrived: Any = quantity("1", "Whether the reply of each beacon (n,) arrived.", kind="flag")
    unit: Scalar = quantity("1", "Which of the vehicle's units pinged, from 0.", kind="count")


@record
class UnitClock:
    """The clock of a unit, set once a second by the master's radio.

    Source: [1] section 5.5.2: 1 us after setting, crystal of 32.768 kHz; its accuracy is typical for such a crystal.
    """

    residual: Scalar = imperfection("s", "Standard deviation after setting.", "clock-error", default=1e-6)
    drift: Scalar = imperfection(
        "1", "Standard deviation of the crystal's relative error.", "clock-error", default=20e-6
    )
    tick: Scalar = imperfection("s", "Slots begin on a tick of the crystal.", "clock-error", default=1 / 32768)
    sync: int = period("Time between settings.", default=seconds(1))

    def error(self, key: Key, t: Any, unit: Any) -> Any:
        """How much later than integer time t (s) a unit's slot really begins."""
        drift, _ = normal2(key, unit, DRIFT)
        residual, _ = normal2(key, t // self.sync * 16 + unit, SYNC)
        tick, _ = uniform2(key, t // self.sync * 16 + unit, TICK)
        return self.residual * residual + self.drift * drift * to_seconds(t % self.sync) + self.tick * tick


@record
class RangingState:
    """A ping under way, and the last one whose replies are in. Source: this module."""

    key: Key = part("Of the draws.")
    coming: Ranges = part("Replies to the ping under way.")
    pinged: Scalar = quantity("100 ns", "When it was sent.", kind="time")
    due: Scalar = quantity("100 ns", "When its last reply is in.", kind="time")
    held: Ranges = part("Replies handed out last.")
    measured: Scalar = quantity("100 ns", "When their ping was sent.", kind="time")
    any: Scalar = quantity("1", "Whether anything has been handed out.", kind="flag")


@record
class UltrasonicRanging:
    """Units on the vehicle that ping in turn, one a slot, and the ranges with which the beacons reply.

        slot k = t div slot;   its client is k mod clients, the vehicle's unit of that number if it has one
        range = distance / ratio(beta) * c_assumed / c + errors;   a reply waits until the channel is free

    A ping's sample carries the time of the ping and comes out when the last reply is in; with no reply at all, when
    the slot ends. Draws depend on key and slot alone.

    Frames:  beacons in W, units in B.    Not modelled: Doppler shift; the vehicle's motion during the sound's flight;
             interference of a ping with the echoes of the one before.
    Source:  [1] section 5.5. Differences from the source: docs page, Errata.
    """

    beacons: Beacons = part(
        "The beacons.", default=Beacons(), off={"clock-error": lambda sensor: replace(sensor.beacons, crystal=0.0)}
    )
    units: Any = quantity("m", "Positions (m, 3) of the vehicle's units.", default=np.zeros((1, 3)), frame="B")
    channel: CarrierSense = part("How replies share the radio channel.", default=CarrierSense())
    errors: RangeErrors = part("Errors of single ranges.", default=RangeErrors())
    medium: Medium = part("The air.", default=Medium())
    clock: UnitClock = part("The clock of a unit.", default=UnitClock())
    clients: int = option("Clients that take turns; those beyond the vehicle's units belong to others.", default=1)
    cone_error: bool = switch("Whether ranges are too long off the axis.", "cone-error")
    collisions: bool = switch("Whether replies can get lost.", "collisions")
    slot: int = period("Time for one client.", default=ms(100))
    period: int = period("How often the vehicle looks for replies.", default=ms(1))

    LATE: ClassVar[bool] = True

    def check(self) -> None:
        """Refuse units without positions, more units than turns, and slots between the instants."""
        shape = np.shape(self.units)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 1:
            raise InputError("UltrasonicRanging.units", f"has shape {shape}", fix="give one row x, y, z for each unit")
        if not shape[0] <= self.clients <= 10:
            problem = f"{self.clients} turns for {shape[0]} units"
            raise InputError("UltrasonicRanging.clients", problem, fix=f"set clients to {shape[0]} or more, 10 at most")
        if self.slot % self.period:
            problem = f"{format_time(self.slot)} is not a multiple of the period, {format_time(self.period)}"
            raise InputError("UltrasonicRanging.slot", problem, fix="set period to a divisor of it, e.g. 1 ms")

    def init(self, key: Key) -> RangingState:
        """Nothing under way."""
        n = np.shape(self.beacons.map)[0]
        none = Ranges(range=jnp.zeros(n), arrived=jnp.zeros(n, np.bool_), unit=np.int32(0))
        never = np.int64(FOREVER)
        zero = np.int64(0)
        return RangingState(key=key, coming=none, pinged=zero, due=never, held=none, measured=zero, any=np.bool_(False))

    def pinging_unit(self, t: Any) -> tuple[Any, Any]:
        """Whether a unit of this vehicle pings at integer time t, and which one's slot it is or would be."""
        client = (t // self.slot) % self.clients
        m = np.shape(self.units)[0]
        return (t % self.slot == 0) & (client < m), jnp.minimum(client, m - 1).astype(np.int32)

    def measure(self, motion: Motion) -> Ranges:
        """The ranges h(x) of the unit whose slot it is, beacons where the map has them: no error but the cone's."""
        _, unit = self.pinging_unit(motion.t)
        at = unit_position(motion, jnp.asarray(self.units)[unit])
        positions = jnp.asarray(self.beacons.map)
        arrived = audible_beacons(self.beacons, positions, at)
        exact = measured_range(positions, at, self.cone_error)
        return Ranges(range=jnp.where(arrived, exact, 0.0), arrived=arrived, unit=unit)

    def ping(self, t: Any, key: Key, motion: Motion) -> tuple[Ranges, Any]:
        """The replies to a ping in the slot of integer time t, and how long after its start the last one is in (s)."""
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
        """The newest ranges whose replies are in at integer time t."""
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

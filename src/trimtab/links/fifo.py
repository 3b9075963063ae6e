"""Delivery of packets in order: each packet has a random latency, and no packet overtakes another.

A ring buffer has one slot for each time at which a packet may be sent. A slot without a packet, or with a lost packet,
repeats the content of the previous slot. So arrival times never decrease along the ring, and the newest packet that has
arrived is found by counting the packets that have not arrived yet. The slot numbers depend only on the time, so all
runs in a batch have the same slot numbers.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.signals import Sample
from trimtab.core.time import NEVER, SECONDS_PER_UNIT, UNITS_PER_SECOND, format_time, to_seconds


@record
class Fifo:
    """State of a link: packets in transit, and the sample at the receiving end. The first axis of each array of the
    ring buffer is the slot.

    Frames: those of the transmitted values. Source: docs page.
    """

    key: Any = part("Key of the random draws, or None for a link without random draws.")
    values: Any = part("Transmitted value in each slot of the ring buffer.")
    measured: Scalar = quantity("100 ns", "Measurement time of the value in each slot.", kind="time")
    due: Scalar = quantity(
        "100 ns", "Arrival time of the packet in each slot. It never decreases along the ring.", kind="time"
    )
    serial: Scalar = quantity(
        "1", "Cumulative number of packets that were sent and not lost, up to each slot.", kind="count"
    )
    offered: Scalar = quantity("100 ns", "Measurement time of the last sample sent.", kind="time")
    held: Scalar = quantity("100 ns", "Measurement time of the sample at the receiving end.", kind="time")
    sent: Scalar = quantity("1", "Number of packets sent so far, including lost packets.", kind="count")
    lost: Scalar = quantity("1", "Number of packets lost so far.", kind="count")
    delivered: Scalar = quantity("1", "Number of packets that have arrived so far.", kind="count")


def empty_fifo(key: Any, like: Sample, capacity: int) -> Fifo:
    """Return the initial state with an empty ring buffer of `capacity` slots, for samples with the structure of
    `like`."""
    none = np.int32(0)
    return Fifo(
        key=key,
        values=empty_slots(like.value, capacity),
        measured=jnp.full(capacity, NEVER, np.int64),
        due=jnp.full(capacity, NEVER, np.int64),
        serial=jnp.zeros(capacity, np.int32),
        offered=np.int64(NEVER),
        held=np.int64(NEVER),
        sent=none,
        lost=none,
        delivered=none,
    )


def empty_slots(value: Any, n: int) -> Any:
    """Return a value with the structure of `like`, in which every number is an array of zeros with an additional first
    axis of n slots."""
    return jax.tree.map(lambda leaf: jnp.zeros((n, *jnp.shape(leaf)), jnp.result_type(leaf)), value)


def read_slot(ring: Any, slot: Any) -> Any:
    """Return the content of one slot of a ring buffer, whose arrays have shape (n, …). slot: from 0 to n - 1."""
    return jax.tree.map(lambda leaf: lax.dynamic_index_in_dim(leaf, slot, keepdims=False), ring)


def write_slot(ring: Any, slot: Any, value: Any) -> Any:
    """Return a ring buffer, whose arrays have shape (n, …), with a new value in one slot. slot: from 0 to n - 1."""
    return jax.tree.map(
        lambda leaf, new: lax.dynamic_update_index_in_dim(leaf, jnp.asarray(new, leaf.dtype), slot, 0), ring, value
    )


def measurement_time(sample: Sample) -> Any:
    """Return the time at which a sample was measured, or NEVER if the sample is not valid."""
    return jnp.where(sample.valid, sample.t, NEVER)


def receive_sample(now: Any, value: Any, measured: Any, held: Any) -> Sample:
    """Return the sample at the receiving end. The sample is fresh if its measurement time differs from `held`, that of
    the previous call.

    Before the first arrival the sample is not valid, and its age is counted from the start of the run.
    """
    valid = measured != NEVER
    t = jnp.where(valid, measured, 0)
    return Sample(value=value, t=t, age=to_seconds(now - t), fresh=measured != held, valid=valid)


def deliver(
    t: Any, fifo: Fifo, sample: Sample, draw: Callable[[], tuple[Any, Any]], *, send_period: int, period: int
) -> tuple[Fifo, Sample]:
    """Send the sample if a packet is due and the sample is new. Return the new state and the newest sample that has
    arrived.

    A packet arrives at max(arrival of the previous packet, now + latency), and is received at the next call of this
    function.

    Args:     t: now, integer time.    sample: sample at the sending end.
              draw: function that returns the latency (s, not negative) of a packet sent now, and True if the packet is
              lost.
              send_period: time between packets. At most one packet is sent per send_period, at its first instant.
              period: time between two calls.
    """
    number, before = t // send_period, (t - period) // send_period
    # The condition depends only on the time, so that a batch of runs really skips one of the branches.
    fifo = lax.cond(number != before, lambda: _send(t, number, fifo, sample, *draw()), lambda: fifo)

    pending = jnp.sum(fifo.due > t)
    newest = (number - pending) % fifo.due.shape[0]
    value, measured, delivered = read_slot((fifo.values, fifo.measured, fifo.serial), newest)
    return replace(fifo, held=measured, delivered=delivered), receive_sample(t, value, measured, fifo.held)


def _send(t: Any, number: Any, fifo: Fifo, sample: Sample, latency: Any, lost: Any) -> Fifo:
    capacity = fifo.due.shape[0]
    measured = measurement_time(sample)
    new = measured > fifo.offered
    goes = new & ~jnp.asarray(lost)

    ring = (fifo.values, fifo.measured, fifo.due, fifo.serial)
    _, _, latest, serial = previous = read_slot(ring, (number - 1) % capacity)
    arrival = t + jnp.round(latency * UNITS_PER_SECOND).astype(np.int64)
    packet = (sample.value, measured, jnp.maximum(latest, arrival), serial + 1)
    packet = jax.tree.map(lambda new, old: jnp.where(goes, new, old), packet, previous)
    values, times, due, serials = write_slot(ring, number % capacity, packet)
    return replace(
        fifo,
        values=values,
        measured=times,
        due=due,
        serial=serials,
        offered=jnp.where(new, measured, fifo.offered),
        sent=fifo.sent + new.astype(np.int32),
        lost=fifo.lost + (new & ~goes).astype(np.int32),
    )


def required_slots(longest: float, send_period: int, period: int) -> int:
    """Return the smallest number of slots with which a ring buffer cannot overflow for latencies up to `longest`
    (s)."""
    return 1 + math.ceil((round(longest * UNITS_PER_SECOND) + period) / send_period)


def check_ring(name: str, capacity: int, longest: float, send_period: int, period: int) -> None:
    """Raise InputError if a packet could be overwritten in the ring buffer before its arrival, or be due between two
    calls of the link.

    Args:     name: name of the link.    capacity: number of slots of the ring buffer, one per send_period.
              longest: longest latency (s).
    """
    if send_period < period:
        raise InputError(
            f"{name}.send_period",
            f"{format_time(send_period)} is shorter than the link's period, {format_time(period)}: "
            "packets would be sent between two calls of the link",
            fix=f"set send_period to {format_time(period)} or more, or period to {format_time(send_period)} or less",
        )
    needed = required_slots(longest, send_period, period)
    if capacity < needed:
        span = max(capacity - 1, 0) * send_period * SECONDS_PER_UNIT
        raise InputError(
            f"{name}.capacity",
            f"a ring of {capacity} slots, one per {format_time(send_period)}, keeps packets for {span:.4g} s,"
            f" but the longest latency is {longest:.4g} s (plus {format_time(period)} until it is received)",
            fix=f"set capacity to at least {needed}",
        )

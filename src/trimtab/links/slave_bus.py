"""Slow bus between two microcontrollers of a vehicle, which transmits a few bytes in each time slot.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record, switch
from trimtab.core.rng import Key
from trimtab.core.signals import Sample
from trimtab.core.time import NEVER, UNITS_PER_SECOND, format_time, ms, to_seconds
from trimtab.links.fifo import Fifo, check_ring, deliver, empty_fifo, measurement_time

BITS_PER_BYTE = 9
"""Number of bits per byte on the bus: eight data bits and an acknowledgement."""


@record
class SlaveBusState:
    """State of the bus: messages in transit, and the time until which the slots of the bus are reserved.

    Frames: those of the transmitted values. Source: docs page.
    """

    fifo: Fifo = part("Messages in transit. A message that was dropped because the queue was full counts as lost.")
    taken: Scalar = quantity(
        "100 ns", "Time until which the slots of the bus are reserved for waiting messages.", kind="time"
    )


@record
class SlaveBus:
    """Slow bus that splits messages into pieces of at most `piece` bytes, and sends one piece per `slot`, in order.

        pieces = ceil(bytes/piece)      first slot = the first that begins after now and after waiting messages
        arrives = first slot + (pieces − 1) slot + 9 (bytes of the last piece + 1 address)/bit_rate

    The length of a message is `size` if `size` is set. Otherwise the length is `overhead` plus two bytes per real
    number, one byte per integer and one bit per flag of the sample. The message contains the time of measurement. A
    message that would be in transit for longer than `queue` is dropped and counted.

    Frames:  those of the transmitted values.    Not modelled: repeated pieces, other traffic.
    Source:  [1] chapter 5: the microcontroller with the ultrasonic units is the bus master, and receives at most 10
             bytes in 10 ms. Bit rate, sizes and queue are reconstructed.
    """

    bit_rate: Scalar = quantity("1/s", "Bit rate of the bus.", default=100e3, above=0)
    slot: int = period("Duration of a time slot, in which one piece of a message is sent.", default=ms(10))
    piece: int = option("Maximum number of bytes in one piece of a message.", default=10)
    overhead: int = option(
        "Number of bytes that a message has in addition to its values: header, name, length, time.", default=5
    )
    size: int = option("Number of bytes of a message, or 0 to compute it from the sample.", default=0)
    queue: int = period(
        "Longest time that a message may be in transit. A message that would take longer is dropped.", default=ms(200)
    )
    period: int = period("Period at which the receiving end polls the bus.", default=ms(1))
    capacity: int = option("Number of slots of the ring buffer, one per period.", default=256)
    limited: bool = switch("True if messages take time on the bus, False if they arrive without delay.", "delay")

    def check(self) -> None:
        """Raise InputError if a size is not valid, a piece does not fit into a slot, or the ring buffer is too short
        for the queue."""
        if self.piece < 1 or self.size < 0 or self.overhead < 0:
            problem = (
                f"a size is not valid: piece is {self.piece} bytes, size is {self.size} bytes, overhead is "
                f"{self.overhead} bytes"
            )
            raise InputError("SlaveBus.piece", problem, fix="set piece >= 1, size >= 0, overhead >= 0")
        longest = (self.piece + 1) * BITS_PER_BYTE / float(self.bit_rate)
        if longest > to_seconds(self.slot):
            slot = format_time(self.slot)
            problem = (
                f"sending a piece of {self.piece} bytes takes {longest * 1e3:.3g} ms, but a time slot is only {slot}"
            )
            raise InputError("SlaveBus.slot", problem, fix="decrease piece, or increase slot")
        check_ring("SlaveBus", self.capacity, to_seconds(self.queue), self.period, self.period)

    def message_size(self, value: Any) -> int:
        """Return the number of bytes of a message that contains this value."""
        if self.size:
            return self.size
        counts = {"f": 0, "i": 0, "u": 0, "b": 0}
        for leaf in jax.tree.leaves(value):
            counts[np.dtype(jnp.result_type(leaf)).kind] += int(np.prod(jnp.shape(leaf)))
        return self.overhead + 2 * counts["f"] + counts["i"] + counts["u"] + -(-counts["b"] // 8)

    def init(self, key: Key, like: Sample) -> SlaveBusState:
        """Return the initial state, without messages."""
        return SlaveBusState(fifo=empty_fifo(None, like, self.capacity), taken=np.int64(NEVER))

    def step(self, t: Any, state: SlaveBusState, sample: Sample) -> tuple[SlaveBusState, Sample]:
        """Return the new state, and the sample at the receiving end at integer time t."""
        size = self.message_size(sample.value)
        pieces = -(-size // self.piece)
        last = size - (pieces - 1) * self.piece
        begins = -(-jnp.maximum(t, state.taken) // self.slot) * self.slot
        time = (last + 1) * BITS_PER_BYTE / self.bit_rate
        arrives = begins + (pieces - 1) * self.slot + jnp.round(time * UNITS_PER_SECOND).astype(np.int64)
        latency = jnp.where(self.limited, to_seconds(arrives - t), 0.0)
        full = (arrives - t > self.queue) & self.limited
        sent = (measurement_time(sample) > state.fifo.offered) & ~full
        fifo, out = deliver(t, state.fifo, sample, lambda: (latency, full), send_period=self.period, period=self.period)
        taken = jnp.where(sent & (t % self.period == 0), begins + pieces * self.slot, state.taken)
        return SlaveBusState(fifo=fifo, taken=taken), out

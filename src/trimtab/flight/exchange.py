"""Exchange of data over a link: conversion between messages and the input and output vectors of a compiled block, and
repeated requests.

Source: docs page, Exchange.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from trimtab.core.clock import NS_PER_SECOND, SYSTEM_CLOCK, Clock
from trimtab.core.interfaces import Link
from trimtab.flight.mavlink.authority import SESSION
from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.dialect import COMMAND, TIME, Dialect
from trimtab.flight.mavlink.endpoint import Endpoint

MOST_INCOMPLETE = 8
"""Maximum number of incomplete samples, whose messages have not all arrived. On some links packets overtake each other,
so several samples may be incomplete."""
T = TypeVar("T")
Where = Callable[[str], int | slice]
"""Function from the path of a number or array in a record to its index or slice in a vector."""


class _MessageLayout(NamedTuple):
    slots: list[int]
    whole: list[bool]
    time: int
    has_session: bool


class MessageGroup:
    """Group of messages that carry one sample or one command, with the conversion between these messages and a vector
    of numbers."""

    def __init__(self, dialect: Dialect, group: str, where: Where) -> None:
        """group: name of the group in the dialect, e.g. "samples.imu" or "command"."""
        self.names = dialect.groups[group]
        self._layouts: dict[str, _MessageLayout] = {}
        self._parts: dict[int, dict[str, tuple[Any, ...]]] = {}
        for name in self.names:
            slots, whole, time = [], [], -1
            for i, place in enumerate(dialect.places[name]):
                at = where(place.path)
                slots.append(at.start + place.slot if isinstance(at, slice) else at)
                whole.append(place.type != "double")
                if place.path == f"{group}.{TIME}":
                    time = i
            has_session = SESSION in dialect.definitions[name].where and group == COMMAND
            self._layouts[name] = _MessageLayout(slots, whole, time, has_session)

    def pack(self, endpoint: Endpoint, vector: Any, shift: int = 0) -> list[bytes]:
        """Return packets with the values of this sample or command in a vector. shift: time (100 ns) that is added to
        the time stamp in the packets."""
        packets = []
        for name, layout in self._layouts.items():
            numbers = vector[layout.slots].tolist()
            values = [int(v) if whole else v for v, whole in zip(numbers, layout.whole, strict=True)]
            values[layout.time] += shift
            packets.append(endpoint.pack(name, [*values, endpoint.session] if layout.has_session else values))
        return packets

    def assemble(self, message: Message) -> "GroupSample | None":
        """Return the sample or command that this message completes, or None while messages of the same time are
        missing."""
        layout = self._layouts[message.name]
        time = message.values[layout.time]
        if len(self.names) == 1:
            return GroupSample(time, layout.slots, message.values[: len(layout.slots)], layout.time)
        if time not in self._parts and len(self._parts) == MOST_INCOMPLETE:
            del self._parts[next(iter(self._parts))]
        parts = self._parts.setdefault(time, {})
        parts[message.name] = message.values[: len(layout.slots)]
        if len(parts) < len(self.names):
            return None
        del self._parts[time]
        slots = [s for n in self.names for s in self._layouts[n].slots]
        values = tuple(v for n in self.names for v in parts[n])
        return GroupSample(time, slots, values, self._layouts[self.names[0]].time)


class GroupSample(NamedTuple):
    """Complete sample or command, received over the link. t: time of the sample, by the sender's clock."""

    t: int
    slots: Sequence[int]
    values: Sequence[Any]
    time: int

    def write(self, vector: Any, shift: int = 0) -> None:
        """Write the sample into a vector. shift: time (100 ns) that is added to the time of the sample."""
        vector[self.slots] = self.values
        vector[self.slots[self.time]] = self.t + shift


def slot_indices(where: Mapping[str, Any], paths: Iterable[str], size: int) -> Any:
    """Return the indices, in a vector of length `size`, of the numbers and arrays at `paths`, in this order."""
    every = np.arange(size)
    return np.concatenate([np.zeros(0, np.intp), *(np.atleast_1d(every[where[p]]) for p in paths)])


def sample_groups(dialect: Dialect, where: Where) -> dict[str, MessageGroup]:
    """Return the group of messages for the samples of each sensor, by the sensor's name."""
    prefix = "samples."
    return {g[len(prefix) :]: MessageGroup(dialect, g, where) for g in dialect.groups if g.startswith(prefix)}


def command_group(dialect: Dialect, where: Where) -> MessageGroup:
    """Return the group of messages for the command."""
    return MessageGroup(dialect, COMMAND, where)


def receive_messages(link: Link, endpoint: Endpoint, timeout: float) -> list[Message]:
    """Receive a packet and return the accepted messages in it. Their sender becomes the peer for replies."""
    messages = endpoint.feed(link.receive(timeout))
    if messages:
        link.accept_sender()
    return messages


def request_answer(
    link: Link,
    endpoint: Endpoint,
    packets: Callable[[], Iterable[bytes]],
    answer: Callable[[Message], T | None],
    *,
    patience: float,
    resend_period: float,
    clock: Clock = SYSTEM_CLOCK,
) -> T | None:
    """Send packets repeatedly until a message answers them. Return the answer, or None after `patience` seconds.

    packets: function that makes the packets of each attempt.  answer: function that returns the content of a message if
    the message is an answer, otherwise None.
    """
    deadline = clock.monotonic_ns() + patience * NS_PER_SECOND
    while clock.monotonic_ns() < deadline:
        for packet in packets():
            link.send(packet)
        resend_time = clock.monotonic_ns() + resend_period * NS_PER_SECOND
        while (left := (resend_time - clock.monotonic_ns()) / NS_PER_SECOND) > 0:
            for message in receive_messages(link, endpoint, left):
                result = answer(message)
                if result is not None:
                    return result
    return None

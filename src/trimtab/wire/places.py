"""Decoded samples into a vector of numbers, and a vector into messages: between the wire and a compiled step."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError
from trimtab.wire.definitions import Message
from trimtab.wire.dialect import TIME, Dialect


class _MessageSlots(NamedTuple):
    """One message: where its values lie in the vector, which of them are integers, and its group's index and part."""

    group: str
    part: int
    at: np.ndarray
    whole: tuple[int, ...]
    time: int


class MessagePlaces:
    """Where the values of a dialect's messages lie in a vector such as `CompiledBlock.inputs`.

    A sample in several parts is written when all parts of one time of measurement have come, so that the vector never
    holds half of one.
    """

    def __init__(self, dialect: Dialect, places: Mapping[str, int | slice], groups: Sequence[str] = ()) -> None:
        """Find every value.

        Args:
            dialect: of the messages.
            places: path -> index or slice, e.g. `CompiledBlock.reads`.
            groups: which groups are looked for, e.g. ("command",); all that lie in `places` if empty.

        Raises InputError for a group with a value that has no place.
        """
        chosen = groups or [g for g in dialect.groups if _group_paths(dialect, g) <= places.keys()]
        self._spread: dict[str, _MessageSlots] = {}
        self._names = {g: dialect.groups[g] for g in chosen}
        for group in chosen:
            missing = sorted(_group_paths(dialect, group) - places.keys())
            if missing:
                problem = f"{missing[0]!r} of {group!r} has no place in the vector"
                raise InputError("wire", problem, choices=list(places)[:12], fix="take the dialect of this scenario")
            for part, name in enumerate(dialect.groups[group]):
                self._spread[name] = _find_slots(dialect, name, group, part, places)
        self._waiting: dict[str, dict[int, Message]] = {}

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups that have a place."""
        return tuple(self._names)

    def write_message(self, message: Message, vector: np.ndarray) -> str | None:
        """Write a message's values; the group that is complete with it, or None: parts are missing, or not placed."""
        spread = self._spread.get(message.name)
        if spread is None:
            return None
        parts = self._names[spread.group]
        if len(parts) == 1:
            vector[spread.at] = message.values
            return spread.group
        waiting = self._waiting.setdefault(spread.group, {})
        if waiting and next(iter(waiting.values())).values[spread.time] != message.values[spread.time]:
            waiting.clear()
        waiting[spread.part] = message
        if len(waiting) < len(parts):
            return None
        for held in waiting.values():
            vector[self._spread[held.name].at] = held.values
        waiting.clear()
        return spread.group

    def read_messages(self, group: str, vector: np.ndarray) -> list[tuple[str, list[Any]]]:
        """The messages that carry a group, as arguments of `Endpoint.pack`."""
        found = []
        for name in self._names[group]:
            spread = self._spread[name]
            values: list[Any] = vector[spread.at].tolist()
            for k in spread.whole:
                if math.isfinite(values[k]):  # else packing puts it right, and counts it
                    values[k] = int(values[k])
            found.append((name, values))
        return found


def _group_paths(dialect: Dialect, group: str) -> set[str]:
    return {place.path for name in dialect.groups[group] for place in dialect.places[name]}


def _find_slots(dialect: Dialect, name: str, group: str, part: int, places: Mapping[str, int | slice]) -> _MessageSlots:
    index = []
    for path, slot, _ in dialect.places[name]:
        at = places[path]
        index.append((at.start if isinstance(at, slice) else at) + slot)
    definition = dialect.definitions[name]
    whole = tuple(k for k, allowed in enumerate(definition.ranges) if allowed is not None)
    times = [k for k, place in enumerate(dialect.places[name]) if place.path.rsplit(".", 1)[-1] == TIME]
    return _MessageSlots(group, part, np.array(index, np.intp), whole, times[0])

"""Parameters read and changed over the wire: lists are sent at a pace, a change is answered with the value that holds.

Source: https://mavlink.io/en/services/parameter.html.
"""

from collections import deque

from trimtab.core.time import seconds
from trimtab.wire.events import ParameterSet
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.message import Message
from trimtab.wire.parameters import Parameters
from trimtab.wire.protocol import REAL_32

PERIOD = seconds("0.02")
"""Between two values of a list."""


class ParameterService:
    """Answers for the parameters of one vehicle. Times are the vehicle's, in 100 ns."""

    def __init__(self, endpoint: Endpoint, parameters: Parameters) -> None:
        """Nothing asked for yet."""
        self._endpoint, self._parameters = endpoint, parameters
        self._listing: deque[int] = deque()
        self._sent_at: int | None = None

    def list_all(self) -> None:
        """Send every value, from the first, as they become due."""
        self._listing = deque(range(len(self._parameters.listed)))

    def due(self, now: int) -> list[bytes]:
        """The next value of the list that was asked for, if it is time."""
        if not self._listing or (self._sent_at is not None and 0 <= now - self._sent_at < PERIOD):
            return []
        self._sent_at = now
        return [self.value(self._listing.popleft())]

    def read(self, message: Message) -> list[bytes]:
        """The value that a PARAM_REQUEST_READ asks for; nothing if there is none."""
        index = self._parameters.find(message.get("param_id"), message.get("param_index"))
        return [] if index is None else [self.value(index)]

    def change(self, message: Message, why_not: str) -> tuple[list[bytes], list[ParameterSet], str]:
        """Follow a PARAM_SET: the value that holds now, the event if it is another, why it was refused."""
        name = message.get("param_id")
        index = self._parameters.find(name, -1)
        if index is None:
            return [], [], f"there is no parameter {name!r}"
        before = self._parameters.values[index]
        changed = self._parameters.change(index, message.get("param_value"), why_not)
        own, events = changed.parameter, []
        if changed.value != before:
            events = [ParameterSet(own.path, own.slot, changed.value, (message.system, message.component))]
        refused = f"{name} ({own.path}) {changed.refused}" if changed.refused else ""
        return [self.value(index)], events, refused

    def value(self, index: int) -> bytes:
        """The packet that tells a value."""
        own = self._parameters.listed[index]
        fields = {"param_id": own.name, "param_value": self._parameters.values[index], "param_type": REAL_32}
        fields |= {"param_count": len(self._parameters.listed), "param_index": index}
        return self._endpoint.pack("PARAM_VALUE", fields)

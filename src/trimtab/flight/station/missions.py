"""Answers to requests about missions, fences and rally points. The vehicle stores no such items, so every list has 0
items.

    list     MISSION_REQUEST_LIST                     answer: MISSION_COUNT 0
    clear    MISSION_CLEAR_ALL, or MISSION_COUNT 0    answer: MISSION_ACK accepted, as the list is empty
    other requests                                    answer: MISSION_ACK unsupported, or invalid sequence for an item

Source: https://mavlink.io/en/services/mission.html.
"""

from collections.abc import Collection
from enum import IntEnum

from trimtab.flight.mavlink.definitions import Message
from trimtab.flight.mavlink.endpoint import Endpoint


class MissionResult(IntEnum):
    """Codes for the result of a request about missions: MAVLink's MAV_MISSION_RESULT."""

    ACCEPTED = 0
    UNSUPPORTED = 3
    INVALID_SEQUENCE = 13


RESULTS = {
    "MISSION_COUNT": MissionResult.UNSUPPORTED,
    "MISSION_ITEM": MissionResult.UNSUPPORTED,
    "MISSION_ITEM_INT": MissionResult.UNSUPPORTED,
    "MISSION_WRITE_PARTIAL_LIST": MissionResult.UNSUPPORTED,
    "MISSION_SET_CURRENT": MissionResult.UNSUPPORTED,
    "MISSION_REQUEST": MissionResult.INVALID_SEQUENCE,
    "MISSION_REQUEST_INT": MissionResult.INVALID_SEQUENCE,
    "MISSION_CLEAR_ALL": MissionResult.ACCEPTED,
}
LIST_REQUEST = "MISSION_REQUEST_LIST"


class MissionService:
    """Service of a vehicle that answers requests about missions."""

    names: Collection[str] = (LIST_REQUEST, *RESULTS)

    def __init__(self, endpoint: Endpoint) -> None:
        """endpoint: endpoint that packs the answers."""
        self._endpoint = endpoint

    def answer(self, message: Message, now: int, *, is_armed: bool) -> list[bytes]:
        """Return the packet that answers a request about missions."""
        to = {"target_system": message.system, "target_component": message.component}
        if "mission_type" in message.definition.where:
            to["mission_type"] = message.get("mission_type")
        if message.name == LIST_REQUEST:
            return [self._endpoint.pack("MISSION_COUNT", {"count": 0} | to)]
        is_cleared = message.name == "MISSION_COUNT" and message.get("count") == 0
        result = MissionResult.ACCEPTED if is_cleared else RESULTS[message.name]
        return [self._endpoint.pack("MISSION_ACK", {"type": result} | to)]

    def due(self, now: int, *, is_armed: bool) -> list[bytes]:
        """Return no packets: this service sends answers only."""
        return []

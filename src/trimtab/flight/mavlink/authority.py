"""Authority over a vehicle. A vehicle belongs to the sender that armed it, until the vehicle is disarmed or handed
over.

A sender is identified by four numbers: MAVLink system id, component id, stream number of the signatures, and a session
number that each program draws at random when it starts. So two programs with the same key and the same ids are two
senders, even if one of them reads the session number of the other.
The session number is sent in fields that MAVLink does not use: in the extension `session` of COMMAND, in parameters of
commands, and in the acknowledgements of commands. Senders without a session number (0) are accepted too.

    MAV_CMD_COMPONENT_ARM_DISARM (400)          param3 the sender's session, param4 the vehicle's, 0 for any
    MAV_CMD_REQUEST_OPERATOR_CONTROL (32100)    param2 1, param5 the sender's session, param6 the vehicle's
    COMMAND_ACK of both                         result_param2 the session of the owner

Ground stations have no session number. They may arm and disarm any vehicle, because a person operates them. A vehicle
that was armed by a ground station belongs to the autopilot of its own system that sends the first command. An
unrequested acknowledgement of 32100 announces the owner.
Source: https://mavlink.io/en/messages/common.html; docs page, Vehicle.
"""

import secrets
from typing import NamedTuple

from trimtab.flight.mavlink.definitions import Message

SESSION = "session"
"""Name of the extension field of COMMAND that carries the sender's session number."""
MOST_SESSIONS = 2**24
"""Upper limit of session numbers. Whole numbers below this limit are exact in a command's parameter, a 32-bit float."""


def draw_session() -> int:
    """Return a random session number, at least 1. Each program draws a session number when it starts."""
    return 1 + secrets.randbelow(MOST_SESSIONS - 1)


class Sender(NamedTuple):
    """Sender of a message. session: session number, or 0 for a sender without a session number, e.g. a ground station.

    link: stream number of the signatures.
    """

    system: int
    component: int
    session: int
    link: int = 0

    def __str__(self) -> str:
        session = f" session {self.session:06x}" if self.session else ""
        return f"{self.system}/{self.component}{session}" + (f" link {self.link}" if self.link else "")


def parse_session(number: float) -> int:
    """Return the session number in a parameter of a command, or 0 if the parameter is not a valid session number."""
    return int(number) if 0 < number < MOST_SESSIONS and number == int(number) else 0


def command_sender(message: Message) -> Sender:
    """Return the sender of a COMMAND message."""
    session = message.get(SESSION) if SESSION in message.definition.where else 0
    return Sender(message.system, message.component, session, message.link)


class Authority:
    """Record of a vehicle's owner. The vehicle's program sets `is_armed`, and calls `end_flight` when the vehicle is
    disarmed."""

    def __init__(self, session: int, system: int = 1) -> None:
        """session: session number of the vehicle.  system: MAVLink system id of the vehicle."""
        self.session, self.system = session, system
        self.owner: Sender | None = None
        self.is_armed = False
        self.refused_commands = 0
        """Number of commands received so far from senders that do not own the vehicle."""

    def is_addressed(self, session: int) -> bool:
        """Return True if a session number in a message is 0 or equals the session number of this vehicle. Two vehicles
        on one link may have the same system id, but not the same session number."""
        return session in (0, self.session)

    def find_arming_problem(self, sender: Sender) -> str:
        """Return the reason why a sender may not arm the vehicle, or "" if the sender may arm it."""
        is_taken = self.is_armed and self.owner is not None and sender.session and sender != self.owner
        return f"vehicle belongs to {self.owner}" if is_taken else ""

    def find_disarming_problem(self, sender: Sender) -> str:
        """Return the reason why a sender may not disarm the vehicle, or "" if the sender may disarm it. An autopilot
        may disarm only a vehicle that it owns."""
        return self.find_arming_problem(sender)

    def arm(self, sender: Sender) -> None:
        """Record that a sender has armed the vehicle."""
        if sender.session:
            self.owner, self.is_armed = sender, True
        elif not self.is_armed:
            self.owner, self.is_armed = None, True

    def take_over(self, sender: Sender) -> Sender | None:
        """Hand the vehicle over to a sender. Return the previous owner."""
        before, self.owner = self.owner, sender
        return before

    def accepts_command(self, sender: Sender) -> bool:
        """Return True if the vehicle must obey a command of this sender.

        The owner's commands are obeyed. If a ground station has armed the vehicle, the first autopilot of the vehicle's
        own system that sends a command becomes the owner.
        """
        if not self.is_armed:
            return True
        if self.owner is None and sender.system == self.system:
            self.owner = sender
        self.refused_commands += sender != self.owner
        return sender == self.owner

    def end_flight(self) -> None:
        """End the owner's authority. The next sender that arms the vehicle owns it."""
        self.owner, self.is_armed = None, False

"""Authority over a vehicle: it belongs to the sender that armed it, until it is disarmed or handed over on request.

A sender is a system, a component, the stream of its signatures, and a session, a number that is drawn at each start.
Two programs with the same key and the same numbers are two senders, also if one reads the session of the other. The
session is sent where MAVLink leaves room, so that senders without one (session 0) are still understood: as the
extension `session` of COMMAND, as parameters of commands, and in their acknowledgements.

    MAV_CMD_COMPONENT_ARM_DISARM (400)          param3 the sender's session, param4 the vehicle's, 0 for any
    MAV_CMD_REQUEST_OPERATOR_CONTROL (32100)    param2 1, param5 the sender's session, param6 the vehicle's
    COMMAND_ACK of both                         result_param2 the session of the owner

Ground stations have no session. They may arm and disarm any vehicle, since a person operates them. A vehicle armed by
one belongs to the autopilot of its own system that sends the first command. An unrequested acknowledgement of 32100
announces the owner.
Source: https://mavlink.io/en/messages/common.html; docs page, Vehicle.
"""

import secrets
from typing import NamedTuple

from trimtab.flight.mavlink.definitions import Message

SESSION = "session"
"""Name of the extension of COMMAND."""
MOST_SESSIONS = 2**24
"""Upper limit of sessions: whole numbers that a command's parameter, a float of 32 bits, can hold."""


def draw_session() -> int:
    """Draw a random session number, from 1 on, for one run of a program on a link."""
    return 1 + secrets.randbelow(MOST_SESSIONS - 1)


class Sender(NamedTuple):
    """Sender of a message. Session 0: it has none, like ground stations. link: number of its signatures' stream."""

    system: int
    component: int
    session: int
    link: int = 0

    def __str__(self) -> str:
        session = f" session {self.session:06x}" if self.session else ""
        return f"{self.system}/{self.component}{session}" + (f" link {self.link}" if self.link else "")


def parse_session(number: float) -> int:
    """Return a session from the parameter of a command; 0 if it is not valid."""
    return int(number) if 0 < number < MOST_SESSIONS and number == int(number) else 0


def command_sender(message: Message) -> Sender:
    """Return the sender of a COMMAND."""
    session = message.get(SESSION) if SESSION in message.definition.where else 0
    return Sender(message.system, message.component, session, message.link)


class Authority:
    """Owner of a vehicle. The vehicle sets `is_armed`, and calls `end_flight` when it is disarmed."""

    def __init__(self, session: int, system: int = 1) -> None:
        """session, system: numbers of the vehicle."""
        self.session, self.system = session, system
        self.owner: Sender | None = None
        self.is_armed = False
        self.refused_commands = 0
        """Commands so far from senders that do not own the vehicle."""

    def is_addressed(self, session: int) -> bool:
        """Return whether a session addresses this vehicle: two vehicles on one link have the same system."""
        return session in (0, self.session)

    def find_arming_problem(self, sender: Sender) -> str:
        """Return why a sender may not arm; empty if it may."""
        is_taken = self.is_armed and self.owner is not None and sender.session and sender != self.owner
        return f"vehicle belongs to {self.owner}" if is_taken else ""

    def find_disarming_problem(self, sender: Sender) -> str:
        """Return why a sender may not disarm: an autopilot may end its own flight only."""
        return self.find_arming_problem(sender)

    def arm(self, sender: Sender) -> None:
        """Note that a sender has armed the vehicle."""
        if sender.session:
            self.owner, self.is_armed = sender, True
        elif not self.is_armed:
            self.owner, self.is_armed = None, True

    def take_over(self, sender: Sender) -> Sender | None:
        """Hand the vehicle over to a sender. Return the previous owner."""
        before, self.owner = self.owner, sender
        return before

    def accepts_command(self, sender: Sender) -> bool:
        """Return whether a sender's command is obeyed.

        The owner's commands are obeyed. If a ground station has armed the vehicle, the first command of the vehicle's
        own system makes its sender the owner.
        """
        if not self.is_armed:
            return True
        if self.owner is None and sender.system == self.system:
            self.owner = sender
        self.refused_commands += sender != self.owner
        return sender == self.owner

    def end_flight(self) -> None:
        """End the authority: the next sender that arms owns the vehicle."""
        self.owner, self.is_armed = None, False

"""Who commands a vehicle: whoever armed it, until it is not armed any more, or hands over when it is asked to.

A sender is a system, a component and a session, a number that is drawn at each start: two programs with the same key
and the same numbers are two senders. It travels where MAVLink leaves room, so that who knows nothing of it (session 0)
is still understood: as the extension `session` of COMMAND, as parameters of commands, and in their acknowledgements.

    MAV_CMD_COMPONENT_ARM_DISARM (400)          param3 the sender's session, param4 the vehicle's, 0 for any
    MAV_CMD_REQUEST_OPERATOR_CONTROL (32100)    param2 1, param5 the sender's session, param6 the vehicle's
    COMMAND_ACK of both                         result_param2 the session of the owner

Ground stations, which have no session, may arm and disarm whatever flies, for they are a person's hand; a vehicle that
one has armed belongs to whose command comes first. Commands of 32100 that nobody asked for tell whose it is.
Source: https://mavlink.io/en/messages/common.html; docs page, Vehicle.
"""

import secrets
from typing import NamedTuple

from trimtab.wire.definitions import Message

SESSION = "session"
"""Name of the extension of COMMAND."""
MOST_SESSIONS = 2**24
"""A session is a whole number that the parameter of a command, a float of 32 bits, holds."""


def draw_session() -> int:
    """A number for a program's run on a line, from 1 on."""
    return 1 + secrets.randbelow(MOST_SESSIONS - 1)


class Sender(NamedTuple):
    """Who sent a message; session 0: it tells none, as ground stations do."""

    system: int
    component: int
    session: int

    def __str__(self) -> str:
        return f"{self.system}/{self.component}" + (f" session {self.session:06x}" if self.session else "")


def parse_session(number: float) -> int:
    """A session from the parameter of a command; 0 where it is none."""
    return int(number) if 0 < number < MOST_SESSIONS and number == int(number) else 0


def command_sender(message: Message) -> Sender:
    """Who sent a COMMAND."""
    session = message.get(SESSION) if SESSION in message.definition.where else 0
    return Sender(message.system, message.component, session)


class Authority:
    """A vehicle's owner. `is_armed` is set by the vehicle, which tells by `end_flight` that it is not any more."""

    def __init__(self, session: int) -> None:
        """session: the vehicle's own."""
        self.session = session
        self.owner: Sender | None = None
        self.is_armed = False
        self.refused_commands = 0
        """Commands so far of senders that the vehicle does not belong to."""

    def is_addressed(self, session: int) -> bool:
        """Whether what names a vehicle's session is for this one: two on one line have the same system."""
        return session in (0, self.session)

    def find_arming_problem(self, sender: Sender) -> str:
        """Why a sender may not arm; empty where it may."""
        is_taken = self.is_armed and self.owner is not None and sender.session and sender != self.owner
        return f"it belongs to {self.owner}" if is_taken else ""

    def find_disarming_problem(self, sender: Sender) -> str:
        """Why a sender may not disarm: another autopilot ends its own flight only."""
        return self.find_arming_problem(sender)

    def arm(self, sender: Sender) -> None:
        """A sender that may has armed."""
        if sender.session:
            self.owner, self.is_armed = sender, True
        elif not self.is_armed:
            self.owner, self.is_armed = None, True

    def take_over(self, sender: Sender) -> Sender | None:
        """Hand over to who asks for it; returns whose it was."""
        before, self.owner = self.owner, sender
        return before

    def accepts_command(self, sender: Sender) -> bool:
        """Whether a sender's command is obeyed: the owner's, or the first after a ground station has armed."""
        if not self.is_armed:
            return True
        if self.owner is None:
            self.owner = sender
        self.refused_commands += sender != self.owner
        return sender == self.owner

    def end_flight(self) -> None:
        """Nobody commands it any more: whoever arms it next has it."""
        self.owner, self.is_armed = None, False

"""What ground stations send to have an autopilot hold, go on, or end its flight.

    hold     MAV_CMD_OVERRIDE_GOTO (252) with MAV_GOTO_DO_HOLD, where it is; MAV_CMD_DO_PAUSE_CONTINUE (193) with 0
    resume   MAV_CMD_OVERRIDE_GOTO with MAV_GOTO_DO_CONTINUE; MAV_CMD_DO_PAUSE_CONTINUE with 1
    end      MAV_CMD_NAV_LAND (21), wherever that is asked for

Source: https://mavlink.io/en/messages/common.html.
"""

from typing import NamedTuple

from trimtab.wire.protocol import Order

HOLD, RESUME, END = "hold", "resume", "end"
DENIED = ""
GOTO_HOLD, GOTO_CONTINUE = 0, 1
HERE = 0, 2
"""Where to hold: not said, or MAV_GOTO_HOLD_AT_CURRENT_POSITION."""
PAUSES: dict[float, str] = {0: HOLD, 1: RESUME}


class Wanted(NamedTuple):
    """A command and its first two parameters."""

    command: int
    first: float
    second: float


ORDERS = {
    HOLD: Wanted(Order.OVERRIDE_GOTO, GOTO_HOLD, 2),
    RESUME: Wanted(Order.OVERRIDE_GOTO, GOTO_CONTINUE, 2),
    END: Wanted(Order.LAND, 0, 0),
}
"""How one end of the line asks the other."""


def requested(wanted: Wanted) -> str | None:
    """What a command asks for; DENIED where that can't be done; None for a command that asks for none of it."""
    command, first, second = wanted
    if command == Order.LAND:
        return END
    if command == Order.PAUSE_CONTINUE:
        return PAUSES.get(first, DENIED)
    if command == Order.OVERRIDE_GOTO:
        if first == GOTO_HOLD:
            return HOLD if second in HERE else DENIED
        return RESUME if first == GOTO_CONTINUE else DENIED
    return None

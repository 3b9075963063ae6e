"""What is asked of a vehicle over the wire; the vehicle's process acts upon it. `asked_by`: (system, component)."""

from typing import NamedTuple

Who = tuple[int, int]


class ArmAsked(NamedTuple):
    """Arm or disarm; arming comes only while nothing speaks against it."""

    armed: bool
    asked_by: Who


class ModeAsked(NamedTuple):
    """Change to a mode, by its number; only modes that are known and open come."""

    mode: int
    asked_by: Who


class FlightAsked(NamedTuple):
    """The autopilot is to "hold", to "resume" or to "end" its flight; comes only while there is one to be asked."""

    request: str
    asked_by: Who


class ParameterSet(NamedTuple):
    """A number of the leaf at `path` has been given another value, which was found to be allowed."""

    path: str
    slot: int
    value: float
    asked_by: Who


class Channels(NamedTuple):
    """Pulse widths of a safety pilot's receiver, in seconds; NaN for a channel that isn't there.

    override: they come from a ground station in the receiver's place, and are to be trusted less.
    """

    pulses: tuple[float, ...]
    override: bool
    asked_by: Who


class Sticks(NamedTuple):
    """A joystick: forward, right, up, turn from -1 to 1, NaN where there is none; buttons as bits."""

    surge: float
    sway: float
    heave: float
    yaw: float
    buttons: int
    asked_by: Who


Event = ArmAsked | ModeAsked | FlightAsked | ParameterSet | Channels | Sticks

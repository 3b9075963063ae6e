"""Part of MAVLink's common dialect that a vehicle uses: numeric codes, and parsing of requests.

Requests for an autopilot to hold, to resume, or to end its flight:

    hold     MAV_CMD_OVERRIDE_GOTO (252) with MAV_GOTO_DO_HOLD, at the current position;
             MAV_CMD_DO_PAUSE_CONTINUE (193) with 0
    resume   MAV_CMD_OVERRIDE_GOTO with MAV_GOTO_DO_CONTINUE; MAV_CMD_DO_PAUSE_CONTINUE with 1
    end      MAV_CMD_NAV_LAND (21), with any position

Source: https://mavlink.io/en/messages/common.html.
"""

from enum import IntEnum, IntFlag
from typing import NamedTuple

from trimtab.flight.mavlink.definitions import Message


class ArmRequest(NamedTuple):
    """Request to arm or disarm.

    A request to arm is passed to the vehicle only if all checks pass. by_hand: True for a request of a person at a
    ground station.
    """

    arm: bool
    by_hand: bool = False


class ModeRequest(NamedTuple):
    """Request to change the vehicle's mode. mode: number of the new mode. The request is passed to the vehicle only if
    this mode exists and can be entered."""

    mode: int


class FlightRequest(NamedTuple):
    """Request for the autopilot to "hold", to "resume" or to "end" its flight.

    The request is passed to the vehicle only if an autopilot is on the link.
    """

    request: str


class ParameterChange(NamedTuple):
    """Accepted change of a parameter. path: path of a number or array.  slot: index of the changed number in the
    array."""

    path: str
    slot: int
    value: float


class ReceiverChannels(NamedTuple):
    """Pulse widths (s) of all channels of the safety pilot's radio receiver, NaN for a missing channel.

    is_release: True if a ground station releases all channels. The vehicle then expects no safety pilot.
    """

    pulses: tuple[float, ...]
    is_release: bool = False


class JoystickAxes(NamedTuple):
    """Positions of a joystick's axes (forward, right, up, turn), each from -1 to 1, NaN for a missing axis."""

    surge: float
    sway: float
    heave: float
    yaw: float


VehicleEvent = ArmRequest | ModeRequest | FlightRequest | ParameterChange | ReceiverChannels | JoystickAxes


class ModeFlag(IntFlag):
    """Flags of a vehicle's mode: MAVLink's MAV_MODE_FLAG."""

    CUSTOM = 1
    ARMED = 128


class State(IntEnum):
    """States of a vehicle: MAVLink's MAV_STATE."""

    BOOT = 1
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    EMERGENCY = 6
    POWEROFF = 7


class CommandCode(IntEnum):
    """Ids of commands: MAVLink's MAV_CMD."""

    LAND = 21
    SET_MODE = 176
    TERMINATE = 185
    PAUSE_CONTINUE = 193
    OVERRIDE_GOTO = 252
    ARM = 400
    STORAGE = 245
    REBOOT = 246
    RUN_CHECKS = 401
    GET_HOME = 410
    GET_INTERVAL = 510
    SET_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_CAPABILITIES = 520
    REQUEST_CONTROL = 32100


class CommandResult(IntEnum):
    """Results of a command: MAVLink's MAV_RESULT."""

    ACCEPTED = 0
    NOT_NOW = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Severity(IntEnum):
    """Severities of a text message: MAVLink's MAV_SEVERITY."""

    EMERGENCY = 0
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Capability(IntFlag):
    """Capabilities of a vehicle: MAVLink's MAV_PROTOCOL_CAPABILITY."""

    COMMAND_INT = 8
    FILES = 32
    MAVLINK2 = 8192
    PARAMETERS_AS_FLOAT = 131072


GENERIC_AUTOPILOT = 0
REAL_32 = 9
SET_MODE_MESSAGE = 11
"""Id of the message SET_MODE, used as the command id when SET_MODE is acknowledged."""
VERSION_MESSAGE = 148
"""Id of the message AUTOPILOT_VERSION."""
HOLD, RESUME, END = "hold", "resume", "end"
DENIED = ""
GOTO_HOLD, GOTO_CONTINUE = 0, 1
HOLD_POSITIONS = 0, 2
"""Accepted codes of the position at which to hold: 0 (not given), or MAV_GOTO_HOLD_AT_CURRENT_POSITION."""
PAUSES: dict[float, str] = {0: HOLD, 1: RESUME}
CHANNELS = 18
NAN = float("nan")
ABSENT = {"RC_CHANNELS": (65535,), "RC_CHANNELS_OVERRIDE": (0, 65534, 65535)}
"""Pulse widths (µs) in RC_CHANNELS and RC_CHANNELS_OVERRIDE with a special meaning: channel missing, channel unchanged,
or channel released to the radio receiver."""
SHORTEST_PULSE, LONGEST_PULSE = 800, 2200
"""Range of valid pulse widths (µs) of a radio receiver. Other pulses are ignored."""
RELEASED = 0
FIRST_CHANNELS = 8
"""Number of channels that a ground station releases by the value RELEASED."""


class FlightCommand(NamedTuple):
    """Id of a MAVLink command, and the first two parameters of the command."""

    command: int
    first: float
    second: float


FLIGHT_COMMANDS = {
    HOLD: FlightCommand(CommandCode.OVERRIDE_GOTO, GOTO_HOLD, 2),
    RESUME: FlightCommand(CommandCode.OVERRIDE_GOTO, GOTO_CONTINUE, 2),
    END: FlightCommand(CommandCode.LAND, 0, 0),
}
"""MAVLink command that is sent for each request (hold, resume, end), by the request's name."""


def parse_request(flight_command: FlightCommand) -> str | None:
    """Return the hold, resume or end request in a command, DENIED if the request is not possible, or None for any other
    command."""
    command, first, second = flight_command
    if command == CommandCode.LAND:
        return END
    if command == CommandCode.PAUSE_CONTINUE:
        return PAUSES.get(first, DENIED)
    if command == CommandCode.OVERRIDE_GOTO:
        if first == GOTO_HOLD:
            return HOLD if second in HOLD_POSITIONS else DENIED
        return RESUME if first == GOTO_CONTINUE else DENIED
    return None


def parse_channels(message: Message) -> ReceiverChannels:
    """Return the pulse widths in a message RC_CHANNELS or RC_CHANNELS_OVERRIDE."""
    fields = message.fields()
    many = fields.get("chancount", CHANNELS)
    raw = [fields[f"chan{k + 1}_raw"] for k in range(CHANNELS)]
    absent = ABSENT[message.name]
    is_pulse = [v not in absent and k < many and SHORTEST_PULSE <= v <= LONGEST_PULSE for k, v in enumerate(raw)]
    is_override = message.name == "RC_CHANNELS_OVERRIDE"
    is_release = is_override and set(raw[:FIRST_CHANNELS]) == {RELEASED} and all(v in absent for v in raw)
    return ReceiverChannels(tuple(v * 1e-6 if good else NAN for v, good in zip(raw, is_pulse, strict=True)), is_release)


def parse_joystick(message: Message) -> JoystickAxes:
    """Return the joystick axes in a message MANUAL_CONTROL. A value outside ±1000 means that the axis is missing."""
    return JoystickAxes(*(v / 1000 if abs(v) <= 1000 else NAN for v in map(message.get, "xyzr")))

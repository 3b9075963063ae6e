"""Numbers of MAVLink's common dialect that the vehicle's end speaks. Source: https://mavlink.io/en/messages/common.html."""

from enum import IntEnum, IntFlag


class VehicleType(IntEnum):
    """MAV_TYPE."""

    GENERIC = 0
    FIXED_WING = 1
    GROUND_STATION = 6
    GROUND_ROVER = 10
    SURFACE_BOAT = 11
    ONBOARD_COMPUTER = 18


class ModeFlag(IntFlag):
    """MAV_MODE_FLAG."""

    CUSTOM = 1
    MANUAL_INPUT = 64
    ARMED = 128


class State(IntEnum):
    """MAV_STATE."""

    BOOT = 1
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    EMERGENCY = 6


class Order(IntEnum):
    """MAV_CMD."""

    LAND = 21
    SET_MODE = 176
    TERMINATE = 185
    PAUSE_CONTINUE = 193
    OVERRIDE_GOTO = 252
    ARM = 400
    GET_INTERVAL = 510
    SET_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_CAPABILITIES = 520


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    NOT_NOW = 1
    DENIED = 2
    UNSUPPORTED = 3


class Severity(IntEnum):
    """MAV_SEVERITY."""

    EMERGENCY = 0
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Capability(IntFlag):
    """MAV_PROTOCOL_CAPABILITY."""

    COMMAND_INT = 8
    MAVLINK2 = 8192
    PARAMETERS_AS_FLOAT = 131072


GENERIC_AUTOPILOT = 0
REAL_32 = 9
SET_MODE_MESSAGE = 11
"""The number of SET_MODE, which is what its acknowledgement names."""

"""Vehicle type, from which a ground station chooses the symbol and the instruments of a vehicle.

Source: MAV_TYPE of https://mavlink.io/en/messages/common.html.
"""

from enum import IntEnum
from typing import Any

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.suggestions import closest


class VehicleType(IntEnum):
    """Values of MAV_TYPE for vehicles, ground stations and onboard computers."""

    GENERIC = 0
    FIXED_WING = 1
    QUADROTOR = 2
    COAXIAL = 3
    HELICOPTER = 4
    ANTENNA_TRACKER = 5
    GROUND_STATION = 6
    AIRSHIP = 7
    FREE_BALLOON = 8
    ROCKET = 9
    GROUND_ROVER = 10
    SURFACE_BOAT = 11
    SUBMARINE = 12
    HEXAROTOR = 13
    OCTOROTOR = 14
    TRICOPTER = 15
    FLAPPING_WING = 16
    KITE = 17
    ONBOARD_COMPUTER = 18
    VTOL_DUOROTOR = 19
    VTOL_QUADROTOR = 20
    VTOL_TILTROTOR = 21
    GIMBAL = 26
    PARAFOIL = 28
    DODECAROTOR = 29
    DECAROTOR = 35
    PARACHUTE = 37
    WINCH = 42
    GENERIC_MULTIROTOR = 43
    SPACECRAFT_ORBITER = 45
    GROUND_QUADRUPED = 46
    VTOL_GYRODYNE = 47


def mav_type(vehicle: Any) -> VehicleType:
    """Return the type named by the vehicle's class variable MAV_TYPE, e.g. "SURFACE_BOAT"; GENERIC if it is missing."""
    name = optional_member(vehicle, "MAV_TYPE")
    if name not in VehicleType.__members__:
        problem = f"{type(vehicle).__name__} declares MAV_TYPE = {name!r}, which is not a known type"
        choices = tuple(VehicleType.__members__)
        near = closest(str(name).upper().removeprefix("MAV_TYPE_"), choices, 1) or ["GENERIC"]
        raise InputError(
            "world.vehicle", problem, choices=choices, fix=f'write MAV_TYPE = "{near[0]}", or leave it out'
        )
    return VehicleType[name]

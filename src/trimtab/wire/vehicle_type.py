"""What a vehicle says it is: MAV_TYPE, as its record declares it.

Source: https://mavlink.io/en/messages/common.html#MAV_TYPE.
"""

from typing import Any

from trimtab.core.errors import InputError
from trimtab.wire.protocol import VehicleType


def type_of(vehicle: Any) -> VehicleType:
    """By the class variable MAV_TYPE, the name without its prefix, e.g. "SURFACE_BOAT"; GENERIC without one."""
    name = getattr(vehicle, "MAV_TYPE", VehicleType.GENERIC.name)
    if name not in VehicleType.__members__:
        problem = f"{type(vehicle).__name__} declares MAV_TYPE = {name!r}, which is none that is known"
        choices = tuple(VehicleType.__members__)
        raise InputError("world.vehicle", problem, choices=choices, fix='write MAV_TYPE = "GENERIC", or leave it out')
    return VehicleType[name]

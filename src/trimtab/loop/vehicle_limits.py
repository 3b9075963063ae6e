"""Limits that a vehicle itself watches in flight (fence, envelope of speed and attitude), and its criteria for rest.

Source: docs page, Arming.
"""

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, seconds

NO_LIMIT = 1e9
"""A limit of this value or more is off, and needs no sensor."""


@record
class VehicleLimits:
    """Bounds on the vehicle's own measurements, all off by default; beyond a bound the vehicle goes to failsafe.

    Frames:  W for the distance, B for the rest.
    Not modelled: a fence with corners; attitude where no sensor gives one.
    Source:  docs page, Arming; numbers are this project's.
    """

    distance: Scalar = quantity(
        "m", "Fence: maximum distance from the origin, in the plane.", default=NO_LIMIT, above=0
    )
    speed: Scalar = quantity("m/s", "Envelope: maximum speed.", default=NO_LIMIT, above=0)
    rate: Scalar = quantity("rad/s", "Envelope: maximum rate of turn.", default=NO_LIMIT, above=0)
    angle: Scalar = quantity("rad", "Envelope: maximum angle of attack.", default=NO_LIMIT, above=0)
    patience: int = period("Time outside a limit before the failsafe acts.", default=ms(100))
    rest_speed: Scalar = quantity("m/s", "Maximum mean speed of a vehicle at rest.", default=0.3, above=0)
    rest_rate: Scalar = quantity("rad/s", "Maximum mean rate of turn of a vehicle at rest.", default=0.5, above=0)
    rest_time: int = period("Averaging time of the speed and rate at rest.", default=seconds(1))

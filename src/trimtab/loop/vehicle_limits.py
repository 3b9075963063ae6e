"""Limits that a vehicle checks on board: a fence, and an envelope of speed, rate and angle. Criteria for being at rest.

Source: docs page, Arming.
"""

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, seconds

NO_LIMIT = 1e9
"""Value at or above which a limit is switched off. A limit that is switched off needs no sensor."""


@record
class VehicleLimits:
    """Limits on the vehicle's measurements, all off by default. If a limit is exceeded, the failsafe acts.

    Frames:  W for the distance, B for the other limits.
    Not modelled: a fence with corners; limits of roll and pitch.
    Source:  docs page, Arming; the default values are our choice.
    """

    distance: Scalar = quantity(
        "m", "Fence: maximum distance from the origin, in the plane.", default=NO_LIMIT, above=0
    )
    speed: Scalar = quantity("m/s", "Envelope: maximum speed.", default=NO_LIMIT, above=0)
    rate: Scalar = quantity("rad/s", "Envelope: maximum rate of turn.", default=NO_LIMIT, above=0)
    angle: Scalar = quantity("rad", "Envelope: maximum angle of attack.", default=NO_LIMIT, above=0)
    patience: int = period("Time for which a limit must be exceeded before the failsafe acts.", default=ms(100))
    rest_speed: Scalar = quantity("m/s", "Maximum mean speed of a vehicle at rest.", default=0.3, above=0)
    rest_rate: Scalar = quantity("rad/s", "Maximum mean rate of turn of a vehicle at rest.", default=0.5, above=0)
    rest_time: int = period(
        "Averaging time of speed and rate of turn for the check that the vehicle is at rest.", default=seconds(1)
    )

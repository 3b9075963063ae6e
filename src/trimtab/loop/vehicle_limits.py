"""Limits that a vehicle checks on board: a fence, and an envelope of speed, turn rate and angle of attack.

The module also contains the criteria for a vehicle at rest.

Source: docs page, Arming.
"""

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, seconds

NO_LIMIT = 1e9
"""Threshold from which on a limit counts as switched off. A limit that is switched off needs no sensor."""


@record
class VehicleLimits:
    """Limits on the vehicle's measured motion, all switched off by default. If a limit is exceeded, the failsafe acts.

    Frames:  W (world) for the distance, B (body) for the other limits.
    Not modelled: a polygonal fence; limits on roll and pitch angles.
    Source:  docs page, Arming; the default values are our choice.
    """

    distance: Scalar = quantity(
        "m", "Fence: maximum horizontal distance from the origin of the world frame.", default=NO_LIMIT, above=0
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

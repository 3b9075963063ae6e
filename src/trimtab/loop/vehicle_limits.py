"""What a vehicle watches of itself in flight, and what it takes for rest: a fence, an envelope of speed and attitude.

Source: docs page, Arming.
"""

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, seconds

NO_LIMIT = 1e9
"""A limit of this or more is none, and what it would bound needs no sensor."""


@record
class VehicleLimits:
    """Bounds on what the vehicle's own sensors say, none of them on by default; beyond one it goes to failsafe.

    Frames:  W for the distance, B for the rest.
    Not modelled: a fence with corners; attitude where no sensor gives one.
    Source:  docs page, Arming; numbers are this project's.
    """

    distance: Scalar = quantity("m", "Fence: farthest from the origin, in the plane.", default=NO_LIMIT, above=0)
    speed: Scalar = quantity("m/s", "Envelope: greatest speed.", default=NO_LIMIT, above=0)
    rate: Scalar = quantity("rad/s", "Envelope: greatest rate of turn.", default=NO_LIMIT, above=0)
    angle: Scalar = quantity("rad", "Envelope: greatest angle of attack.", default=NO_LIMIT, above=0)
    patience: int = period("For how long it has to be outside.", default=ms(100))
    rest_speed: Scalar = quantity("m/s", "Greatest mean speed of a vehicle at rest.", default=0.3, above=0)
    rest_rate: Scalar = quantity("rad/s", "Greatest mean rate of turn of a vehicle at rest.", default=0.5, above=0)
    rest_time: int = period("Over which these are means.", default=seconds(1))

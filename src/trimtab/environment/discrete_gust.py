"""Single gust that rises as one minus a cosine over the distance flown."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record

ZERO = (0.0, 0.0, 0.0)


@record
class DiscreteGust:
    """Gust of the form 1 - cos over the distance s flown since the start of the gust.

        ramp     v = v_m/2 (1 - cos(pi s/d))       until s = d, and v_m from there on    [1]
        pulse    the same formula until s = 2 d, where v is zero again, and zero from there on    [2]

    Frames:  B.    Not modelled: the delay between nose and tail.
    Source:  [1] MIL-F-8785C, "Flying qualities of piloted airplanes", 1980, 3.7.1.3; [2] 14 CFR 25.341(a)(2).
    """

    velocity: Any = quantity(
        "m/s",
        "Maximum velocity v_m of the air in the gust.",
        frame="B",
        default=ZERO,
        shape=(3,),
        off={"discrete-gust": ZERO},
    )
    length: Scalar = quantity("m", "Distance d over which the gust rises.", default=100.0, above=0)
    start: Scalar = quantity("s", "Time at which the vehicle enters the gust.", default=1.0, low=0)
    form: str = option(
        "Form of the gust after its maximum: falling (pulse) or constant (ramp).",
        default="pulse",
        choices=("pulse", "ramp"),
    )

    def shape(self, distance: Any) -> Any:
        """Return the gust velocity at a distance (m) into the gust, as a fraction of the maximum velocity, 0 to 1."""
        last = 1.0 if self.form == "ramp" else 2.0
        s = jnp.clip(distance / self.length, 0.0, last)
        return (1 - jnp.cos(np.pi * s)) / 2

    def advance(self, seconds: Any, distance: Any, speed: Any, dt: Any) -> Any:
        """Return the distance (m) flown into the gust at the time `seconds` + dt (s).

        distance: the same distance at the time `seconds`. speed: the vehicle's speed (m/s).
        """
        inside = jnp.clip(seconds + dt - self.start, 0.0, dt)
        return distance + speed * inside

    def air(self, distance: Any) -> Any:
        """Return the velocity (3,) (m/s) of the air in B at a distance (m) into the gust."""
        return self.shape(distance) * jnp.asarray(self.velocity)

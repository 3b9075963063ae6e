"""A single gust that rises as one minus a cosine over a distance flown."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, option, quantity, record

ZERO = (0.0, 0.0, 0.0)


@record
class DiscreteGust:
    """A gust of the form 1 - cos over the distance s flown since it was met.

        ramp     v = v_m/2 (1 - cos(pi s/d))       until s = d, and v_m from there on    [1]
        pulse    the same until s = 2 d, where it is zero again, and zero from there on    [2]

    Frames:  B.    Not modelled: the delay between nose and tail.
    Source:  [1] MIL-F-8785C, "Flying qualities of piloted airplanes", 1980, 3.7.1.3; [2] 14 CFR 25.341(a)(2).
    """

    velocity: Any = quantity(
        "m/s", "Maximum velocity of the air v_m.", frame="B", default=ZERO, shape=(3,), off={"discrete-gust": ZERO}
    )
    length: Scalar = quantity("m", "Distance d over which the gust rises.", default=100.0, above=0)
    start: Scalar = quantity("s", "Time at which the gust is met.", default=1.0, low=0)
    form: str = option(
        "Form after the maximum: falling (pulse) or constant (ramp).", default="pulse", choices=("pulse", "ramp")
    )

    def shape(self, distance: Any) -> Any:
        """Return the fraction of the maximum velocity, 0 to 1, at a distance s (m) into the gust; 0 before the gust."""
        last = 1.0 if self.form == "ramp" else 2.0
        s = jnp.clip(distance / self.length, 0.0, last)
        return (1 - jnp.cos(np.pi * s)) / 2

    def advance(self, seconds: Any, distance: Any, speed: Any, dt: Any) -> Any:
        """Return the distance (m) into the gust dt (s) after a time (s), flying at a speed (m/s)."""
        inside = jnp.clip(seconds + dt - self.start, 0.0, dt)
        return distance + speed * inside

    def air(self, distance: Any) -> Any:
        """Return the velocity (3,) (m/s) of the air in B at a distance (m) into the gust."""
        return self.shape(distance) * jnp.asarray(self.velocity)

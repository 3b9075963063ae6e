"""The whole state of the flexible hypersonic vehicle without error: what the ideal twin of a run flies on."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, new_sample
from trimtab.core.time import ms
from trimtab.vehicles.hypersonic import HypersonicState


@record
class FlexibleTruthReading:
    """Flight and modes as they are. Source: [1] eq. 4, order of its errors e."""

    h: Scalar = quantity("ft", "Altitude.", frame="W")
    h_rate: Scalar = quantity("ft/s", "Its rate.", frame="W")
    V: Scalar = quantity("ft/s", "Speed along the path.")
    alpha: Scalar = quantity("rad", "Angle of attack.", kind="angle")
    q: Scalar = quantity("rad/s", "Pitch rate, nose up.", frame="B")
    eta1: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 1.")
    eta1_rate: Scalar = quantity("(slug ft)^1/2/s", "Its rate.")
    eta2: Scalar = quantity("(slug ft)^1/2", "Displacement of mode 2.")
    eta2_rate: Scalar = quantity("(slug ft)^1/2/s", "Its rate.")


@record
class FlexibleTruth:
    """Full state of `vehicles.hypersonic`; no such sensor exists for the modes, so only an ideal twin may have it.

    Frames:  as the state's.
    Source:  [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
             flight vehicle", Aerospace 2022, 9(4), 206: full-state feedback, its comparison.
    """

    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "state"

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, x: HypersonicState) -> FlexibleTruthReading:
        """The state, with the climb in the place of the pitch angle."""
        climb = x.V * jnp.sin(x.theta - x.alpha)
        return FlexibleTruthReading(x.h, climb, x.V, x.alpha, x.q, x.eta1, x.eta1_rate, x.eta2, x.eta2_rate)

    def step(self, t: Any, state: tuple[()], x: HypersonicState) -> tuple[tuple[()], Sample]:
        """The sample at integer time t."""
        return state, new_sample(t, self.measure(x))

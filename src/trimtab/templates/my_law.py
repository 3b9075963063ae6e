"""A law of your own, a ship's autopilot as it stands here: trimtab run my_law.py:scenario"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab import Scenario, Target, build, part, quantity, record, replace, seconds
from trimtab.core.record import Scalar
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.vehicles.surface_vessel import VesselControls


@record
class MyLawOutput:  # all of it is logged: law.demand.rudder, law.off_course
    """What the law wants, and how far off it is. Source: this file."""

    demand: VesselControls = part("Rudder (rad) and shafts (rad/s); of another vehicle its own input.")
    off_course: Scalar = quantity("rad", "Heading less the one wanted.", frame="WB", kind="angle")


@record
class MyLaw:  # its fields are settings: --set autopilot.law.k_heading=2
    """Holds a heading by the rudder, the shafts turning steadily. Source: this file."""

    heading: Scalar = quantity("rad", "Wanted, from north, clockwise.", frame="WB", kind="angle", default=1.0)
    k_heading: Scalar = quantity("1", "Rudder by heading.", default=1.0, low=0)
    k_rate: Scalar = quantity("s", "Rudder by rate of turn.", default=2.0, low=0)
    most: Scalar = quantity("rad", "Rudder at most.", default=0.5, above=0)
    shaft_speed: Scalar = quantity("rad/s", "Of the propellers.", default=100.0, low=0)

    reads: ClassVar[tuple[str, ...]] = ("yaw_rate", "heading")  # what the estimate must have: rad/s in B, rad

    def init(self, key: Any) -> tuple[()]:
        """The first state: none. An integral, say, would be a record, and step() would return the next one."""
        return ()

    def step(self, t: Scalar, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], MyLawOutput]:
        """The demand at integer time t (100 ns); estimate.dt (s) is the time between two steps."""
        off = wrap(estimate.state.heading - self.heading)  # rad, the shorter way
        rudder = self.k_heading * off + self.k_rate * estimate.state.yaw_rate  # pushes the stern to starboard
        demand = VesselControls(jnp.clip(rudder, -self.most, self.most), self.shaft_speed)
        return state, MyLawOutput(demand, off)


def scenario() -> Scenario:
    """A model ship in a current, steered from ashore over a radio."""
    base = build("vessel/path")
    autopilot = replace(base.autopilot, law=MyLaw())
    goal = Target("law.off_course", 0.0, 0.1)  # value, band: rad
    return replace(base, autopilot=autopilot, targets=(goal,), duration=seconds(30), name="my_law")

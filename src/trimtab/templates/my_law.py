"""A law of your own, at first a ship's autopilot: trimtab run my_law.py:scenario"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab import Scenario, Target, build, part, quantity, record, replace, seconds
from trimtab.core.record import Scalar
from trimtab.core.rotation import wrap
from trimtab.core.signals import Estimate
from trimtab.vehicles.surface_vessel import VesselControls


@record
class MyLawOutput:  # all fields are logged: law.demand.rudder, law.off_course
    """Output of the law: demanded rudder and shaft speed, and heading error. Source: this file."""

    demand: VesselControls = part("Rudder angle (rad) and shaft speed (rad/s). For another vehicle, use its input.")
    off_course: Scalar = quantity("rad", "Heading minus desired heading.", frame="WB", kind="angle")


@record
class MyLaw:  # its fields are settings: --set autopilot.law.k_heading=2
    """Heading control by the rudder, at constant shaft speed. Source: this file."""

    heading: Scalar = quantity("rad", "Desired heading from north, clockwise.", frame="WB", kind="angle", default=1.0)
    k_heading: Scalar = quantity("1", "Gain from heading error to rudder angle.", default=1.0, low=0)
    k_rate: Scalar = quantity("s", "Gain from rate of turn to rudder angle.", default=2.0, low=0)
    most: Scalar = quantity("rad", "Maximum rudder angle.", default=0.5, above=0)
    shaft_speed: Scalar = quantity("rad/s", "Speed of the propeller shafts.", default=100.0, low=0)

    reads: ClassVar[tuple[str, ...]] = ("yaw_rate", "heading")  # fields of the estimate: rad/s in B, rad

    def init(self, key: Any) -> tuple[()]:
        """Return the initial state, here empty. For a law with an integral, use a record as the state."""
        return ()

    def step(self, t: Scalar, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], MyLawOutput]:
        """Return state and output at integer time t (100 ns). estimate.dt is the control period (s)."""
        off = wrap(estimate.state.heading - self.heading)  # rad, from -pi to pi
        rudder = self.k_heading * off + self.k_rate * estimate.state.yaw_rate  # pushes the stern to starboard
        demand = VesselControls(jnp.clip(rudder, -self.most, self.most), self.shaft_speed)
        return state, MyLawOutput(demand, off)


def scenario() -> Scenario:
    """Return the scenario: a model ship in a current, steered from ashore over a radio."""
    base = build("vessel/path")
    autopilot = replace(base.autopilot, law=MyLaw())
    goal = Target("law.off_course", 0.0, 0.1)  # value, band: rad
    return replace(base, autopilot=autopilot, targets=(goal,), duration=seconds(30), name="my_law")

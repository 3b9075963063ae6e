"""A cart on a rail with minimal parts, so that every number of a run is known in advance."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.actuators.allocation import DirectAllocation, DirectOutput
from trimtab.core.record import part, period, quantity, record, replace
from trimtab.core.signals import Sample, new_sample, no_motion
from trimtab.core.time import seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.world import World

SECOND = seconds(1)


@record
class Place:
    """Where the cart is. Source: this test."""

    x: Any = quantity("m", "Along the rail.")


@record
class Speed:
    """How fast it is driven. Source: this test."""

    v: Any = quantity("m/s", "Along the rail.")


@record
class Cart:
    """x' = v, where v is the input. Source: this test."""

    def dynamics(self, t: Any, x: Place, u: Speed) -> Place:
        return Place(jnp.asarray(u.v, np.float64))

    def motion(self, t: Any, x: Place, u: Speed) -> Any:
        zero = jnp.zeros(())
        return replace(no_motion(), t=t, p_WB=jnp.stack([x.x, zero, zero]), v_WB_B=jnp.stack([u.v, zero, zero]))


@record
class RulerReading:
    """Reading of the ruler. Source: this test."""

    x: Any = quantity("m", "Along the rail.")
    v: Any = quantity("m/s", "Along the rail.")


@record
class Ruler:
    """Position and speed without error; the state counts the samples. Source: this test."""

    period: int = period("Time between samples.", default=SECOND)

    def init(self, key: Any) -> Any:
        return np.int32(0)

    def measure(self, motion: Any) -> RulerReading:
        return RulerReading(x=motion.p_WB[0], v=motion.v_WB_B[0])

    def step(self, t: Any, state: Any, motion: Any) -> tuple[Any, Sample]:
        return state + 1, new_sample(t, self.measure(motion))


@record
class Drive:
    """Applies the command; the output is zero before the first command. Source: this test."""

    period: int = period("How often it acts.", default=SECOND)

    def neutral(self) -> DirectOutput:
        return DirectOutput(u=Speed(0.0))

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: tuple[()], command: Sample) -> tuple[tuple[()], DirectOutput]:
        return state, DirectOutput(u=Speed(jnp.where(command.valid, command.value.v, 0.0)))


@record
class LawOutput:
    """Demand of the law. Source: this test."""

    demand: Any = part("The speed.")


@record
class Doubling:
    """v = 1 + x; its state counts the steps. Source: this test."""

    reads: ClassVar[tuple[str, ...]] = ("x",)

    def init(self, key: Any) -> Any:
        return np.int32(0)

    def step(self, t: Any, state: Any, estimate: Any) -> tuple[Any, LawOutput]:
        return state + 1, LawOutput(demand=Speed(1.0 + estimate.state.x))


def cart_world(**parts: Any) -> World:
    """Return a cart with a ruler, wires and a drive, each with a period of one second; keywords replace parts."""
    wire = Wire(period=SECOND)
    whole = {"sensors": {"ruler": Ruler()}, "actuators": Drive(), "downlink": wire, "uplink": wire, "max_step": SECOND}
    return World(vehicle=Cart(), **(whole | parts))


def cart_autopilot(**parts: Any) -> Autopilot:
    """Return an autopilot that acts on the ruler each second; keywords replace parts."""
    whole = {"estimator": Passthrough("ruler"), "law": Doubling(), "allocation": DirectAllocation(), "period": SECOND}
    return Autopilot(**(whole | parts))

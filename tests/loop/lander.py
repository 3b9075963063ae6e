"""A lander in space as a new user writes it: vectors and a quaternion in its state, fields named r, t, x and self.

The demand differs from the vehicle's input, and numbers are integers. Run:  trimtab run tests/loop/lander.py:hover
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.actuators.allocation import DirectActuation, DirectAllocation, DirectOutput
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record, replace
from trimtab.core.signals import Motion, new_sample
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import DelayChain
from trimtab.logs.metrics import Target
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World

G = 9.81


@record
class LanderState:
    """Position, velocity and attitude. Source: this test."""

    r: Any = quantity("m", "Position.", frame="W", shape=(3,), default=(0, 0, -10))
    v: Any = quantity("m/s", "Velocity.", frame="W", shape=(3,), default=(1, 0, 0))
    q: Any = quantity("1", "Attitude, a quaternion.", frame="WB", shape=(4,), default=(1, 0, 0, 0))
    t: Scalar = quantity("s", "Time since the start.", default=0)
    x: Scalar = quantity("m", "Way that was flown.", default=0)
    altitude: Scalar = quantity("m", "Height over the ground.", default=10)


@record
class Thrust:
    """Force on the vehicle. Source: this test."""

    F: Any = quantity("N", "Force.", frame="W", shape=(3,))


@record
class Lander:
    """A mass on three engines, turning at a constant rate. Source: this test."""

    mass: Scalar = quantity("kg", "Mass.", default=2, above=0)
    r: Scalar = quantity("rad/s", "Rate of turn about its axis.", default=1)

    MAV_TYPE: ClassVar[str] = "ROCKET"

    def acceleration(self, u: Thrust) -> Any:
        return u.F / self.mass + jnp.array([0.0, 0.0, G])

    def dynamics(self, t: Any, x: LanderState, u: Thrust) -> LanderState:
        dq = self.r / 2 * jnp.stack([-x.q[3], x.q[2], -x.q[1], x.q[0]])
        return LanderState(
            r=x.v, v=self.acceleration(u), q=dq, t=1, x=jnp.sqrt(jnp.sum(x.v**2) + 1e-12), altitude=-x.v[2]
        )

    def motion(self, t: Any, x: LanderState, u: Thrust) -> Motion:
        zero = jnp.zeros(3)
        return Motion(t, x.r, zero, x.v, jnp.array([0.0, 0.0, 1.0]) * self.r, self.acceleration(u), zero)


@record
class GpsReading:
    """Position and velocity. Source: this test."""

    r: Any = quantity("m", "Position.", frame="W", shape=(3,))
    v: Any = quantity("m/s", "Velocity.", frame="W", shape=(3,))


@record
class Gps:
    """Measures position and velocity without error. Source: this test."""

    period: int = period("Time between samples.", default=ms(10))

    def init(self, key: Any) -> tuple[()]:
        return ()

    def measure(self, motion: Motion) -> GpsReading:
        return GpsReading(motion.p_WB, motion.v_WB_B)

    def step(self, t: Any, state: Any, motion: Motion) -> Any:
        return state, new_sample(t, self.measure(motion))


@record
class HoverOutput:
    """Output of the law. Source: this test."""

    demand: Any = part("What is wanted.")
    error: Any = quantity("m", "Way to go.", frame="W", shape=(3,))
    climb_error: Any = quantity("m", "Way to go upwards.")
    flown: Any = quantity("s", "Sum of the control periods.")


@record
class Hover:
    """Spring-damper law to a point above the ground; counts time by its own period. Source: this test."""

    k: Scalar = quantity("N/m", "Spring.", default=3)
    height: Scalar = quantity("m", "Wanted.", default=5)

    reads: ClassVar[tuple[str, ...]] = ("r", "v")

    def init(self, key: Any) -> Any:
        return 0.0

    def force(self, e: Any, v: Any) -> Any:
        return self.k * e - 4 * v - jnp.array([0.0, 0.0, 2 * G])

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        e = jnp.array([0.0, 0.0, -1.0]) * self.height - estimate.state.r
        flown = state + estimate.dt
        return flown, HoverOutput(Thrust(self.force(e, estimate.state.v)), e, -e[2], flown)


@record
class Throttle:
    """A command to three engines. Source: this test."""

    share: Any = quantity("1", "Of full thrust, each.", shape=(3,))


@record
class Mixer:
    """Thrust wanted to throttle. Source: this test."""

    top: Scalar = quantity("N", "Full thrust.", default=100, above=0)

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, demand: Thrust) -> Any:
        return state, Throttle(demand.F / self.top)


@record
class Acceleration:
    """Demand as an acceleration. Source: this test."""

    a: Any = quantity("m/s^2", "Acceleration without gravity's.", frame="W", shape=(3,))


@record
class AccelerationHover(Hover):
    """The same law in accelerations of a mass of 2 kg. Source: this test."""

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        flown, output = Hover.step(self, t, state, estimate)
        return flown, replace(output, demand=Acceleration(output.demand.F / 2))


@record
class AccelerationMixer(Mixer):
    """Acceleration wanted to throttle. Source: this test."""

    def step(self, t: Any, state: Any, demand: Acceleration) -> Any:
        return state, Throttle(2 * demand.a / self.top)


@record
class Engines:
    """Throttle to thrust; a tenth of it is lost. Source: this test."""

    top: Scalar = quantity("N", "Full thrust.", default=100, above=0)
    lost: Scalar = imperfection("1", "Share of the thrust.", "weak-engines", default=0.1)
    period: int = period("How often they act.", default=ms(2))

    def neutral(self) -> DirectOutput:
        return DirectOutput(u=Thrust(jnp.zeros(3)))

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, command: Any) -> Any:
        F = command.value.share * self.top * (1 - self.lost)
        return state, DirectOutput(u=Thrust(jnp.where(command.valid, F, 0.0)))


def hover() -> Scenario:
    """From ten metres down to five, over a radio."""
    link = DelayChain(period=ms(20), steps=2)
    world = World(Lander(), {"gps": Gps()}, DirectActuation(neutral_input=Thrust(jnp.zeros(3))), link, link)
    targets = Target("truth.r[2]", -5, 0.1), Target("truth.altitude", 5, 0.1), Target("law.climb_error", 0, 0.1)
    autopilot = Autopilot(Passthrough("gps"), Hover(), DirectAllocation(), period=ms(2))
    return Scenario(world, autopilot, LanderState(), seconds(4), targets)


def engines() -> Scenario:
    """The same with a demand that is an acceleration, a command that is a throttle, and an input that is a force."""
    scenario = hover()
    autopilot = replace(scenario.autopilot, law=AccelerationHover(), allocation=AccelerationMixer())
    return replace(scenario, world=replace(scenario.world, actuators=Engines()), autopilot=autopilot)

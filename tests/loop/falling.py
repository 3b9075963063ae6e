"""Vehicles that one RK4 step per millisecond integrates badly: a mass on a stiff floor, a bouncing ball, a top."""

from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.actuators.allocation import DirectActuation, DirectAllocation
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import Motion, PlanarForce
from trimtab.core.time import ms, seconds
from trimtab.estimators.passthrough import Passthrough
from trimtab.links.wire import Wire
from trimtab.loop.autopilot import Autopilot
from trimtab.loop.integration import Integration
from trimtab.loop.scenario import Scenario
from trimtab.loop.world import World
from trimtab.sensors.navigation_errors import PlanarNavigation

G = 9.81


@record
class HeightState:
    """Height and speed, up. Source: this test."""

    z: Scalar = quantity("m", "Height.", frame="W", default=1.0)
    w: Scalar = quantity("m/s", "Its rate.", frame="W", default=0.0)


def motion_of(t: Any, z: Any, w: Any) -> Motion:
    """Return a planar motion of zeros."""
    o = 0.0 * z
    zero = jnp.stack([o, o, o])
    return Motion(t, jnp.stack([o, o, -z]), zero, jnp.stack([o, o, -w]), zero, zero, zero)


@record
class StiffFloor:
    """z'' = -g + (k p + c p')/m while p = -z > 0, the floor never pulling. Source: this test."""

    mass: Scalar = quantity("kg", "Mass.", default=1.0, above=0)
    k: Scalar = quantity("N/m", "Stiffness of the floor.", default=1e7)
    c: Scalar = quantity("N s/m", "Its damping.", default=2e3)

    def acceleration(self, z: Any, w: Any) -> Any:
        return -G + jnp.where(z < 0, jnp.maximum(-self.k * z - self.c * w, 0.0), 0.0) / self.mass

    def dynamics(self, t: Any, x: HeightState, u: PlanarForce) -> HeightState:
        return HeightState(x.w, self.acceleration(x.z, x.w))

    def motion(self, t: Any, x: HeightState, u: PlanarForce) -> Motion:
        return motion_of(t, x.z, x.w)


@record
class Touching(StiffFloor):
    """The same, with events at the contact. Source: this test."""

    def events(self, t: Any, x: HeightState) -> tuple[Any, ...]:
        return (x.z, -self.k * x.z - self.c * x.w)


@record
class Ball:
    """Falls freely and bounces, keeping a fraction of its speed. Source: this test."""

    kept: Scalar = quantity("1", "Of the speed at each bounce.", default=0.8, low=0, high=1)

    def dynamics(self, t: Any, x: HeightState, u: PlanarForce) -> HeightState:
        return HeightState(x.w, -G)

    def motion(self, t: Any, x: HeightState, u: PlanarForce) -> Motion:
        return motion_of(t, x.z, x.w)

    def events(self, t: Any, x: HeightState) -> tuple[Any, ...]:
        return (x.z,)

    def jump(self, t: Any, x: HeightState, crossed: Any) -> HeightState:
        return HeightState(0.0, -self.kept * x.w)


@record
class TopState:
    """Attitude. Source: this test."""

    q: Any = quantity("1", "Quaternion.", shape=(4,), default=(1.0, 0.0, 0.0, 0.0))


@record
class Top:
    """Turns about three axes at once. Source: this test."""

    def dynamics(self, t: Any, x: TopState, u: PlanarForce) -> TopState:
        a, b, c, d = (x.q[i] for i in range(4))
        p, q, r = 40.0, -30.0, 20.0
        products = (-b * p - c * q - d * r, a * p + c * r - d * q, a * q - b * r + d * p, a * r + b * q - c * p)
        return TopState(jnp.stack(products) / 2)

    def motion(self, t: Any, x: TopState, u: PlanarForce) -> Motion:
        return motion_of(t, x.q[0], x.q[1])


@record
class NormalisedTop(Top):
    """The same, its quaternion kept at length one. Source: this test."""

    def after_step(self, t: Any, x: TopState) -> TopState:
        return TopState(x.q / jnp.sqrt(jnp.sum(x.q**2)))


@record
class HandsOffOutput:
    """Empty demand. Source: this test."""

    demand: Any = part("No force.")


@record
class HandsOff:
    """A law that leaves the vehicle alone. Source: this test."""

    reads: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Any) -> tuple[()]:
        return ()

    def step(self, t: Any, state: Any, estimate: Any) -> Any:
        return state, HandsOffOutput(PlanarForce(0.0, 0.0))


def fall(
    vehicle: Any, initial: Any, integration: Integration | None = None, *, tick: int = ms(10), s: float = 1
) -> Any:
    """Return a scenario without control; all blocks run each millisecond."""
    world = World(
        vehicle,
        {"navigation": PlanarNavigation(period=tick)},
        DirectActuation(period=tick),
        Wire(period=tick),
        Wire(period=tick),
        max_step=tick,
        integration=integration,
    )
    autopilot = Autopilot(Passthrough("navigation"), HandsOff(), DirectAllocation(), period=tick)
    return Scenario(world, autopilot, initial, seconds(s))


def floor() -> Scenario:
    """Return a fall on the stiff floor with one step per millisecond."""
    return fall(StiffFloor(), HeightState(), tick=ms(1))

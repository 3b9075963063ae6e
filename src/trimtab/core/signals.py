"""The messages that the parts of the loop exchange. Every sample carries the time at which it was measured.

Frames: W is north-east-down with its origin on the floor; B sits at the centre of mass, x forward, y starboard, z down.
Times are integers of 100 ns; ages are seconds.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import NEVER, to_seconds


@record
class SurroundingAir:
    """The air about a vehicle, as its centre of mass meets it. Source: docs page, Turbulence."""

    height: Scalar = quantity("m", "Of the vehicle above the sea.")
    velocity: Any = quantity("m/s", "Of the air over the ground, in B.", frame="B", shape=(3,))
    rate: Any = quantity("rad/s", "At which the air turns about the vehicle.", frame="B", shape=(3,))


@record
class Gust:
    """What turbulence adds to the air about a vehicle. Source: docs page, Turbulence."""

    velocity: Any = quantity("m/s", "Forward, to starboard, down.", frame="B", shape=(3,))
    rate: Any = quantity("rad/s", "At which that air turns: roll, pitch, yaw.", frame="B", shape=(3,))


NO_GUST = Gust(np.zeros(3), np.zeros(3))
"""Air that is still, or moves as the mean wind does."""


@record
class Bending:
    """How a vehicle bends: its modes, by the numbers that its state has for them. Source: docs page, Hypersonic."""

    rate: Any = quantity("1/s", "Of each mode (n,), in its own unit.")
    acceleration: Any = quantity("1/s^2", "Of each mode (n,), in its own unit.")


@record
class Motion:
    """All that a sensor on the vehicle can feel, at one instant.

    Frames:  p_WB in W; attitude is roll, pitch, yaw (3-2-1) of B in W, unwrapped; the rest in B.
    Source:  docs page, Conventions.
    """

    t: Scalar = quantity("100 ns", "The instant.", kind="time")
    p_WB: Any = quantity("m", "Position: north, east, down.", frame="W", shape=(3,))
    attitude: Any = quantity("rad", "Roll, pitch, yaw; yaw counts full turns.", frame="WB", shape=(3,))
    v_WB_B: Any = quantity("m/s", "Velocity: surge, sway, heave.", frame="B", shape=(3,))
    w_WB_B: Any = quantity("rad/s", "Angular velocity: roll, pitch, yaw rate.", frame="B", shape=(3,))
    a_WB_B: Any = quantity("m/s^2", "Acceleration of the centre of mass in W, resolved in B.", frame="B", shape=(3,))
    alpha_WB_B: Any = quantity("rad/s^2", "Angular acceleration.", frame="B", shape=(3,))
    air: Any = part("The air about it, a SurroundingAir; nothing of a vehicle that knows none.", default=())
    bending: Any = part("Its modes, a Bending; nothing of a rigid vehicle.", default=())


def surrounding_air(motion: Motion) -> SurroundingAir:
    """The air about a vehicle; of one that knows none it is still, and the sea lies at the origin of W."""
    if isinstance(motion.air, SurroundingAir):
        return motion.air
    still = jnp.zeros_like(motion.v_WB_B)
    return SurroundingAir(height=-motion.p_WB[2], velocity=still, rate=still)


def no_motion() -> Motion:
    """At rest at the origin at time zero: the structure of a motion, where its numbers don't matter."""
    three = np.zeros(3)
    return Motion(np.int64(0), three, three, three, three, three, three)


@record
class Sample:
    """A value with the time at which it was measured; what sensors give and channels carry. Source: docs page, Time."""

    value: Any = part("What was measured.")
    t: Scalar = quantity("100 ns", "When it was measured.", kind="time")
    age: Scalar = quantity("s", "How long ago that was, for who holds it.")
    fresh: Scalar = quantity("1", "Whether it is seen for the first time.", kind="flag")
    valid: Scalar = quantity("1", "Whether there has been any measurement at all.", kind="flag")


def new_sample(t: Any, value: Any, *, fresh: Any = True) -> Sample:
    """The sample of a value measured now, at integer time t."""
    return Sample(value=value, t=t, age=0.0, fresh=fresh, valid=True)


def hold_sample(now: Any, sample: Sample, *, fresh: Any = False) -> Sample:
    """The same sample as seen at a later time `now`."""
    return replace(sample, age=to_seconds(now - sample.t), fresh=fresh)


def is_new(sample: Sample, seen: Any) -> Any:
    """Whether a sample has come since the one measured at integer time `seen` was held: what makes it fresh.

    Told by the time of measurement, for the two ends of a line need not keep the same time.
    """
    return sample.valid & (sample.fresh | (sample.t != seen))


@record
class Frame:
    """What the autopilot receives: the newest sample of every sensor, by the sensor's name. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "Now, at the autopilot.", kind="time")
    samples: Mapping[str, Sample] = part("Newest sample of each sensor.")


@record
class Estimate:
    """What a law reads. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "Now, at the autopilot.", kind="time")
    age: Scalar = quantity("s", "Time since the newest measurement in it was made.")
    fresh: Scalar = quantity("1", "Whether a measurement arrived at this instant.", kind="flag")
    valid: Scalar = quantity("1", "Whether the state means anything yet.", kind="flag")
    state: Any = part("The estimated state, a record.")
    stick: Any = part("Newest sample of the pilot's stick, for a law that asks for it; else None.", default=None)
    dt: Any = part("Time between two steps of the law (s), for the law alone; else None.", default=None)


STICK_MODES = ("manual", "damped", "assisted")
"""What a pilot's stick moves: the thrust vector, velocities in the body, the velocity over the floor."""


@record
class Stick:
    """Where a pilot holds the stick, and what it is to move. Frames: none. Source: docs page, Piloted."""

    forward: Scalar = quantity("1", "Pushed forward, -1 to 1.", low=-1, high=1)
    turn: Scalar = quantity("1", "Pushed to the side, -1 to 1; positive turns clockwise from above.", low=-1, high=1)
    mode: Scalar = quantity("1", "What it moves.", kind="mode", modes=STICK_MODES)


@record
class Command:
    """What the autopilot sends to the actuators. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "When it was issued.", kind="time")
    valid: Scalar = quantity("1", "False: the autopilot has no estimate yet, actuators stay neutral.", kind="flag")
    value: Any = part("Actuator commands, a record.")


@record
class PlanarState:
    """Velocity and heading of a vehicle in the plane: what planar laws read. Source: docs page, Conventions."""

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B")
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B")
    heading: Scalar = quantity("rad", "Angle from north to the body's x axis, clockwise; unwrapped.", kind="angle")


@record
class PlanarForce:
    """Horizontal force on the vehicle at the point where its thruster acts. Source: docs page, Conventions."""

    FX: Scalar = quantity("N", "Along the body's x axis.", frame="B")
    FY: Scalar = quantity("N", "Along the body's y axis.", frame="B")


@record
class PeerMessage:
    """What a craft of a swarm tells the others: the point that it follows. Source: docs page, Swarms."""

    t: Scalar = quantity("100 ns", "When it was true.", kind="time", default=np.int64(NEVER))
    north: Scalar = quantity("m", "Reference point.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Reference point.", frame="W", default=0.0)
    north_velocity: Scalar = quantity("m/s", "Of the reference point.", frame="W", default=0.0)
    east_velocity: Scalar = quantity("m/s", "Of the reference point.", frame="W", default=0.0)


@record
class Peers:
    """What a craft has heard of each craft of its swarm, by number. Not logged: it grows with the square of the number.

    Source: docs page, Swarms.
    """

    messages: Any = part("Newest message of each, as a tuple of the fields of PeerMessage, (n,); t NEVER: none.")

    def message(self) -> PeerMessage:
        """The messages as a record, fields (n,)."""
        return PeerMessage(*self.messages)


@record
class PeerView:
    """All that a craft of a swarm knows. Source: docs page, Swarms."""

    own: Any = part("Its own estimated state.")
    peers: Peers = part("What it has heard of the others.")


@record
class SwarmInput:
    """What each craft does, and what it says; demand, command and input of a swarm. Source: docs page, Swarms."""

    act: Any = part("What acts on each craft, or is asked of its actuators; fields (n,).")
    say: PeerMessage = part("What each has to say; fields (n,).")


@record
class SwarmMotion:
    """All that sensors on the craft of a swarm can feel. Source: docs page, Swarms."""

    each: Motion = part("Of each craft, fields (n, …).")
    say: PeerMessage = part("What each says, fields (n,).")

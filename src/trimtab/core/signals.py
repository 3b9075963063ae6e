"""Messages that the parts of the loop exchange. Every sample carries the time of its measurement.

Frames: W is north-east-down with its origin on the floor; B sits at the centre of mass, x forward, y starboard, z down.
Times are integers in units of 100 ns; ages are in seconds.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import NEVER, to_seconds


@record
class SurroundingAir:
    """Air around a vehicle, at its centre of mass. Source: docs page, Turbulence."""

    height: Scalar = quantity("m", "Height of the vehicle above the sea.")
    velocity: Any = quantity("m/s", "Velocity of the air relative to the ground, in B.", frame="B", shape=(3,))
    rate: Any = quantity("rad/s", "Angular velocity of the air around the vehicle.", frame="B", shape=(3,))


@record
class Gust:
    """Gust that turbulence adds to the air at a vehicle. Source: docs page, Turbulence."""

    velocity: Any = quantity("m/s", "Velocity of the gust: forward, to starboard, down.", frame="B", shape=(3,))
    rate: Any = quantity("rad/s", "Angular velocity of the gust: roll, pitch, yaw.", frame="B", shape=(3,))


NO_GUST = Gust(np.zeros(3), np.zeros(3))
"""Zero gust: the air is still, or moves with the mean wind."""


@record
class Bending:
    """Motion of a vehicle's bending modes, in the order of the modes in the state. Source: docs page, Hypersonic."""

    rate: Any = quantity("1/s", "Rate of each bending mode (n,), in the unit of the mode per second.")
    acceleration: Any = quantity("1/s^2", "Acceleration of each bending mode (n,), in the unit of the mode per s^2.")


@record
class Motion:
    """Motion and surroundings of the vehicle at one instant: all that a sensor on the vehicle can measure.

    Frames:  p_WB in W; attitude is roll, pitch, yaw (3-2-1) of B in W, unwrapped; the rest in B.
    Source:  docs page, Conventions.
    """

    t: Scalar = quantity("100 ns", "Time at which the vehicle has this motion.", kind="time")
    p_WB: Any = quantity("m", "Position: north, east, down.", frame="W", shape=(3,))
    attitude: Any = quantity("rad", "Roll, pitch, yaw; yaw counts full turns.", frame="WB", shape=(3,))
    v_WB_B: Any = quantity("m/s", "Velocity: surge, sway, heave.", frame="B", shape=(3,))
    w_WB_B: Any = quantity("rad/s", "Angular velocity: roll, pitch, yaw rate.", frame="B", shape=(3,))
    a_WB_B: Any = quantity("m/s^2", "Acceleration of the centre of mass in W, resolved in B.", frame="B", shape=(3,))
    alpha_WB_B: Any = quantity("rad/s^2", "Angular acceleration of B in W, resolved in B.", frame="B", shape=(3,))
    air: Any = part("Air about the vehicle, a SurroundingAir; empty for a vehicle without air.", default=())
    bending: Any = part("Bending modes of the vehicle, a Bending; empty for a rigid vehicle.", default=())


def surrounding_air(motion: Motion) -> SurroundingAir:
    """Return the air around a vehicle. If the motion contains no air, the air is still, and the sea is at the origin of
    W."""
    if isinstance(motion.air, SurroundingAir):
        return motion.air
    still = jnp.zeros_like(motion.v_WB_B)
    return SurroundingAir(height=-motion.p_WB[2], velocity=still, rate=still)


def no_motion() -> Motion:
    """Return a motion at rest at the origin at time zero, for code that needs only the structure of a motion."""
    three = np.zeros(3)
    return Motion(np.int64(0), three, three, three, three, three, three)


@record
class Sample:
    """Message of a sensor: a value with the time of its measurement. Source: docs page, Time."""

    value: Any = part("Measured value.")
    t: Scalar = quantity("100 ns", "Time of measurement.", kind="time")
    age: Scalar = quantity("s", "Age of the sample: time since its measurement, by the receiver's clock.")
    fresh: Scalar = quantity("1", "True at the first step at which the receiver has this sample.", kind="flag")
    valid: Scalar = quantity("1", "True after the sensor's first measurement.", kind="flag")


def new_sample(t: Any, value: Any, *, fresh: Any = True) -> Sample:
    """Return a new sample of a value measured at integer time t."""
    return Sample(value=value, t=t, age=0.0, fresh=fresh, valid=True)


def hold_sample(now: Any, sample: Sample, *, fresh: Any = False) -> Sample:
    """Return the sample with its age updated to a later time `now`."""
    return replace(sample, age=to_seconds(now - sample.t), fresh=fresh)


def is_new(sample: Sample, seen: Any) -> Any:
    """Return True if a sample is valid, and is marked as fresh or was measured at another integer time than `seen`.

    The times are only compared for equality, because the clocks at the two ends of a link may differ.
    """
    return sample.valid & (sample.fresh | (sample.t != seen))


@record
class Frame:
    """Input of the autopilot: the newest sample of every sensor, by the sensor's name. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "Time of the frame, by the autopilot's clock.", kind="time")
    samples: Mapping[str, Sample] = part("Newest sample of each sensor, by the sensor's name.")


@record
class Estimate:
    """Estimate of the vehicle's state, the input of a control law. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "Time of the estimate, by the autopilot's clock.", kind="time")
    age: Scalar = quantity("s", "Age of the newest measurement used in the estimate.")
    fresh: Scalar = quantity("1", "True if a new measurement arrived at this step.", kind="flag")
    valid: Scalar = quantity("1", "True while the estimated state may be used.", kind="flag")
    state: Any = part("Estimated state, a record.")
    stick: Any = part("Newest sample of the pilot's stick for a law that reads the stick, else None.", default=None)
    dt: Any = part("Time between two steps of the law (s); None except in the law's input.", default=None)


STICK_MODES = ("manual", "damped", "assisted")
"""Modes of a pilot's stick. The stick commands the thrust vector (manual), velocities in body axes (damped), or the
velocity over the floor (assisted)."""


@record
class Stick:
    """Position and mode of a pilot's stick. Frames: none. Source: docs page, Piloted."""

    forward: Scalar = quantity("1", "Forward deflection, -1 to 1.", low=-1, high=1)
    turn: Scalar = quantity("1", "Sideways deflection, -1 to 1; positive turns clockwise from above.", low=-1, high=1)
    mode: Scalar = quantity("1", "Mode selected by the stick.", kind="mode", modes=STICK_MODES)


@record
class Command:
    """Command of the autopilot to the actuators. Source: docs page, Time."""

    t: Scalar = quantity("100 ns", "Time at which the autopilot sent the command.", kind="time")
    valid: Scalar = quantity(
        "1",
        "True if the command is valid. False while there is no valid estimate: actuators stay neutral.",
        kind="flag",
    )
    value: Any = part("Actuator commands, a record.")


@record
class PlanarState:
    """Velocity and heading of a vehicle in the plane, as read by planar laws. Source: docs page, Conventions."""

    surge_velocity: Scalar = quantity("m/s", "Velocity along the body's x axis.", frame="B")
    sway_velocity: Scalar = quantity("m/s", "Velocity along the body's y axis, to starboard.", frame="B")
    yaw_rate: Scalar = quantity("rad/s", "Rate of turn, clockwise from above.", frame="B")
    heading: Scalar = quantity("rad", "Angle from north to the body's x axis, clockwise; unwrapped.", kind="angle")


@record
class PlanarForce:
    """Horizontal force on the vehicle at the point where its thruster acts. Source: docs page, Conventions."""

    FX: Scalar = quantity("N", "Force along the body's x axis.", frame="B")
    FY: Scalar = quantity("N", "Force along the body's y axis.", frame="B")


@record
class PeerMessage:
    """Message with the reference point of a craft, sent to the other craft of a swarm. Source: docs page, Swarms."""

    t: Scalar = quantity(
        "100 ns", "Time for which position and velocity in the message are valid.", kind="time", default=np.int64(NEVER)
    )
    north: Scalar = quantity("m", "North coordinate of the craft's reference point.", frame="W", default=0.0)
    east: Scalar = quantity("m", "East coordinate of the craft's reference point.", frame="W", default=0.0)
    north_velocity: Scalar = quantity("m/s", "North velocity of the craft's reference point.", frame="W", default=0.0)
    east_velocity: Scalar = quantity("m/s", "East velocity of the craft's reference point.", frame="W", default=0.0)


@record
class Peers:
    """Newest message that a craft has received from each craft of its swarm. Not logged, because there are n² messages.

    Source: docs page, Swarms.
    """

    messages: Any = part(
        "Newest message of each craft: fields of PeerMessage, each (n,). t is NEVER for a craft without a message."
    )

    def message(self) -> PeerMessage:
        """Return the messages as a PeerMessage whose fields have the shape (n,)."""
        return PeerMessage(*self.messages)


@record
class PeerView:
    """Estimated state of a craft of a swarm, with the messages of the other craft. Source: docs page, Swarms."""

    own: Any = part("Estimated state of the craft itself.")
    peers: Peers = part("Messages received from the other craft.")


@record
class SwarmInput:
    """Input and message of each craft of a swarm. The swarm's demand, command and input all have this form. Source:
    docs page, Swarms."""

    act: Any = part("Input of each craft, or demand for its actuators; fields (n,).")
    message: PeerMessage = part("Message of each craft; fields (n,).")


@record
class SwarmMotion:
    """Motion of all craft of a swarm, the input of its sensors. Source: docs page, Swarms."""

    each: Motion = part("Motion of each craft, fields (n, …).")
    message: PeerMessage = part("Message of each craft, fields (n,).")

"""The messages that the parts of the loop exchange. Every sample carries the time at which it was measured.

Frames: W is north-east-down with its origin on the floor; B sits at the centre of mass, x forward, y starboard, z down.
Times are integers of 100 ns; ages are seconds.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.time import to_seconds


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

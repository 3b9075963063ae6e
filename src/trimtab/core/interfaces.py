"""Interfaces of all parts. A part must have the members of its interface. No base class or registration is needed.

Every part is a record; its fields are its parameters. The time `t` of a block is an integer in units of 100 ns. A step
is a pure function of time, state and input that returns the next state and the output. A step never raises an error.
"""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

from trimtab.core.reference import ReferencePoint
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame, Gust, Motion, Sample

OPTIONAL_MEMBERS: Mapping[str, Any] = MappingProxyType(
    {
        "check": lambda: None,
        "check_duration": lambda seconds: None,
        "check_period": lambda period: None,
        "FEELS": "motion",
        "LATE": False,
        "ANY_ORDER": False,
        "OBSERVES": False,
        "MAV_TYPE": "GENERIC",
        "QUATERNIONS": (),
        "send_period": None,
        "frame": None,
        "pulses": lambda: {},
        "sampling": None,
        "equilibrium": None,
        "stick": "",
        "variance": 0.0,
        "frequencies": (),
        "events": None,
        "jump": None,
        "after_step": None,
        "in_gust": None,
        "is_stepped": None,
        "input_limits": lambda: {},
        "failsafe": lambda: None,
    }
)
"""Optional members of a part, with their defaults.

- any part: `check()` raises InputError if a parameter is invalid. `check_duration(seconds)` raises InputError if a
  parameter is invalid for a run of this duration.
- ActuatorStage: `check_period(period)` raises InputError if the period (100 ns) is not suitable.
- Sensor: `FEELS`, a class variable: the input of step(). "motion": the vehicle's motion; "input": the vehicle's input
  since the last command; "state": the vehicle's state, which only an ideal sensor measures.
- Sensor: `LATE`, a class variable: True if samples are output later than they were measured.
- Sensor: `OBSERVES`, a class variable: True for an instrument outside the vehicle, which no autopilot reads. An ideal
  run keeps this sensor.
- Estimator: `ANY_ORDER`, a class variable: True if the estimator fuses each sample at the sample's own time. Only such
  an estimator receives samples that arrive late.
- Vehicle: `MAV_TYPE`, a class variable: type of the vehicle for a ground station, MAVLink's name without the prefix.
- Vehicle: `QUATERNIONS`, a class variable: fields of the state that are attitudes q_WB (4,), whose derivative is
  q_WB (0, w_WB_B)/2. An integration on the rotation group updates these fields by rotations (docs, Integration).
- Vehicle: `events(t, x)`: values (k,) of event functions. An integration step ends where one of them changes its sign
  (docs, Integration).
- Vehicle: `jump(t, x, crossed)`: the state after an event; crossed (k,): True if the event function changed its sign.
- Vehicle: `after_step(t, x)`: the corrected state after each step, e.g. with a quaternion of length one.
- Vehicle: `input_limits()`: field of the vehicle's input -> (minimum, maximum) of the servos and motors in its model.
- Vehicle: `in_gust(gust)`: the vehicle in air with this Gust in addition to the wind; needed in a world with
  turbulence.
- Vehicle: `is_stepped`: True if a host, e.g. an external program, steps the vehicle; the loop does not integrate it.
- Channel: `send_period`: time between packets; None: the channel's period.
- Actuators: `frame`: the period at which the actuators latch a command; None: the actuators' `period`.
- Actuators: `pulses()`: field of the command -> its ServoPulse on a board. The pulses of missing fields are computed
  from the limits of these fields.
- a command: `failsafe()`: the Failsafe of a vehicle that accepts this command; None: a Failsafe without limits.
- Law: `stick`: name of the sample with the pilot's stick, which is added to the estimate; "" without a pilot.
- a gyro's response: `sampling`: the sampling period for which the response was designed; None: any.
- Law: `equilibrium()`: the state in which the closed loop with this law is at rest; None: unknown.
- a measured heading or position: `variance` of its noise; for a position, a covariance (2, 2) is also possible; 0: not
  stated.
- an estimated state: `frequencies` of the bending modes (w1, w2, rad/s); () if they are not estimated.

Imperfections that can be switched off in a part are declared with `off=` at its fields; see `core.imperfections`.
"""


def optional_member(part: Any, name: str) -> Any:
    """Return an optional member of a part, or its default from OPTIONAL_MEMBERS if the part does not have it."""
    return getattr(part, name, OPTIONAL_MEMBERS[name])


X = TypeVar("X")
U = TypeVar("U", contravariant=True)


@runtime_checkable
class Vehicle(Protocol[X, U]):
    """Model of a vehicle. x: state record; u: input record; t: seconds."""

    def dynamics(self, t: Any, x: X, u: U) -> X:
        """Return the derivative of x, as a record of the same type."""
        ...

    def motion(self, t: Any, x: X, u: U) -> Motion:
        """Return the motion that sensors measure; t: integer time."""
        ...


class AirDisturbance(Protocol):
    """Disturbance of the air, e.g. turbulence. Each `period`, it computes the Gust at a vehicle from the vehicle's
    motion."""

    @property
    def period(self) -> int:
        """Return the time between updates of the gust."""
        ...

    def init(self, key: Key) -> Any:
        """Return the initial state of the disturbance."""
        ...

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Gust]:
        """Return the disturbance's new state, and the gust that applies from integer time t on."""
        ...


@runtime_checkable
class Sensor(Protocol):
    """Sensor. Each `period`, it computes a sample from the vehicle's motion, or from another input named by FEELS."""

    @property
    def period(self) -> int:
        """Return the sampling period."""
        ...

    def init(self, key: Key) -> Any:
        """Return the initial state of the sensor."""
        ...

    def measure(self, motion: Motion) -> Any:
        """Return the noise-free measurement h(x), a record. step() adds errors to h(x). An estimator differentiates
        h."""
        ...

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Sample]:
        """Return the sensor's new state, and its sample at time t."""
        ...


@runtime_checkable
class Channel(Protocol):
    """Link that carries samples. The link may delay, jitter, lose or hold them."""

    @property
    def period(self) -> int:
        """Return the polling period of the channel's input and output."""
        ...

    def init(self, key: Key, like: Sample) -> Any:
        """Return the initial state of the link, for samples of this structure."""
        ...

    def step(self, t: Any, state: Any, sample: Sample) -> tuple[Any, Sample]:
        """Return the link's new state, and the sample at the receiving end at time t."""
        ...


@runtime_checkable
class Estimator(Protocol):
    """Estimator, which computes an estimate from a frame of samples."""

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors whose samples the estimator reads."""
        ...

    def init(self, key: Key) -> Any:
        """Return the initial state of the estimator."""
        ...

    def step(self, t: Any, state: Any, frame: Frame) -> tuple[Any, Estimate]:
        """Return the estimator's new state, and the estimate at time t."""
        ...


class InertialForm(Protocol):
    """Filter of aided inertial navigation, without the code that reads and orders the samples.

    A node is the filter's state at one instant: a record with the fields t, imu_reading (3,), untrusted (2,),
    heading_fix and position_fix, and further fields of the filter. z: measured value. variance: variance of z, or
    covariance (2, 2) of a position z; 0 if the sensor states no variance.
    """

    AIDED_BY: ClassVar[str]
    """Data of the sensor at `intake.position`: "positions" for the method correct_position(node, z, variance), or
    "ranges" for the method correct_ranges(node, value)."""

    @property
    def intake(self) -> Any:
        """Return the description of the samples to read."""
        ...

    @property
    def noise(self) -> Any:
        """Return the noise of the IMU and of the aiding sensors."""
        ...

    @property
    def arms(self) -> Any:
        """Return the lever arms of the sensors."""
        ...

    def first(self) -> Any:
        """Return the filter's state (node) before the first sample."""
        ...

    def propagate(self, node: Any, dt: Any, imu_reading: Any, untrusted: Any) -> Any:
        """Return the filter's state (node) advanced by dt (s).

        imu_reading: (3,).  untrusted: (2,), flags of gyro and accelerometer; 1: the sensor is not trusted.
        """
        ...

    def correct_heading(self, node: Any, z: Any, variance: Any) -> Any:
        """Return the filter's state (node) corrected by a measured heading z (rad)."""
        ...

    def belief(self, node: Any) -> Any:
        """Return the estimate in a filter state (node), as a Belief. The Belief's velocity and position are those of
        the IMU."""
        ...


@runtime_checkable
class Law(Protocol):
    """Control law. From an estimate, it computes a record with the field `demand` (the desired input) and fields to
    log."""

    reads: ClassVar[tuple[str, ...]]
    """Fields of the estimated state that the law needs."""

    def init(self, key: Key) -> Any:
        """Return the initial state of the law."""
        ...

    def step(self, t: Any, state: Any, estimate: Estimate) -> tuple[Any, Any]:
        """Return the law's new state and its demand at time t. `estimate.dt` is the time since the last step (s)."""
        ...


@runtime_checkable
class Reference(Protocol):
    """Desired motion of a vehicle in the plane: a record that is part of a law, usually the law's field `reference`."""

    def at(self, t: Any) -> ReferencePoint:
        """Return the desired point at t (s) after the law's start. This must be a pure function that compiles to C."""
        ...


@runtime_checkable
class Allocation(Protocol):
    """Control allocation, which computes commands for the actuators from a demand."""

    def init(self, key: Key) -> Any:
        """Return the initial state of the allocation."""
        ...

    def step(self, t: Any, state: Any, demand: Any) -> tuple[Any, Any]:
        """Return the allocation's new state, and the actuator commands closest to the demand."""
        ...


class StageOutput(NamedTuple):
    """Output of an actuator stage. value: value after the stage. limited: True at maximum speed or at an end stop."""

    value: Any
    limited: Any


class ActuatorStage(Protocol):
    """Effect of an actuator, e.g. lag, backlash or delay, on one field of the input. Elements of an array are
    independent."""

    def init(self, rest: Any) -> Any:
        """Return the initial state of the stage, at the neutral value `rest`."""
        ...

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Return the stage's new state, and its output after a period dt (s) with a constant input `value`."""
        ...


@runtime_checkable
class Actuators(Protocol):
    """Actuators. From commands, they compute a record with the field `u` (the vehicle's input) and fields to log."""

    @property
    def period(self) -> int:
        """Return the time between steps of the actuators."""
        ...

    def neutral(self) -> Any:
        """Return the output before any command has arrived."""
        ...

    def init(self, key: Key) -> Any:
        """Return the initial state of the actuators."""
        ...

    def step(self, t: Any, state: Any, command: Sample) -> tuple[Any, Any]:
        """Return the actuators' new state, and their output from time t on."""
        ...


class LinkStatistics(NamedTuple):
    """Counters of a transport since it was opened. A packet is the data of one call of `send` or `receive`."""

    bytes_in: int
    bytes_out: int
    packets_in: int
    packets_out: int
    dropped: int
    """Number of packets that could not be sent."""
    reconnects: int
    connected: bool


class Audience(Enum):
    """Recipients of a packet on a link with several peers."""

    ALL = "all"
    PRIVATE = "private"
    PUBLIC = "public"
    """Recently accepted peers other than the private ones. On a link with one peer, that peer is private."""


@runtime_checkable
class Link(Protocol):
    """Transport that sends and receives bytes in wall-clock time. After the transport is open, its methods raise no
    errors."""

    @property
    def statistics(self) -> LinkStatistics:
        """Return the statistics of the link."""
        ...

    def receive(self, timeout: float) -> bytes | None:
        """Return the next packet, or piece of a stream, or None if no data arrives within `timeout` seconds."""
        ...

    def send(self, packet: bytes, audience: Audience = Audience.ALL) -> bool:
        """Send a packet without waiting. Return False if the packet was dropped."""
        ...

    def has_audience(self, audience: Audience) -> bool:
        """Return True if there may be a recipient for this audience."""
        ...

    def accept_sender(self, *, is_private: bool = False) -> None:
        """Accept the sender of the last received packet as a peer. Only links that receive from anyone need this.

        is_private: True if the sender also receives packets sent to PRIVATE.
        """
        ...

    def reply(self, packet: bytes) -> bool:
        """Send only to the sender of the last received packet, accepted or not. Return False if the packet was
        dropped."""
        ...

    def fileno(self) -> int:
        """Return the descriptor for select(), or -1 without a connection."""
        ...

    def close(self) -> None:
        """Close the transport."""
        ...

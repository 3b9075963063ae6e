"""The interfaces, and the only place where one is defined. Fitting one is all it takes: no base class, no registration.

Every part is a record; its fields are its parameters. Times `t` of blocks are integers of 100 ns, and steps are pure:
state comes in and goes out. Inside a step nothing raises.
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
    }
)
"""What a part may have besides its interface, and what stands for it in one that hasn't.

- any part: `check()` refuses its values with an InputError; `check_duration(seconds)` a run of that length.
- ActuatorStage: `check_period(period)` refuses to act so often (100 ns).
- Sensor: `FEELS`, a class variable: what step() is given. "motion"; "input", what acts on the vehicle since the last
  command; "state", the vehicle's own, which no real sensor has but an ideal twin may.
- Sensor: `LATE`, a class variable: samples come out after the time at which they were measured.
- Sensor: `OBSERVES`, a class variable: an instrument beside the vehicle, which no autopilot hears and an ideal twin
  keeps.
- Estimator: `ANY_ORDER`, a class variable: it fuses each sample at its own time, so that late ones are given to it.
- Vehicle: `MAV_TYPE`, a class variable: what it is to a ground station, MAVLink's name without its prefix.
- Vehicle: `QUATERNIONS`, a class variable: fields of its state that are attitudes q_WB (4,), whose derivative is
  q_WB (0, w_WB_B)/2; an integration on the rotation group turns them (docs, Integration).
- Vehicle: `events(t, x)`, some numbers; where one changes its sign a step ends and another begins (docs, Integration).
- Vehicle: `jump(t, x, crossed)`, the state after such an event; crossed: which of the numbers have changed sign, (k,).
- Vehicle: `after_step(t, x)`, what the state is put to after each step, e.g. a quaternion of length one.
- Vehicle: `input_limits()`, field of its input -> (least, greatest) that its own servos and motors take.
- Vehicle: `in_gust(gust)`, the vehicle in air that has this Gust besides the wind; a world with turbulence needs it.
- Vehicle: `is_stepped`, whether a host steps it, as a program of others is; the loop around then holds it still.
- Channel: `send_period`, time between packets; None: its period.
- Actuators: `frame`, the period at which they latch a command; None: their period.
- Actuators: `pulses()`, field of the command -> the ServoPulse that tells it on a board; of others the limits decide.
- Law: `stick`, name of the sample with the pilot's stick, which it finds in the estimate; "": it has no pilot.
- a gyro's response: `sampling`, the period of samples that it is made for; None: any.
- Law: `equilibrium()`, the state at which its loop rests; None: not known.
- a heading or position measured: `variance`, of its noise, of a position also its covariance (2, 2); 0: not stated.
- an estimated state: `frequencies`, those of its bending modes (w1, w2, rad/s); (): not estimated.

What can be switched off in a part is declared with `off=` at its fields: `core.imperfections`.
"""


def optional_member(part: Any, name: str) -> Any:
    """A member of OPTIONAL_MEMBERS of a part, or what stands for it."""
    return getattr(part, name, OPTIONAL_MEMBERS[name])


X = TypeVar("X")
U = TypeVar("U", contravariant=True)


@runtime_checkable
class Vehicle(Protocol[X, U]):
    """The truth. x: state record; u: input record; t: seconds."""

    def dynamics(self, t: Any, x: X, u: U) -> X:
        """The derivative of x, as a record of the same type."""
        ...

    def motion(self, t: Any, x: X, u: U) -> Motion:
        """All that a sensor can feel; t: integer time."""
        ...


class AirDisturbance(Protocol):
    """Turbulence and the like: the vehicle's motion in, the Gust that it meets there out, each `period`."""

    @property
    def period(self) -> int:
        """How long a gust is held."""
        ...

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Gust]:
        """The gust from integer time t on."""
        ...


@runtime_checkable
class Sensor(Protocol):
    """Motion in, sample out, each `period`; it may say that it FEELS something else."""

    @property
    def period(self) -> int:
        """Sampling period."""
        ...

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def measure(self, motion: Motion) -> Any:
        """The noise-free measurement h(x), a record: step() corrupts it, an estimator differentiates it."""
        ...

    def step(self, t: Any, state: Any, motion: Motion) -> tuple[Any, Sample]:
        """One sample at time t."""
        ...


@runtime_checkable
class Channel(Protocol):
    """Samples in at one end, delayed, jittered, lost or held samples out at the other."""

    @property
    def period(self) -> int:
        """How often the channel looks at its input and its output."""
        ...

    def init(self, key: Key, like: Sample) -> Any:
        """First state, for samples of this structure."""
        ...

    def step(self, t: Any, state: Any, sample: Sample) -> tuple[Any, Sample]:
        """What the receiving end holds at time t."""
        ...


@runtime_checkable
class Estimator(Protocol):
    """Frame in, estimate out."""

    @property
    def listens(self) -> tuple[str, ...]:
        """Names of the sensors whose samples it reads."""
        ...

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def step(self, t: Any, state: Any, frame: Frame) -> tuple[Any, Estimate]:
        """The estimate at time t."""
        ...


class InertialForm(Protocol):
    """A form of aided inertial navigation: the filter alone, without what reads and orders the samples.

    A node is the form's state at one instant: a record with the fields t, felt (3,), doubt (2,), heading_fix and
    position_fix, and whatever else the form keeps. z: as measured; variance: of z, of a position also its covariance
    (2, 2); 0 where the sensor states none.
    """

    AIDED_BY: ClassVar[str]
    """What the sensor at intake.position gives: "positions", which go to correct_position(node, z, variance), or
    "ranges", which go to correct_ranges(node, value)."""

    @property
    def intake(self) -> Any:
        """Which samples are read."""
        ...

    @property
    def noise(self) -> Any:
        """Of the IMU and of what aids it."""
        ...

    @property
    def arms(self) -> Any:
        """Where the sensors sit."""
        ...

    def first(self) -> Any:
        """The node before the first sample."""
        ...

    def propagate(self, node: Any, dt: Any, felt: Any, doubt: Any) -> Any:
        """The node dt (s) on, where the IMU reads felt (3,); doubt (2,): 1 for gyro, accelerometers not trusted."""
        ...

    def correct_heading(self, node: Any, z: Any, variance: Any) -> Any:
        """With a heading (rad)."""
        ...

    def belief(self, node: Any) -> Any:
        """A Belief about the IMU's point."""
        ...


@runtime_checkable
class Law(Protocol):
    """Estimate in; out comes a record with the field `demand` (the wanted input) and whatever is worth logging."""

    reads: ClassVar[tuple[str, ...]]
    """Names of the fields of the estimated state that the law needs."""

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def step(self, t: Any, state: Any, estimate: Estimate) -> tuple[Any, Any]:
        """The demand at time t; `estimate.dt` (s) is the time between two steps, estimate.state what `reads` names."""
        ...


@runtime_checkable
class Reference(Protocol):
    """Where a vehicle in the plane is wanted: a record that a law holds, usually as its field `reference`."""

    def at(self, t: Any) -> ReferencePoint:
        """What is wanted t (s) after the law began: pure, and of what compiles to C."""
        ...


@runtime_checkable
class Allocation(Protocol):
    """Demand in, values for the actuators out."""

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def step(self, t: Any, state: Any, demand: Any) -> tuple[Any, Any]:
        """Actuator commands that come closest to the demand."""
        ...


class StageOutput(NamedTuple):
    """What a stage gives. value: of its field.  limited: whether it is at its top speed or at a stop."""

    value: Any
    limited: Any


class ActuatorStage(Protocol):
    """One thing that an actuator does to one field of the input, number by number: a lag, a gap, a delay."""

    def init(self, rest: Any) -> Any:
        """First state, at the neutral value `rest`."""
        ...

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """State and output a period dt (s) later, what is commanded held."""
        ...


@runtime_checkable
class Actuators(Protocol):
    """Commands in; out comes a record with the field `u` (the vehicle's input) and whatever is worth logging."""

    @property
    def period(self) -> int:
        """How often they act."""
        ...

    def neutral(self) -> Any:
        """The output before any command has arrived."""
        ...

    def init(self, key: Key) -> Any:
        """First state."""
        ...

    def step(self, t: Any, state: Any, command: Sample) -> tuple[Any, Any]:
        """What the actuators do from time t on."""
        ...


class LinkStatistics(NamedTuple):
    """What a transport has carried since it was opened; packets are what one call took or gave."""

    bytes_in: int
    bytes_out: int
    packets_in: int
    packets_out: int
    dropped: int
    """Packets that could not be sent."""
    reconnects: int
    connected: bool


class Audience(Enum):
    """Who gets a packet of a link that several may have joined."""

    ALL = "all"
    PRIVATE = "private"
    PUBLIC = "public"
    """Those who were accepted as private, of late; all others. A link with one peer has that one as private."""


@runtime_checkable
class Link(Protocol):
    """A real transport: bytes in and out, in wall-clock time. Nothing of it raises once it is open."""

    @property
    def statistics(self) -> LinkStatistics:
        """What it has carried."""
        ...

    def receive(self, timeout: float) -> bytes | None:
        """The next packet, or piece of a stream; None when `timeout` seconds have passed without one."""
        ...

    def send(self, packet: bytes, audience: Audience = Audience.ALL) -> bool:
        """Hand a packet over without waiting; False where it had to be dropped."""
        ...

    def has_audience(self, audience: Audience) -> bool:
        """Whether there may be somebody who would get it."""
        ...

    def accept_sender(self, *, is_private: bool = False) -> None:
        """Say that the packet received last came from one who may be answered; only who hears strangers needs it.

        is_private: and who gets what is sent to PRIVATE.
        """
        ...

    def reply(self, packet: bytes) -> bool:
        """To the sender of the packet received last and to nobody else, accepted or not; False where it was dropped."""
        ...

    def fileno(self) -> int:
        """For select(); -1 while there is no connection."""
        ...

    def close(self) -> None:
        """Give the transport back."""
        ...

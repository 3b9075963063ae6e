"""Aided inertial navigation: the step that is common to all filter forms. The step reads samples, sorts them by time,
replays the filter and returns the state.

A filter form (`core.interfaces.InertialForm`) defines the filter alone: the filter's state at one instant (a node), the
propagation, the correction, and the estimate (Belief). A form has the parts intake, noise, start and arms, and uses
`navigate` as its `step`.

    navigate      read_samples (sensor_watch)  ->  enter_event, replay_events (measurement_history): the form's
                  propagate and correct_...  ->  the form's belief  ->  reference_kinematics (navigation_state)

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3
and section 5.4: propagation runs on the IMU's samples, never on the wall clock. Docs page, Measurement history.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.interfaces import InertialForm, optional_member
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate, Frame, Sample
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.inertial.measurement_history import (
    AIDING_KINDS,
    HEADING,
    IMU,
    POSITION_NUMBERS,
    Event,
    History,
    empty_history,
    enter_event,
    newest_imu_index,
    newest_node,
    replay_events,
)
from trimtab.estimators.inertial.mechanisation import Belief
from trimtab.estimators.inertial.navigation_state import NavigationState, reference_kinematics
from trimtab.estimators.inertial.sensor_watch import (
    NEVER,
    WIDTH,
    SampleValidation,
    SensorWatch,
    increment,
    initial_watch,
    validate_sample,
)


@record
class Intake:
    """Sensors that the navigation reads, gates and checks of their samples, and length of the history.

    Reads: angular_rate (3,), specific_force (3,), gyro_saturated and accelerometer_saturated of the IMU, whose axes are
    those of the body frame B; heading of the heading sensor; north and east of the position sensor. If the heading or
    position sensor gives a `variance` above 0, this variance is used. An empty name means that the vehicle has no such
    sensor.
    Source: ranges [1] section 5.4 (300 deg/s, 1.7 g); gates: 0.9999 quantiles of chi-square; other values: our choice.
    """

    gate_heading: Scalar = quantity("1", "NIS gate for heading measurements.", default=15.137, above=0)
    gate_position: Scalar = quantity("1", "NIS gate for position measurements.", default=18.421, above=0)
    patience_heading: Scalar = quantity(
        "1",
        "Number of consecutive rejected headings after which the next heading is accepted anyway; 0 for never.",
        default=0,
        kind="count",
    )
    patience_position: Scalar = quantity(
        "1",
        "Number of consecutive rejected positions after which the next position is accepted anyway; 0 for never.",
        default=5,
        kind="count",
    )
    rate_range: Scalar = quantity(
        "rad/s", "Range of the gyro, used if the sensor does not report saturation.", default=np.deg2rad(300.0), above=0
    )
    force_range: Scalar = quantity(
        "m/s^2",
        "Range of the accelerometers, used if the sensor does not report saturation.",
        default=1.7 * 9.80665,
        above=0,
    )
    frozen_imu: Scalar = quantity(
        "1",
        "Number of consecutive equal IMU samples after which the IMU counts as frozen; 0 for never.",
        default=25,
        kind="count",
        off={"imu-noise": 0},
    )
    frozen_heading: Scalar = quantity(
        "1",
        "Number of consecutive equal headings after which the heading sensor counts as frozen; 0 for never.",
        default=20,
        kind="count",
    )
    frozen_position: Scalar = quantity(
        "1",
        "Number of consecutive equal positions after which the position sensor counts as frozen; 0 for never.",
        default=5,
        kind="count",
    )
    gap: Scalar = quantity(
        "100 ns",
        "Longest gap between IMU samples for which the filter adds no extra uncertainty.",
        default=ms(40),
        kind="time",
    )
    lag: Scalar = quantity(
        "100 ns",
        "Delay of the samples in the IMU's low-pass filter, e.g. sqrt(2)/omega for a second-order Butterworth filter.",
        default=0,
        kind="time",
        off={"imu-bandwidth": 0},
    )
    imu: str = option("Name of the inertial sensor.", default="imu")
    heading: str = option("Name of the heading sensor; empty if the vehicle has no heading sensor.", default="heading")
    position: str = option(
        "Name of the position sensor; empty if the vehicle has no position sensor.", default="position"
    )
    slots: int = option(
        "Number of measurements in the history. It must cover the longest delay of a sensor, with a reserve.",
        default=64,
    )

    def listens(self) -> tuple[str, ...]:
        """Return the names of the sensors that the navigation reads."""
        return tuple(name for name in (self.imu, self.heading, self.position) if name)

    def check(self) -> None:
        """Raise InputError if the history is too short, a frozen sensor would be accepted, the IMU has no name, or a
        sensor name is used twice."""
        if self.slots < 4:
            raise InputError(
                "intake.slots",
                f"slots must be at least 4, got {self.slots}",
                fix="set slots to 4 or more, e.g. 64",
            )
        limits = {
            "heading": (int(self.patience_heading), int(self.frozen_heading)),
            "position": (int(self.patience_position), int(self.frozen_position)),
        }
        for name, (patience, frozen) in limits.items():
            if 0 < patience < frozen:
                problem = (
                    f"the sensor counts as frozen only after {frozen} equal samples, but is accepted again "
                    f"after {patience} rejections"
                )
                raise InputError(f"intake.frozen_{name}", problem, fix=f"set it to at most {patience}")
        if not self.imu or len(set(self.listens())) < len(self.listens()):
            problem = f"sensors {self.listens()} must include an IMU, and each name must be used once"
            raise InputError("intake", problem, fix="name the IMU, and give each sensor a name of its own")


@record
class InertialState:
    """State of an aided inertial navigation system. Source: docs page, Measurement history."""

    history: History = part("Recent measurements and the filter's states at their times.")
    imu: SensorWatch = part("Checks of the IMU's samples.")
    heading: Any = part("Checks of the heading sensor's samples; None without a heading sensor.")
    position: Any = part("Checks of the position sensor's samples; None without a position sensor.")
    imu_arrival: Scalar = quantity("100 ns", "Arrival time of the last IMU sample.", kind="time")
    reported: Any = part("Last estimate of the motion: fields of NavigationState by name.")
    clock: Scalar = quantity("100 ns", "Latest time that the autopilot's clock has shown.", kind="time")
    clock_backwards: Scalar = quantity("1", "Number of times the autopilot's clock ran backwards.", kind="count")


def listened_sensors(form: InertialForm) -> tuple[str, ...]:
    """Return the names of the IMU and the aiding sensors. The inertial filters use this as their property `listens`."""
    return form.intake.listens()


def check_intake(form: InertialForm) -> None:
    """Raise InputError if the settings of the sensors are invalid. Inertial filters use this as method `check`."""
    form.intake.check()


def initial_inertial_state(form: InertialForm, key: Key, width: int = POSITION_NUMBERS) -> InertialState:
    """Return the initial navigation state. The inertial filters use this function as their method `init`.

    width: largest number of values in one measurement.
    """
    intake, first = form.intake, form.first()
    kinematics = jax.tree.map(
        lambda a: np.zeros(a.shape, a.dtype), jax.eval_shape(lambda: _kinematics(form, first, 0, False))
    )
    return InertialState(
        history=empty_history(first, intake.slots, max(width, WIDTH)),
        imu=initial_watch(),
        heading=initial_watch() if intake.heading else None,
        position=initial_watch(max(width, WIDTH)) if intake.position else None,
        imu_arrival=np.int64(NEVER),
        reported=kinematics | {"coasting": np.bool_(True)},  # so that the first step computes these fields
        clock=np.int64(NEVER),
        clock_backwards=np.int32(0),
    )


@jax.jit
def navigate(form: InertialForm, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
    """Return the new state and the estimate, a NavigationState, at integer time t.

    The inertial filters use this function as their method `step`. Every fresh sample in the frame is fused at the time
    at which it was measured.
    """
    samples = [frame.samples[name] for name in form.intake.listens()]
    arrived = jnp.stack([jnp.asarray(one.fresh & one.valid) for one in samples]).any()
    watches = {"imu": state.imu, "heading": state.heading, "position": state.position}
    same = state.history, watches, state.imu_arrival, jnp.asarray(False)
    history, watches, imu_arrival, fresh = lax.cond(
        arrived, lambda: _receive_samples(form, t, state, frame), lambda: same
    )
    node = newest_node(history)
    begun = node.t > NEVER
    silent = begun & (t - imu_arrival > form.intake.gap)
    age = jnp.where(begun, to_seconds(t - node.t), 0.0)
    renew = fresh | silent | state.reported["coasting"]
    kinematics = lax.cond(renew, lambda: _kinematics(form, newest_node(history), age, silent), lambda: state.reported)
    new = InertialState(
        history=history,
        **watches,
        imu_arrival=imu_arrival,
        reported=kinematics,
        clock=jnp.maximum(state.clock, t),
        clock_backwards=increment(state.clock_backwards, jnp.asarray(t < state.clock)),
    )
    valid = begun  # true once every sensor has been used
    if form.intake.heading:
        valid = valid & (node.heading_fix.used > 0)
    if form.intake.position:
        valid = valid & (node.position_fix.used > 0)
    navigation = NavigationState(
        **kinematics,
        heading_fix=node.heading_fix,
        position_fix=node.position_fix,
        imu=new.imu,
        heading_sensor=new.heading,
        position_sensor=new.position,
        clock_backwards=new.clock_backwards,
    )
    return new, Estimate(t=t, age=age, fresh=fresh, valid=valid, state=navigation)


def _receive_samples(form: InertialForm, t: Any, state: InertialState, frame: Frame) -> Any:
    """Return the history with the new samples, the checks of each sensor, the arrival time of the last IMU sample, and
    a flag that is True if any new sample was usable."""
    readings = read_samples(form.intake, form.AIDED_BY, t, state, frame)
    fresh = jnp.stack([validation.usable for _, validation in readings.values()]).any()
    before = state.history, {name: validation.watch for name, (_, validation) in readings.items()}
    history, watches = lax.cond(fresh, lambda: _fuse_events(form, state.history, readings), lambda: before)
    imu_arrival = jnp.where(readings["imu"][1].usable, t, state.imu_arrival)
    return history, {name: watches.get(name) for name in ("imu", "heading", "position")}, imu_arrival, fresh


def read_samples(
    intake: Intake, aided_by: str, t: Any, state: Any, frame: Frame
) -> dict[str, tuple[Event, SampleValidation]]:
    """Return each sensor's measurement (an Event) and the validation of its sample. The IMU comes first.

    aided_by: "positions" or "ranges", the quantity that the sensor intake.position measures.  t: integer time.
    state: state with the SensorWatch fields imu, heading and position.
    """
    sample = frame.samples[intake.imu]
    reading = sample.value
    imu_reading = reading.angular_rate[2], reading.specific_force[0], reading.specific_force[1]
    inertial = validate_sample(state.imu, t, sample, imu_reading, frozen_after=intake.frozen_imu, ordered=True)
    gyro = (jnp.abs(inertial.value[0]) >= intake.rate_range * (1 - 1e-9)) | reading.gyro_saturated
    force = (jnp.max(jnp.abs(inertial.value[1:])) >= intake.force_range * (1 - 1e-9)) | reading.accelerometer_saturated
    lost = inertial.watch.frozen | ((inertial.t - state.imu.last > intake.gap) & (state.imu.last > NEVER))
    untrusted = jnp.stack([gyro | lost, force | lost]).astype(np.float64)
    watch = replace(inertial.watch, saturated=jnp.where(inertial.usable, gyro | force, state.imu.saturated))
    readings = {"imu": (Event(inertial.t - intake.lag, IMU, inertial.value, untrusted), inertial._replace(watch=watch))}
    if intake.heading:
        sample = frame.samples[intake.heading]
        numbers = sample.value.heading, optional_member(sample.value, "variance")
        readings["heading"] = _read_aiding(state.heading, t, sample, HEADING, numbers, intake.frozen_heading)
    if intake.position:
        sample = frame.samples[intake.position]
        numbers = range_numbers(sample.value) if aided_by == "ranges" else position_numbers(sample.value)
        kind = AIDING_KINDS[aided_by]
        readings["position"] = _read_aiding(state.position, t, sample, kind, numbers, intake.frozen_position)
    return readings


def position_numbers(value: Any) -> tuple[Any, ...]:
    """Return north and east (m) of a position and its covariance: north, mixed, east (m^2).

    The covariance is 0 if the sensor does not provide it.
    """
    variance = optional_member(value, "variance")
    if np.ndim(variance) == 2:
        return value.north, value.east, variance[0, 0], variance[0, 1], variance[1, 1]
    return value.north, value.east, variance, jnp.zeros(()), variance


def range_numbers(value: Any) -> tuple[Any, ...]:
    """Return the ranges (m) of a ping, and the number of the ultrasonic unit that sent it.

    The value 0 marks a range that did not arrive, and -1 an invalid range (not a positive number).
    """
    sound = jnp.isfinite(value.range) & (value.range > 0)
    ranges = jnp.where(value.arrived, jnp.where(sound, value.range, -1.0), 0.0)
    return (*ranges, value.unit)


def _read_aiding(
    watch: SensorWatch, t: Any, sample: Sample, kind: int, numbers: tuple[Any, ...], frozen_after: Any
) -> tuple[Event, SampleValidation]:
    """Return the measurement of an aiding sensor and the validation of its sample. Samples of a frozen sensor are not
    usable."""
    one = validate_sample(watch, t, sample, numbers, frozen_after=frozen_after, ordered=False)
    return Event(one.t, kind, one.value, np.zeros(2)), one._replace(usable=one.usable & ~one.watch.frozen)


def _fuse_events(form: InertialForm, history: History, readings: dict[str, tuple[Event, SampleValidation]]) -> Any:
    """Return the history with all usable measurements, and the sensor checks with late and repeated samples counted."""
    reached = newest_imu_index(history)
    watches: dict[str, SensorWatch] = {}
    for name, (event, validation) in readings.items():
        history, reached, late, known = lax.cond(
            validation.usable,
            lambda h=history, d=reached, e=event: enter_event(h, d, e),
            lambda h=history, d=reached: (h, d, jnp.asarray(False), jnp.asarray(False)),
        )
        watch = validation.watch
        watches[name] = replace(watch, late=increment(watch.late, late), duplicates=increment(watch.duplicates, known))
    return replay_events(form, history, reached)[0], watches


def _kinematics(form: InertialForm, node: Any, age: Any, silent: Any) -> dict[str, Any]:
    """Return the kinematic fields of NavigationState at the newest IMU sample, or at present if no IMU data arrive."""
    sampled = node, node.imu_reading[0], jnp.asarray(form.noise.gyro, np.float64)
    node, rate, variance = lax.cond(silent, lambda: _coast(form, node, age), lambda: sampled)
    x, P = form.belief(node)
    i = np.array([0, 3, 4])  # only heading and position have a constant error
    belief = Belief(x, P.at[i, i].add(form.noise.constant_variances()[i]))
    return reference_kinematics(belief, rate, variance, form.arms) | {"coasting": jnp.asarray(silent)}


def _coast(form: InertialForm, node: Any, age: Any) -> tuple[Any, Any, Any]:
    """Return the filter state (node), gyro reading and gyro variance after `age` (s) without IMU data.

    Velocity and heading stay constant, and the uncertainty grows as for an untrusted IMU.
    """
    still = form.belief(node).x[5:]  # reading of the IMU at constant velocity and heading
    coasted = form.propagate(replace(node, imu_reading=still), age, still, jnp.ones(2))
    return coasted, still[0], form.noise.gyro + form.noise.untrusted_rate**2

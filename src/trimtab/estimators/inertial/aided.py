"""Aided inertial navigation, the one step of every form: read samples, order them, replay the filter, tell the state.

A form (`core.interfaces.InertialForm`) is the filter alone: its state at one instant (a node), how it is propagated and
corrected, and what it believes. It has the parts intake, noise, start and arms, and takes its `step` from here.

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
    """Which samples are read, what of them is believed, and how much of the past is kept.

    Reads: angular_rate (3,), specific_force (3,), gyro_saturated and accelerometer_saturated of the IMU, whose axes are
    B's; heading of the heading sensor; north and east of the position sensor; of these two also `variance`, where they
    have one and it is above 0. A name left empty means that there is no such sensor.
    Source: ranges [1] section 5.4 (300 deg/s, 1.7 g); gates: 0.9999 quantiles of chi-square; the rest chosen here.
    """

    gate_heading: Scalar = quantity("1", "Largest NIS of a heading that is believed.", default=15.137, above=0)
    gate_position: Scalar = quantity("1", "Largest NIS of a position that is believed.", default=18.421, above=0)
    patience_heading: Scalar = quantity(
        "1", "Headings refused in a row after which the filter gives in; 0: never.", default=0, kind="count"
    )
    patience_position: Scalar = quantity("1", "The same for positions.", default=5, kind="count")
    rate_range: Scalar = quantity(
        "rad/s", "Where the gyro saturates, if it does not say so itself.", default=np.deg2rad(300.0), above=0
    )
    force_range: Scalar = quantity("m/s^2", "The same of the accelerometers.", default=1.7 * 9.80665, above=0)
    frozen_imu: Scalar = quantity(
        "1", "Equal samples in a row that mean frozen; 0: never.", default=25, kind="count", off={"imu-noise": 0}
    )
    frozen_heading: Scalar = quantity("1", "The same for headings.", default=20, kind="count")
    frozen_position: Scalar = quantity("1", "The same for positions.", default=5, kind="count")
    gap: Scalar = quantity("100 ns", "Longest silence of the IMU bridged in trust.", default=ms(40), kind="time")
    lag: Scalar = quantity(
        "100 ns",
        "How old what the IMU reads is: the delay of its low pass, sqrt(2)/omega for a Butterworth of second order.",
        default=0,
        kind="time",
        off={"imu-bandwidth": 0},
    )
    imu: str = option("Name of the inertial sensor.", default="imu")
    heading: str = option("Name of the heading sensor, or nothing.", default="heading")
    position: str = option("Name of the position sensor, or nothing.", default="position")
    slots: int = option("Events that are kept: those measured in the longest delay, and some.", default=64)

    def listens(self) -> tuple[str, ...]:
        """The names of what is read."""
        return tuple(name for name in (self.imu, self.heading, self.position) if name)

    def check(self) -> None:
        """Refuse a ring without room, and one name for two things."""
        if self.slots < 4:
            raise InputError("intake.slots", f"{self.slots} events are too few to order", fix="keep 4 or more, e.g. 64")
        limits = {
            "heading": (int(self.patience_heading), int(self.frozen_heading)),
            "position": (int(self.patience_position), int(self.frozen_position)),
        }
        for name, (patience, frozen) in limits.items():
            if 0 < patience < frozen:
                problem = (
                    f"the filter gives in after {patience} samples, and sees only after {frozen} that they are frozen"
                )
                raise InputError(f"intake.frozen_{name}", problem, fix=f"set it to {patience} or less")
        if not self.imu or len(set(self.listens())) < len(self.listens()):
            problem = f"sensors {self.listens()} are not an IMU and others, each by its own name"
            raise InputError("intake", problem, fix="name the IMU, and give each sensor its own name")


@record
class InertialState:
    """Everything about an aided inertial navigation system that changes. Source: docs page."""

    history: History = part("Events and states of the last moments.")
    imu: SensorWatch = part("What the IMU has done.")
    heading: Any = part("What the heading sensor has done; None without one.")
    position: Any = part("What the position sensor has done; None without one.")
    heard: Scalar = quantity("100 ns", "When a sample of the IMU last arrived.", kind="time")
    told: Any = part("What was told last of motion: fields of NavigationState by name.")
    clock: Scalar = quantity("100 ns", "Latest time of the autopilot so far.", kind="time")
    clock_backwards: Scalar = quantity("1", "How often that time ran backwards.", kind="count")


def listened_sensors(form: InertialForm) -> tuple[str, ...]:
    """The IMU and what aids it: `listens` of every form."""
    return form.intake.listens()


def check_intake(form: InertialForm) -> None:
    """Refuse an intake that can't work: `check` of a form."""
    form.intake.check()


def initial_inertial_state(form: InertialForm, key: Key, width: int = POSITION_NUMBERS) -> InertialState:
    """Nothing measured yet: `init` of a form; width: numbers of its longest event."""
    intake, first = form.intake, form.first()
    kinematics = jax.tree.map(
        lambda a: np.zeros(a.shape, a.dtype), jax.eval_shape(lambda: _kinematics(form, first, 0, False))
    )
    return InertialState(
        history=empty_history(first, intake.slots, max(width, WIDTH)),
        imu=initial_watch(),
        heading=initial_watch() if intake.heading else None,
        position=initial_watch(max(width, WIDTH)) if intake.position else None,
        heard=np.int64(NEVER),
        told=kinematics | {"coasting": np.bool_(True)},  # so the first step tells it anew
        clock=np.int64(NEVER),
        clock_backwards=np.int32(0),
    )


@jax.jit
def navigate(form: InertialForm, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
    """The estimate, a NavigationState, at integer time t: `step` of every form.

    Whatever is fresh in the frame is fused at the time it was measured.
    """
    samples = [frame.samples[name] for name in form.intake.listens()]
    arrived = jnp.stack([jnp.asarray(one.fresh & one.valid) for one in samples]).any()
    watches = {"imu": state.imu, "heading": state.heading, "position": state.position}
    same = state.history, watches, state.heard, jnp.asarray(False)
    history, watches, imu_arrival, fresh = lax.cond(
        arrived, lambda: _receive_samples(form, t, state, frame), lambda: same
    )
    node = newest_node(history)
    begun = node.t > NEVER
    silent = begun & (t - imu_arrival > form.intake.gap)
    age = jnp.where(begun, to_seconds(t - node.t), 0.0)
    renew = fresh | silent | state.told["coasting"]
    kinematics = lax.cond(renew, lambda: _kinematics(form, newest_node(history), age, silent), lambda: state.told)
    new = InertialState(
        history=history,
        **watches,
        heard=imu_arrival,
        told=kinematics,
        clock=jnp.maximum(state.clock, t),
        clock_backwards=increment(state.clock_backwards, jnp.asarray(t < state.clock)),
    )
    valid = begun  # whether every sensor has been used
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
    """The history with what has arrived, each sensor's watch, when the IMU came last, whether anything was usable."""
    readings = read_samples(form.intake, form.AIDED_BY, t, state, frame)
    fresh = jnp.stack([validation.usable for _, validation in readings.values()]).any()
    before = state.history, {name: validation.watch for name, (_, validation) in readings.items()}
    history, watches = lax.cond(fresh, lambda: _fuse_events(form, state.history, readings), lambda: before)
    imu_arrival = jnp.where(readings["imu"][1].usable, t, state.heard)
    return history, {name: watches.get(name) for name in ("imu", "heading", "position")}, imu_arrival, fresh


def read_samples(
    intake: Intake, aided_by: str, t: Any, state: Any, frame: Frame
) -> dict[str, tuple[Event, SampleValidation]]:
    """Each sensor's event, the IMU's first, with whether it is fit for use.

    aided_by: "positions" or "ranges", what the sensor at intake.position gives.  t: integer time.
    state: has the watches imu, heading and position.
    """
    sample = frame.samples[intake.imu]
    reading = sample.value
    felt = reading.angular_rate[2], reading.specific_force[0], reading.specific_force[1]
    inertial = validate_sample(state.imu, t, sample, felt, frozen_after=intake.frozen_imu, ordered=True)
    gyro = (jnp.abs(inertial.value[0]) >= intake.rate_range * (1 - 1e-9)) | reading.gyro_saturated
    force = (jnp.max(jnp.abs(inertial.value[1:])) >= intake.force_range * (1 - 1e-9)) | reading.accelerometer_saturated
    lost = inertial.watch.frozen | ((inertial.t - state.imu.last > intake.gap) & (state.imu.last > NEVER))
    doubt = jnp.stack([gyro | lost, force | lost]).astype(np.float64)
    watch = replace(inertial.watch, saturated=jnp.where(inertial.usable, gyro | force, state.imu.saturated))
    readings = {"imu": (Event(inertial.t - intake.lag, IMU, inertial.value, doubt), inertial._replace(watch=watch))}
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
    """North and east (m) of a position and its covariance: north, mixed, east (m^2), 0 where it states none."""
    variance = optional_member(value, "variance")
    if np.ndim(variance) == 2:
        return value.north, value.east, variance[0, 0], variance[0, 1], variance[1, 1]
    return value.north, value.east, variance, jnp.zeros(()), variance


def range_numbers(value: Any) -> tuple[Any, ...]:
    """Ranges (m) of a ping and its unit; what is not a positive number becomes -1, what did not arrive 0."""
    sound = jnp.isfinite(value.range) & (value.range > 0)
    ranges = jnp.where(value.arrived, jnp.where(sound, value.range, -1.0), 0.0)
    return (*ranges, value.unit)


def _read_aiding(
    watch: SensorWatch, t: Any, sample: Sample, kind: int, numbers: tuple[Any, ...], frozen_after: Any
) -> tuple[Event, SampleValidation]:
    """The event of a sensor that only aids: frozen, it is not used at all; an IMU is, with doubt."""
    one = validate_sample(watch, t, sample, numbers, frozen_after=frozen_after, ordered=False)
    return Event(one.t, kind, one.value, np.zeros(2)), one._replace(usable=one.usable & ~one.watch.frozen)


def _fuse_events(form: InertialForm, history: History, readings: dict[str, tuple[Event, SampleValidation]]) -> Any:
    """The history with all that is usable in it, and the watches with what was too late or here before."""
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
    """Kinematic fields of NavigationState at the time of the newest IMU sample; where it is silent, what holds now."""
    sampled = node, node.felt[0], jnp.asarray(form.noise.gyro, np.float64)
    node, rate, variance = lax.cond(silent, lambda: _coast(form, node, age), lambda: sampled)
    x, P = form.belief(node)
    i = np.array([0, 3, 4])  # the others have no constant part
    belief = Belief(x, P.at[i, i].add(form.noise.constant_variances()[i]))
    return reference_kinematics(belief, rate, variance, form.arms) | {"coasting": jnp.asarray(silent)}


def _coast(form: InertialForm, node: Any, age: Any) -> tuple[Any, Any, Any]:
    """A node, its gyro reading and that one's variance at an age (s): constant velocity and heading, with all doubt."""
    still = form.belief(node).x[5:]  # what an IMU reads that feels nothing
    coasted = form.propagate(replace(node, felt=still), age, still, jnp.ones(2))
    return coasted, still[0], form.noise.gyro + form.noise.doubtful_rate**2

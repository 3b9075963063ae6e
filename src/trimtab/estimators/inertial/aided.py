"""What the four forms of aided inertial navigation share: samples in, events in order of measurement, estimate out.

A form gives first(), propagate(), correct_heading(), correct_position() and belief(), and has the parts intake, noise,
start and arms; `navigate` is its step. Nothing here knows how a form keeps its state.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 3
and section 5.4: propagation runs on the IMU's samples, never on the wall clock.

How the sensor that aids an inertial form with its place is read: positions, or whatever else tells of it.

Source: docs page, Measurement history.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.signals import Estimate, Frame
from trimtab.core.time import ms, to_seconds
from trimtab.estimators.inertial import measurement_history as ring
from trimtab.estimators.inertial.measurement_history import POSITION, RANGES, Correct, Event, History
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


class Aid(NamedTuple):
    """How the sensor that intake.position names is read.

    kind: of its events.  width: of its values.  numbers: of a sample's value.  correct: what they do to a node.
    """

    kind: int
    width: int
    numbers: Callable[[Any], tuple[Any, ...]]
    correct: Correct


def position_aid(form: Any) -> Aid:
    """Positions, north and east, with their variance where they have one."""

    def correct(node: Any, value: Any) -> Any:
        return form.correct_position(node, value[:2], value[2])

    def numbers(value: Any) -> tuple[Any, ...]:
        return value.north, value.east, getattr(value, "variance", 0.0)

    return Aid(POSITION, WIDTH, numbers, correct)


def range_aid(form: Any) -> Aid:
    """Ranges of a ping and its unit; what is not a positive number becomes -1, what did not arrive 0."""
    width = np.shape(form.beacons)[0] + 1

    def numbers(value: Any) -> tuple[Any, ...]:
        sound = jnp.isfinite(value.range) & (value.range > 0)
        ranges = jnp.where(value.arrived, jnp.where(sound, value.range, -1.0), 0.0)
        return (*ranges, value.unit)

    return Aid(RANGES, width, numbers, getattr(form, "correct_ranges", lambda node, value: node))


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
        for name in ("heading", "position"):
            patience, frozen = (int(getattr(self, f"{kind}_{name}")) for kind in ("patience", "frozen"))
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


def initial_inertial_state(form: Any, width: int = WIDTH) -> InertialState:
    """First state of a form; width: of what the sensor at intake.position gives."""
    intake, first = form.intake, form.first()
    told = jax.tree.map(
        lambda a: np.zeros(a.shape, a.dtype), jax.eval_shape(lambda: _kinematics(form, first, 0, False))
    )
    return InertialState(
        history=ring.empty_history(first, intake.slots, max(width, WIDTH)),
        imu=initial_watch(),
        heading=initial_watch() if intake.heading else None,
        position=initial_watch(max(width, WIDTH)) if intake.position else None,
        heard=np.int64(NEVER),
        told=told | {"coasting": np.bool_(True)},  # so the first step tells it anew
        clock=np.int64(NEVER),
        clock_backwards=np.int32(0),
    )


@jax.jit
def navigate(form: Any, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
    """One step of a form: whatever is fresh in the frame is fused at the time it was measured."""
    return navigate_with(form, position_aid(form), t, state, frame)


def navigate_with(form: Any, aid: Aid, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
    """The same with another kind of aiding at intake.position."""
    arrived = jnp.stack([jnp.asarray(one.fresh & one.valid) for one in _listed_samples(form.intake, frame)]).any()
    watches = {name: getattr(state, name) for name in ("imu", "heading", "position")}
    same = state.history, watches, state.heard, jnp.asarray(False)
    history, watches, heard, fresh = lax.cond(
        arrived, lambda: _receive_samples(form, aid, t, state, frame), lambda: same
    )
    node = ring.newest_node(history)
    begun = node.t > NEVER
    silent = begun & (t - heard > form.intake.gap)
    age = jnp.where(begun, to_seconds(t - node.t), 0.0)
    anew = fresh | silent | state.told["coasting"]
    told = lax.cond(anew, lambda: _kinematics(form, ring.newest_node(history), age, silent), lambda: state.told)
    new = InertialState(
        history=history,
        **watches,
        heard=heard,
        told=told,
        clock=jnp.maximum(state.clock, t),
        clock_backwards=increment(state.clock_backwards, jnp.asarray(t < state.clock)),
    )
    return new, Estimate(t=t, age=age, fresh=fresh, valid=_is_valid(form, node), state=_navigation_state(node, new))


def _listed_samples(intake: Intake, frame: Frame) -> list[Any]:
    """Those that are read."""
    return [frame.samples[name] for name in intake.listens()]


def _receive_samples(form: Any, aid: Aid, t: Any, state: InertialState, frame: Frame) -> Any:
    """The history with what has arrived, each sensor's watch, when the IMU came last, whether anything was usable."""
    found = read_samples(form.intake, aid, t, state, frame)
    aids = {kind: correct for kind, correct in ring.default_aids(form).items() if kind != ring.POSITION}
    aids |= {aid.kind: aid.correct} if form.intake.position else {}
    fresh = jnp.stack([judgement.usable for _, judgement in found.values()]).any()
    before = state.history, {name: judgement.watch for name, (_, judgement) in found.items()}
    history, watches = lax.cond(fresh, lambda: _fuse_events(form, aids, state.history, found), lambda: before)
    heard = jnp.where(found["imu"][1].usable, t, state.heard)
    return history, {name: watches.get(name) for name in ("imu", "heading", "position")}, heard, fresh


def read_samples(
    intake: Intake, aid: Aid, t: Any, state: Any, frame: Frame
) -> dict[str, tuple[Event, SampleValidation]]:
    """Each sensor's event, the IMU's first, with what was found about it; state: has watches imu, heading, position."""
    sample = frame.samples[intake.imu]
    reading = sample.value
    felt = reading.angular_rate[2], reading.specific_force[0], reading.specific_force[1]
    one = validate_sample(state.imu, t, sample, felt, frozen_after=intake.frozen_imu, ordered=True)
    gyro = (jnp.abs(one.value[0]) >= intake.rate_range * (1 - 1e-9)) | reading.gyro_saturated
    force = (jnp.max(jnp.abs(one.value[1:])) >= intake.force_range * (1 - 1e-9)) | reading.accelerometer_saturated
    lost = one.watch.frozen | ((one.t - state.imu.last > intake.gap) & (state.imu.last > NEVER))
    doubt = jnp.stack([gyro | lost, force | lost]).astype(np.float64)
    watch = replace(one.watch, saturated=jnp.where(one.usable, gyro | force, state.imu.saturated))
    found = {"imu": (Event(one.t, ring.IMU, one.value, doubt), one._replace(watch=watch))}
    if intake.heading:
        sample = frame.samples[intake.heading]
        value = sample.value.heading, getattr(sample.value, "variance", 0.0)
        two = validate_sample(state.heading, t, sample, value, frozen_after=intake.frozen_heading, ordered=False)
        found["heading"] = Event(two.t, ring.HEADING, two.value, np.zeros(2)), _reject_frozen(two)
    if intake.position:
        sample = frame.samples[intake.position]
        value = aid.numbers(sample.value)
        three = validate_sample(state.position, t, sample, value, frozen_after=intake.frozen_position, ordered=False)
        found["position"] = Event(three.t, aid.kind, three.value, np.zeros(2)), _reject_frozen(three)
    return found


def _reject_frozen(judgement: SampleValidation) -> SampleValidation:
    """Samples of a frozen sensor that only aids are not used at all; an IMU's are, with doubt."""
    return judgement._replace(usable=judgement.usable & ~judgement.watch.frozen)


def _fuse_events(
    form: Any, aids: dict[int, ring.Correct], history: History, found: dict[str, tuple[Event, SampleValidation]]
) -> Any:
    """The history with all that is usable in it, and the watches with what was too late or here before."""
    reached = ring.newest_imu_index(history)
    watches: dict[str, SensorWatch] = {}
    for name, (event, judgement) in found.items():
        history, reached, late, known = lax.cond(
            judgement.usable,
            lambda h=history, d=reached, e=event: _enter_event(h, d, e),
            lambda h=history, d=reached: (h, d, jnp.asarray(False), jnp.asarray(False)),
        )
        watch = judgement.watch
        watches[name] = replace(watch, late=increment(watch.late, late), duplicates=increment(watch.duplicates, known))
    return ring.replay_events(form, history, reached, aids)[0], watches


def _enter_event(history: History, reached: Any, event: Event) -> tuple[History, Any, Any, Any]:
    """The history with an event, how far its states hold, and why it is not in it: too late, or here before."""
    room, known = ring.check_room(history, reached, event)
    enters = room & ~known
    new, now = lax.cond(enters, lambda: ring.insert_event(history, reached, event), lambda: (history, reached))
    return new, now, ~room & ~known, known


def _kinematics(form: Any, node: Any, age: Any, silent: Any) -> dict[str, Any]:
    """Kinematic fields of NavigationState at the time of the newest IMU sample; where it is silent, what holds now."""
    sampled = node, node.felt[0], jnp.asarray(form.noise.gyro, np.float64)
    node, rate, variance = lax.cond(silent, lambda: _coast(form, node, age), lambda: sampled)
    x, P = form.belief(node)
    i = np.array([0, 3, 4])  # the others have no constant part
    belief = Belief(x, P.at[i, i].add(form.noise.constant_variances()[i]))
    return reference_kinematics(belief, rate, variance, form.arms) | {"coasting": jnp.asarray(silent)}


def _coast(form: Any, node: Any, age: Any) -> tuple[Any, Any, Any]:
    """A node, its gyro reading and that one's variance at an age (s): constant velocity and heading, with all doubt."""
    still = form.belief(node).x[5:]  # what an IMU reads that feels nothing
    moved = form.propagate(replace(node, felt=still), age, still, jnp.ones(2))
    return moved, still[0], form.noise.gyro + form.noise.doubtful_rate**2


def _is_valid(form: Any, node: Any) -> Any:
    """Whether every sensor has been used."""
    valid = node.t > NEVER
    if form.intake.heading:
        valid = valid & (node.heading_fix.used > 0)
    if form.intake.position:
        valid = valid & (node.position_fix.used > 0)
    return valid


def _navigation_state(node: Any, state: InertialState) -> NavigationState:
    """All that is told."""
    return NavigationState(
        **state.told,
        heading_fix=node.heading_fix,
        position_fix=node.position_fix,
        imu=state.imu,
        heading_sensor=state.heading,
        position_sensor=state.position,
        clock_backwards=state.clock_backwards,
    )

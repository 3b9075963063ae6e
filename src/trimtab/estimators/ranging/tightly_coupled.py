"""Raw ultrasonic ranges straight into an inertial filter, each ping at the time at which it was sent.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.linalg import symmetric
from trimtab.core.record import Scalar, option, part, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, Frame
from trimtab.estimators.inertial.aided import InertialState, Intake, initial_inertial_state, navigate_with, range_aid
from trimtab.estimators.inertial.coupled import (
    SIGNS,
    coupled_process_noise,
    coupled_transition,
    low_pass_gain,
)
from trimtab.estimators.inertial.dual_filter import InertialNoise
from trimtab.estimators.inertial.mechanisation import DIMENSION, Belief, InertialStart, LeverArms, mechanise
from trimtab.estimators.inertial.navigation_state import HeadingFix, fuse_measurement, no_heading_fix
from trimtab.estimators.inertial.sensor_watch import NEVER, increment
from trimtab.estimators.ranging.position import SQUARE
from trimtab.estimators.ranging.range_errors import RangeErrorModel, RangeFix, no_range_fix
from trimtab.estimators.ranging.range_model import Geometry
from trimtab.estimators.ranging.start import (
    RangingStart,
    add_heading,
    correction_mask,
    empty_start,
    find_agreeing_ranges,
    propagate_start,
    tree_where,
    update_running,
    update_starting,
)

PAIR = np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 0.0]])


@record
class TightNode:
    """State, its covariance and the start under way at one instant. Source: docs page."""

    t: Scalar = quantity("100 ns", "The instant.", kind="time")
    felt: Any = quantity("1", "IMU: yaw rate (rad/s), force per mass forward and starboard (m/s^2).", shape=(3,))
    doubt: Any = quantity("1", "1 where gyro, or accelerometers, can't be trusted.", shape=(2,))
    x: Any = quantity("1", "As Belief.x, then the scale and each beacon's error; (9 + n,).")
    P: Any = quantity("1", "Covariance of estimate minus truth (9 + n, 9 + n).")
    force: Any = quantity("m/s^2", "Force per mass in the Jacobian, without bias.", frame="B", shape=(2,))
    steady: Any = quantity("m/s^2", "The same, low-passed as tells rest from motion.", frame="B", shape=(2,))
    start: RangingStart = part("Pings until the filter can start.")
    heading_fix: HeadingFix = part("How headings fared.")
    position_fix: RangeFix = part("How ranges fared.")


@record
class TightlyCoupled:
    """Extended filter that fuses every single range: two beacons still help, and a wrong range costs only itself.

    State: heading, velocity, position, gyro and accelerometer biases, a scale of all ranges, an error of each beacon.
    With two units, or a lever and motion, ranges alone show the heading.

    Starts:  by itself from the first four pings of three ranges or more, in closed form (`ranging_start`): no first
             guess. `start` then gives biases only; with begins="given" it gives all.
    Frames:  beacons in W, units in B; level vehicle on a flat floor.
    Not modelled: survey errors that change with the place; the vehicle's motion during the sound's flight.
    Source:  [1] chapter 7 names it as future work; docs page.
    """

    intake: Intake = part(
        "What is read; `position` names the ranging.", default=Intake(heading="", position="ranging", slots=48)
    )
    noise: InertialNoise = part("Of IMU and heading sensor.", default=InertialNoise())
    errors: RangeErrorModel = part("Of the ranges.", default=RangeErrorModel())
    start: InertialStart = part("What is believed at first.", default=InertialStart())
    arms: LeverArms = part("Where the IMU sits.", default=LeverArms())
    beacons: Any = quantity("m", "Surveyed positions (n, 3).", default=SQUARE, frame="W")
    units: Any = quantity("m", "Positions (m, 3) of the vehicle's units.", default=PAIR, frame="B")
    down: Scalar = quantity("m", "Down coordinate of the vehicle's reference point.", default=0.0, frame="W")
    smoothing: Scalar = quantity("s", "Time constant of the low-pass on the Jacobian's force.", default=0.05, low=0)
    rest_smoothing: Scalar = quantity("s", "The same on the force that tells rest.", default=0.5, low=0)
    rest_sigmas: Scalar = quantity("1", "As in the coupled form; for one unit only.", default=3.0, low=0)
    start_sigma: Scalar = quantity(
        "m", "Of a range while starting, its constant errors included.", default=0.03, above=0
    )
    start_heading: Scalar = quantity("rad", "Heading sigma that is enough to start.", default=0.25, above=0)
    start_time: Scalar = quantity("s", "Longest time that a start may take.", default=3.0, above=0)
    cone: bool = option("Whether ranges are too long off the axis.", default=True, choices=(True, False))
    begins: str = option('From "ranges", or as `start` says ("given").', default="ranges", choices=("ranges", "given"))

    @property
    def listens(self) -> tuple[str, ...]:
        """The IMU and what aids it."""
        return self.intake.listens()

    def check(self) -> None:
        """Refuse an intake that can't work, and beacons or units that are not lists of positions."""
        self.intake.check()
        if not self.intake.position:
            raise InputError("TightlyCoupled.intake.position", "no ranging sensor is named", fix="name it")
        check_positions("TightlyCoupled", self)

    def init(self, key: Key) -> InertialState:
        """Nothing measured yet."""
        return initial_inertial_state(self, np.shape(self.beacons)[0] + 1)

    def step(self, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
        """The estimate at integer time t; its state is a NavigationState whose position_fix is a RangeFix."""
        return _step_filter(self, t, state, frame)

    def first(self) -> TightNode:
        """Before the first sample."""
        s, n = self.start, np.shape(self.beacons)[0]
        mean = jnp.concatenate([jnp.reshape(jnp.asarray(s.heading, np.float64), 1), s.velocity(), s.position()])
        variances = jnp.concatenate([self.start_variances(), self.errors.variances(n)])
        given = self.begins == "given"
        return TightNode(
            t=np.int64(NEVER),
            felt=np.zeros(3),
            doubt=np.zeros(2),
            x=jnp.concatenate([mean, jnp.zeros(4 + n)]),
            P=jnp.diag(variances),
            force=np.zeros(2),
            steady=np.zeros(2),
            start=empty_start(),
            heading_fix=no_heading_fix(),
            position_fix=replace(no_range_fix(n), tracking=np.bool_(given), starts=np.int32(given)),
        )

    def propagate(self, node: TightNode, dt: Any, felt: Any, doubt: Any) -> TightNode:
        """A time dt (s) on, to where the IMU reads felt (3,)."""
        x = node.x
        B = planar(x[0])
        heading = x[0] + dt / 2 * (felt[0] + node.felt[0]) - dt * x[5]
        bias = B @ x[6:8]
        f0, f1 = B @ node.felt[1:] - bias, planar(heading) @ felt[1:] - bias
        velocity, position = mechanise(dt, f0, f1, x[1:3], x[3:5])
        mean = (node.felt[1:] + felt[1:]) / 2 - x[6:8]
        force = node.force + low_pass_gain(dt, self.smoothing) * (mean - node.force)
        steady = node.steady + low_pass_gain(dt, self.rest_smoothing) * (mean - node.steady)
        signs = SIGNS[:, None] * SIGNS[None, :]
        F = coupled_transition(dt, x[0], force) * signs
        Q = coupled_process_noise(self.noise.growth(dt, doubt), x[0], self.noise.integration_time(dt)) * signs
        own, cross = node.P[:DIMENSION, :DIMENSION], F @ node.P[:DIMENSION, DIMENSION:]
        rest = node.P[DIMENSION:, DIMENSION:]
        wanders = jnp.where(np.arange(rest.shape[0]) == 0, dt * self.errors.scale_walk**2, 0.0)
        rest = rest + jnp.where(np.eye(rest.shape[0], dtype=bool), wanders[:, None], 0.0)
        top = jnp.concatenate([symmetric(F @ own @ F.T + Q), cross], axis=1)
        P = jnp.concatenate([top, jnp.concatenate([cross.T, rest], axis=1)])
        moved = jnp.concatenate([heading[None], velocity, position, x[5:]])
        start = propagate_start(node.start, dt, node.felt, felt, x[5:8])
        start = tree_where(jnp.max(doubt) > 0, empty_start(), start)
        return replace(node, felt=felt, x=moved, P=P, force=force, steady=steady, start=start)

    def correct_heading(self, node: TightNode, z: Any, variance: Any) -> TightNode:
        """With a heading z (rad), any equal of it, and its variance (0: that of noise); while starting, for that."""
        H = (jnp.arange(node.x.shape[0]) == 0).astype(np.float64)[None]
        R = self.noise.heading_noise(variance)
        believed = {"gate": self.intake.gate_heading, "patience": self.intake.patience_heading}
        y = wrap(z - node.x[0])[None]
        corrected = correction_mask(self, node).at[0].set(1.0).at[5].set(1.0)
        done, fix = fuse_measurement(node.heading_fix, node.x, node.P, y, H, R, consider=corrected, **believed)
        fused = replace(node, x=done.x, P=done.P, heading_fix=fix)
        waiting = replace(
            node,
            start=add_heading(node.start, z, R[0, 0]),
            heading_fix=replace(node.heading_fix, used=increment(node.heading_fix.used, True)),
        )
        return tree_where(node.position_fix.tracking, fused, waiting)

    def correct_ranges(self, node: TightNode, value: Any) -> TightNode:
        """With the ranges of a ping and its unit (n + 1,); 0 where none arrived, -1 where it was not a number."""
        n = np.shape(self.beacons)[0]
        unit = jnp.clip(value[n], 0, np.shape(self.units)[0] - 1).astype(np.int32)
        unsure = jnp.sqrt(node.P[3, 3] + node.P[4, 4]) > self.errors.wide
        fix = node.position_fix
        invalid = (fix.invalid + jnp.sum(value[:n] < 0)).astype(np.int32)
        node = replace(node, position_fix=replace(fix, unit=unit, invalid=invalid))
        check = unsure | ~fix.tracking
        agree, place, good = lax.cond(
            check,
            lambda: find_agreeing_ranges(self, node, value[:n], unit),
            lambda: (value[:n] > 0, jnp.zeros(2), jnp.asarray(False)),
        )
        return lax.cond(
            fix.tracking,
            lambda: update_running(self, node, value[:n], unit, agree),
            lambda: update_starting(self, node, unit, agree, place, good),
        )

    def belief(self, node: TightNode) -> Belief:
        """Of the IMU's point."""
        return Belief(node.x[:DIMENSION], node.P[:DIMENSION, :DIMENSION])

    def geometry(self, unit: Any) -> Geometry:
        """Of the ranges of a unit."""
        lever = jnp.asarray(self.units, np.float64)[unit]
        beacons = jnp.asarray(self.beacons, np.float64)
        return Geometry(beacons, lever[:2] - self.arms.imu, self.down + lever[2], self.cone)

    def start_variances(self) -> Any:
        """In the order of Belief.x."""
        (heading, bias), motion = self.start.heading_variances(), self.start.motion_variances()
        return jnp.concatenate([heading[None], motion[:4], bias[None], motion[4:]])


@jax.jit
def _step_filter(form: TightlyCoupled, t: Any, state: InertialState, frame: Frame) -> tuple[InertialState, Estimate]:
    state, estimate = navigate_with(form, range_aid(form), t, state, frame)
    return state, replace(estimate, valid=estimate.valid & estimate.state.position_fix.tracking)


def check_positions(name: str, form: Any) -> None:
    """Refuse beacons or units that are not lists of positions."""
    for field in ("beacons", "units"):
        shape = np.shape(getattr(form, field))
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 1:
            raise InputError(f"{name}.{field}", f"has shape {shape}", fix="give one row of three for each")

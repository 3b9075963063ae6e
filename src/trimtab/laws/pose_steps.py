"""Law of the thesis [1] that brings the hovercraft to rest at a position and heading, in six steps.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
section 2.3.1, which describes the steps in words. The parameter values, and the conditions that end a step, are
our own choice (docs page).
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from trimtab.core.record import Scalar, part, quantity, record, replace, tree_where
from trimtab.core.rotation import DEG, wrap
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.laws.heading import DAMP, HeadingBangBang, HeadingLawState
from trimtab.laws.pose import READS
from trimtab.laws.spin import switching_energy
from trimtab.laws.velocity import ForwardMomentum, ZeroVelocity

COMPUTE, ALIGN, MOVE, STOP, FINAL, HOLD = range(6)
"""Indices of the steps of the law, which are numbered 1 to 6 in [1, section 2.3.1]."""
STEPS = ("compute", "align", "move", "stop", "final", "hold")


@record
class PoseStepsState:
    """State of the law `PoseBySteps`. Source: [1] section 2.3.1."""

    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    bearing: Scalar = quantity(
        "rad",
        "Bearing of the target position when it was last computed, clockwise from north.",
        kind="angle",
    )
    turning: HeadingLawState = part('State of the heading law that is used in the steps "align" and "final".')
    rounds: Scalar = quantity("1", "Number of times that the vector to the target position was computed.", kind="count")


@record
class PoseStepsOutput:
    """Demand and signals of the law `PoseBySteps`. Source: [1] section 2.3.1."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    mode: Scalar = quantity("1", "Active step of the law.", kind="mode", modes=STEPS)
    rounds: Scalar = quantity("1", "Number of times that the vector to the target position was computed.", kind="count")
    heading_reference: Scalar = quantity(
        "rad",
        'Bearing of the target position in the steps "align" and "move"; target heading in other steps.',
        kind="angle",
    )
    distance: Scalar = quantity("m", "Distance of the centre of mass from its target position.")
    speed_reference: Scalar = quantity("m/s", 'Speed reference in step "move"; 0 in other steps.')


@record
class PoseBySteps:
    """Law that brings the hovercraft near a position and heading in the six steps of [1], which repeat for ever.

        compute  the vector to the target position   then align, or final if near the target
        align    HeadingBangBang to that bearing     until the heading is within the heading law's tolerance
        move     ForwardMomentum at speed_gain times the remaining distance along the nose, within limits
                                                     until that distance is below `passed`, or the bearing error exceeds
                                                     off_course
        stop     ZeroVelocity                        until V < margin times the turn's switching energy, then compute
        final    HeadingBangBang to the heading      until within tolerance
        hold     ZeroVelocity                        until 1.5 near or 1.5 near_heading away, then compute

    Ends:    never, because the heading drifts without bound under ZeroVelocity (its slow manifold).
    Source:  [1] section 2.3.1; gains and tolerances are our own choice, see docs page.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    north: Scalar = quantity("m", "Target north coordinate of the centre of mass.", frame="W", default=0.0)
    east: Scalar = quantity("m", "Target east coordinate of the centre of mass.", frame="W", default=0.0)
    heading: Scalar = quantity("rad", "Target heading of the nose.", kind="angle", default=0.0)
    near: Scalar = quantity("m", "Remaining distance below which the position counts as reached.", default=0.3, above=0)
    near_heading: Scalar = quantity(
        "rad", "Heading error below which the heading counts as reached.", default=10 * DEG, above=0
    )
    speed_gain: Scalar = quantity(
        "1/s", 'Speed gain: commanded speed per remaining distance, in step "move".', default=0.35, above=0
    )
    least_speed: Scalar = quantity("m/s", 'Minimum commanded speed in step "move".', default=0.1, above=0)
    most_speed: Scalar = quantity("m/s", 'Maximum commanded speed in step "move".', default=0.6, above=0)
    passed: Scalar = quantity("m", 'Remaining distance along the nose at which step "move" ends.', default=0.1, low=0)
    off_course: Scalar = quantity(
        "rad",
        'Bearing error at which step "move" ends, while the remaining distance is above twice `near`.',
        default=0.6,
        above=0,
    )
    margin: Scalar = quantity(
        "1",
        'Kinetic energy below which step "stop" ends, as a fraction of the switching energy of the heading law.',
        default=0.3,
        above=0,
        high=1,
    )
    turn: HeadingBangBang = part(
        'Law used in the steps "align" and "final". Its parameter `target` is ignored.', default=HeadingBangBang()
    )
    forward: ForwardMomentum = part(
        'Law used in step "move". Its parameter `reference` is ignored.', default=ForwardMomentum(k1=2.0, k2=9.0)
    )
    damping: ZeroVelocity = part('Law used in the steps "stop" and "hold".', default=ZeroVelocity())

    def init(self, key: Any) -> PoseStepsState:
        """Return the initial state, in step "compute"."""
        return PoseStepsState(
            mode=np.asarray(COMPUTE, np.int32),
            bearing=np.asarray(0.0),
            turning=self.turn.init(key),
            rounds=np.asarray(0, np.int32),
        )

    def step(self, t: Any, state: PoseStepsState, estimate: Estimate) -> tuple[PoseStepsState, PoseStepsOutput]:
        """Update the active step of the law, and return the demand at time t (unit: 100 ns)."""
        s = estimate.state
        way = jnp.stack([self.north - s.north, self.east - s.east])
        distance, along = jnp.sqrt(way @ way), jnp.cos(s.heading) * way[0] + jnp.sin(s.heading) * way[1]
        mode, bearing = self._decide(state, estimate, way, distance, along)
        target = jnp.where((mode == ALIGN) | (mode == MOVE), bearing, self.heading)
        turns = (mode == ALIGN) | (mode == FINAL)
        goes_on = turns & (mode == state.mode)
        before = tree_where(goes_on, state.turning, replace(state.turning, mode=np.asarray(DAMP, np.int32)))
        turning, turn = replace(self.turn, target=target).step(t, before, estimate)
        speed = jnp.clip(self.speed_gain * along, self.least_speed, self.most_speed)
        model = self.forward.model
        _, forward = replace(self.forward, reference=model.mass * speed).step(t, (), estimate)
        _, damp = self.damping.step(t, (), estimate)
        demand = tree_where(turns, turn.demand, tree_where(mode == MOVE, forward.demand, damp.demand))
        begun = ((mode == COMPUTE) & estimate.valid).astype(np.int32)
        now = PoseStepsState(
            mode=mode, bearing=bearing, turning=tree_where(turns, turning, before), rounds=state.rounds + begun
        )
        return now, PoseStepsOutput(
            demand=demand,
            mode=mode,
            rounds=now.rounds,
            heading_reference=target,
            distance=distance,
            speed_reference=jnp.where(mode == MOVE, speed, 0.0),
        )

    def _decide(self, state: PoseStepsState, estimate: Estimate, way: Any, distance: Any, along: Any) -> Any:
        """Return the next step and bearing. Neither changes while the estimate is not valid."""
        s, mode = estimate.state, state.mode
        towards = jnp.where(distance > 0, jnp.arctan2(way[1], jnp.where(distance > 0, way[0], 1.0)), s.heading)
        off, off_bearing = jnp.abs(wrap(s.heading - self.heading)), jnp.abs(wrap(s.heading - towards))
        calm = self.margin * switching_energy(self.turn.turning.model, self.turn.turn_rate)
        is_calm = self.damping.lyapunov(s) < calm
        is_aligned = jnp.abs(wrap(s.heading - state.bearing)) <= self.turn.tolerance
        has_moved = (along <= self.passed) | ((off_bearing > self.off_course) & (distance > 2 * self.near))
        has_left = (distance > 1.5 * self.near) | (off > 1.5 * self.near_heading)
        after = [
            jnp.where(distance > self.near, ALIGN, FINAL),
            jnp.where(is_aligned, MOVE, ALIGN),
            jnp.where(has_moved, STOP, MOVE),
            jnp.where(is_calm, COMPUTE, STOP),
            jnp.where(off <= self.turn.tolerance, HOLD, FINAL),
            jnp.where(has_left, COMPUTE, HOLD),
        ]
        following = jnp.select([mode == k for k in range(len(after))], after, mode).astype(np.int32)
        bearing = jnp.where(mode == COMPUTE, towards, state.bearing)
        return jnp.where(estimate.valid, following, mode), jnp.where(estimate.valid, bearing, state.bearing)

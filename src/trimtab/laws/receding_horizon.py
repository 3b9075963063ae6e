"""Receding-horizon control of the hovercraft: the next seconds are optimised within limits, fifty times a second.

Source: own derivation from the model of Z. Kulis, "Feedback control of a hovercraft over a wireless link", University
of Maryland, 2006, eq. 2.11. The solution method is that of [1] M. Diehl, H. Bock, J. Schlöder, "A real-time iteration
scheme for nonlinear optimization in optimal feedback control", SIAM Journal on Control and Optimization 43 (2005) 1714.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.integrate import rk4
from trimtab.core.quadratic_program import (
    ChangeRows,
    QuadraticProgram,
    QuadraticSolution,
    QuadraticStart,
    solve_quadratic_program,
)
from trimtab.core.record import Scalar, option, part, period, quantity, record
from trimtab.core.reference import Circle
from trimtab.core.rotation import planar, wrap
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import ms, to_seconds
from trimtab.laws.pose import READS
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

STAGES = 13
"""Number of stages in the plan. A stage has one thrust and one force angle."""
SLOTS = 8
"""Number of past demands that are stored, for the prediction over the delay to the fan."""


@record
class RecedingHorizonOutput:
    """Demand, and signals of the quadratic program's solution. Source: docs page."""

    demand: PlanarForce = part("Demanded force at the rudder pivot.")
    thrust: Scalar = quantity("N", "Demanded thrust of the fan; negative in reverse.")
    force_angle: Scalar = quantity("rad", "Angle of the demanded force from the body's axis.", kind="angle")
    north_reference: Scalar = quantity("m", "Reference north coordinate of the centre of percussion P.", frame="W")
    east_reference: Scalar = quantity("m", "Reference east coordinate of the centre of percussion P.", frame="W")
    position_error: Scalar = quantity("m", "Distance of the centre of percussion P from its reference position.")
    velocity_error: Scalar = quantity("m/s", "Magnitude of the velocity error of the centre of percussion P.")
    primal: Scalar = quantity("1", "Primal residual: largest violation of a limit by the plan, in N or rad.")
    dual: Scalar = quantity("1", "Dual residual: largest gradient of the Lagrangian at the plan, zero at the optimum.")
    solved: Scalar = quantity("1", "True if the primal and the dual residual are within the tolerance.", kind="flag")
    infeasible: Scalar = quantity("1", "True if no plan can keep the limits.", kind="flag")
    rho: Scalar = quantity("1", "Penalty rho of the limits in the quadratic program.")
    cost: Scalar = quantity("1", "Cost of the plan before the optimisation of this step.")


@record
class RecedingHorizonState:
    """State of the law `RecedingHorizon`. Source: docs page."""

    began: Scalar = quantity("1", "True after the first step.", kind="flag")
    start: Scalar = quantity("100 ns", "Time of the first step, at which the reference begins.", kind="time")
    thrust: Any = quantity("N", "Planned thrust of the fan in each stage; negative in reverse.", shape=(STAGES,))
    angle: Any = quantity("rad", "Planned force angle in each stage.", kind="angle", shape=(STAGES,))
    multipliers: Any = quantity(
        "1", "Lagrange multipliers of the limits in the last quadratic program.", shape=(4 * STAGES,)
    )
    rho: Scalar = quantity("1", "Penalty rho of the limits in the last quadratic program.")
    sent_thrust: Any = quantity(
        "N", "Thrust demanded in the last periods, newest first; negative in reverse.", shape=(SLOTS,)
    )
    sent_angle: Any = quantity(
        "rad", "Force angle demanded in the last periods, newest first.", kind="angle", shape=(SLOTS,)
    )
    output: Any = part("Last output of the law, held until the next plan is computed.")


@record
class RecedingHorizon:
    """Law that computes the best plan within the limits for the next seconds, applies its first move, and replans.

    A plan U consists of STAGES moves (thrust, force angle), each of the duration `stage`. Each `period` the state is
    predicted to the time at which the next move acts, under the moves that were sent before. From this state the last
    plan, shifted by a period, is simulated on the model. The residuals (errors of position, velocity, yaw rate and
    heading, the moves and their changes, each times its weight) are linearised in small changes dU of the plan. The
    best change within the limits solves a quadratic program:

        minimise |r + J dU|^2 + damping |dU|^2    subject to    limits of U, limits of its change from stage to stage

    One such Gauss-Newton step is made each period [1].

    Limits:  thrust from -pull to push, force angle within deflection, and the rates of both. The angle is that of the
             force, also with the fan in reverse.
    Holds:   the demand between two plans, so the autopilot may run faster than the planning.
    Fails:   without raising an error. If the quadratic program is not solved, the signal `solved` is False, and the
             demand still keeps the limits.
    Valid:   the limits apply to the demand. The allocation's table and dead zone are not in the model.
    Source:  own derivation; [1]. Weights and limits are our own choice.
    """

    reads: ClassVar[tuple[str, ...]] = READS

    reference: Any = part("Reference position, as a function of time.", default=Circle())
    position: Scalar = quantity("1/m", "Weight of the position error.", default=2.0, low=0)
    velocity: Scalar = quantity("s/m", "Weight of the velocity error.", default=1.5, low=0)
    yaw: Scalar = quantity(
        "s/rad",
        "Weight of the yaw rate error: yaw rate minus the turn rate of the reference acceleration.",
        default=0.1,
        low=0,
    )
    heading: Scalar = quantity(
        "1/rad", "Weight of the heading error. It applies only where the reference has a heading.", default=0.5, low=0
    )
    alignment_weight: Scalar = quantity(
        "s^2/m", "Weight of the angle between the nose and the needed force.", default=1.0, low=0
    )
    k1: Scalar = quantity(
        "1/s^2",
        "Gain k1 from position error to the needed acceleration. The nose turns to the direction of this acceleration.",
        default=0.25,
        low=0,
    )
    k2: Scalar = quantity(
        "1/s",
        "Gain k2 from velocity error to the needed acceleration. The nose turns to the direction of this acceleration.",
        default=0.5,
        low=0,
    )
    least: Scalar = quantity(
        "m/s^2",
        "Reference acceleration below which the yaw rate of the reference fades to zero.",
        default=0.03,
        above=0,
    )
    last: Scalar = quantity(
        "1", "Factor on the weights of the errors in the last stage of the plan.", default=2.0, low=0
    )
    effort: Scalar = quantity("1/N", "Weight of the thrust in the cost.", default=0.1, low=0)
    steering: Scalar = quantity("1/rad", "Weight of the force angle in the cost.", default=0.1, low=0)
    thrust_change: Scalar = quantity("1/N", "Weight of the change of thrust from stage to stage.", default=0.2, low=0)
    angle_change: Scalar = quantity(
        "1/rad", "Weight of the change of force angle from stage to stage.", default=0.3, low=0
    )
    damping: Scalar = quantity("1", "Weight of the change of the plan from period to period.", default=0.1, above=0)
    push: Scalar = quantity("N", "Maximum forward force.", default=1.35, above=0)
    pull: Scalar = quantity("N", "Maximum backward force.", default=0.6, above=0)
    deflection: Scalar = quantity("rad", "Maximum force angle.", default=0.36, above=0, high=1.2, kind="angle")
    thrust_rate: Scalar = quantity("N/s", "Maximum rate of the thrust.", default=8.0, above=0)
    angle_rate: Scalar = quantity("rad/s", "Maximum rate of the force angle.", default=3.0, above=0)
    lag: Scalar = quantity("s", "Delay from a demand to the force: uplink and servo frame.", default=0.05, low=0)
    stage: int = period("Duration of one stage of the plan.", default=ms(200))
    period: int = period("Period of the planning.", default=ms(20))
    rounds: int = option("Number of matrix factorisations in one quadratic program.", default=2)
    iterations: int = option("Number of solver iterations after each factorisation.", default=25)
    model: Hovercraft = part("Vehicle model used by the law.", default=Hovercraft())

    def init(self, key: Any) -> RecedingHorizonState:
        """Return the initial state. Its plan has a little thrust, because otherwise the force angle has no effect."""
        o, no, slots = np.asarray(0.0), np.asarray(False), np.zeros(SLOTS)
        output = RecedingHorizonOutput(PlanarForce(o, o), o, o, o, o, o, o, o, o, no, no, o, o)
        return RecedingHorizonState(
            began=no,
            start=np.asarray(0, np.int64),
            thrust=np.full(STAGES, 0.1),
            angle=np.zeros(STAGES),
            multipliers=np.zeros(4 * STAGES),
            rho=np.asarray(0.1),
            sent_thrust=slots,
            sent_angle=slots,
            output=output,
        )

    def step(self, t: Any, state: RecedingHorizonState, estimate: Estimate) -> tuple[Any, RecedingHorizonOutput]:
        """Return the demand at time t (unit: 100 ns). It is planned every `period`, and held in between."""
        due = estimate.valid & ((t % self.period == 0) | ~state.began)
        state = jax.lax.cond(due, lambda: self._plan(t, state, estimate), lambda: state)
        return state, state.output

    def _plan(self, t: Any, state: RecedingHorizonState, estimate: Estimate) -> RecedingHorizonState:
        """Return the state with an improved plan, and the plan's first move as the demand."""
        sent = jnp.stack([state.sent_thrust, state.sent_angle], axis=1)
        here = jnp.stack([getattr(estimate.state, name) for name in READS])
        x = self._carry_on(here, sent, estimate.age + self.lag)
        start = jnp.where(state.began, state.start, t)
        now = to_seconds(t - start)
        old = jnp.stack([state.thrust, state.angle], axis=1)
        share = self.period / self.stage
        nominal = old + share * (jnp.concatenate([old[1:], old[-1:]]) - old)
        before = sent[0]
        program, cost = self._program(x, now + self.lag, nominal, before)
        warm = QuadraticStart(jnp.zeros(2 * STAGES), state.multipliers, state.rho)
        found = solve_quadratic_program(program, warm, rounds=self.rounds, iterations=self.iterations)
        plan = jnp.where(jnp.isfinite(found.x).all(), nominal + found.x.reshape(STAGES, 2), nominal)
        low, high, rate = self._limits()
        near = rate * to_seconds(self.period)
        plan = jnp.clip(plan, low, high)
        first = jnp.clip(plan[0], before - near, before + near)
        plan = plan.at[0].set(first)
        sent = jnp.concatenate([first[None], sent[:-1]])
        return RecedingHorizonState(
            began=jnp.asarray(True),
            start=start,
            thrust=plan[:, 0],
            angle=plan[:, 1],
            multipliers=found.y,
            rho=found.rho,
            sent_thrust=sent[:, 0],
            sent_angle=sent[:, 1],
            output=self._tell(now, here, first, found, cost),
        )

    def _limits(self) -> tuple[Any, Any, Any]:
        """Return minimum, maximum and maximum rate of a move (thrust, force angle), (2,) each."""
        low = jnp.stack([-self.pull, -self.deflection])
        return low, jnp.stack([self.push, self.deflection]), jnp.stack([self.thrust_rate, self.angle_rate])

    def _carry_on(self, x: Any, sent: Any, ahead: Any) -> Any:
        """Return the state (6,) predicted `ahead` (s) beyond the estimate, under the moves that act until then."""
        each = to_seconds(self.period)

        def slot(k: Any, x: Any) -> Any:
            back = SLOTS - 1 - k
            return self._fly(x, sent[back], jnp.clip(ahead - back * each, 0.0, each))

        return jax.lax.fori_loop(0, SLOTS, slot, x)

    def _fly(self, x: Any, move: Any, h: Any) -> Any:
        """Return the state (6,) after a time h (s) under a constant move."""
        force = _force(move)

        def rate(t: Any, x: Any) -> Any:
            dx = self.model.dynamics(t, HovercraftState(**dict(zip(READS, x, strict=True))), force)
            return jnp.stack([getattr(dx, name) for name in READS])

        return rk4(rate, 0.0, x, h)

    def _program(self, x: Any, begin: Any, nominal: Any, before: Any) -> tuple[QuadraticProgram, Any]:
        """Return the quadratic program in dU (stage by stage: thrust, angle), and the cost of the nominal plan."""
        flat = nominal.reshape(-1)
        r = self._residuals(x, begin, flat)
        J = jax.jacfwd(lambda plan: self._residuals(x, begin, plan))(flat)
        rows = ChangeRows(2)
        now = rows.times(flat) - jnp.concatenate([jnp.zeros_like(flat), before, jnp.zeros(len(flat) - 2)])
        weights = (
            jnp.concatenate([self._tile(self.effort, self.steering), self._tile(self.thrust_change, self.angle_change)])
            ** 2
        )
        low, high, rate = self._limits()
        steps = jnp.concatenate([rate * to_seconds(self.period), jnp.tile(rate * to_seconds(self.stage), STAGES - 1)])
        return QuadraticProgram(
            P=J.T @ J + rows.gram(weights) + self.damping * jnp.eye(len(flat)),
            q=J.T @ r + rows.back(weights * now),
            A=rows,
            l=jnp.concatenate([jnp.tile(low, STAGES), -steps]) - now,
            u=jnp.concatenate([jnp.tile(high, STAGES), steps]) - now,
        ), r @ r + jnp.sum(weights * now**2)

    def _tile(self, thrust: Any, angle: Any) -> Any:
        return jnp.tile(jnp.stack([thrust, angle]), STAGES)

    def _residuals(self, x: Any, begin: Any, plan: Any) -> Any:
        """Return the weighted errors (8 STAGES,) at the end of each stage of a plan."""
        h = to_seconds(self.stage)

        def stage(x: Any, given: Any) -> tuple[Any, Any]:
            k, move = given
            x = self._fly(x, move, h)
            weight = jnp.where(k == STAGES - 1, self.last, 1.0)
            return x, weight * self._errors(x, self.reference.at(begin + (k + 1) * h))

        return jax.lax.scan(stage, x, (jnp.arange(STAGES), plan.reshape(STAGES, 2)))[1].reshape(-1)

    def _away(self, x: Any, wanted: Any) -> tuple[Any, Any]:
        """Return the errors of position and velocity of P, (2,) in W."""
        u, v, r, heading = x[0], x[1], x[2], x[3]
        body, arm = planar(heading), self.model.percussion_arm
        place = x[4:6] + arm * body[:, 0] - wanted.place
        return place, body @ jnp.stack([u, v + arm * r]) - wanted.velocity

    def _errors(self, x: Any, wanted: Any) -> Any:
        """Return the weighted errors (8,) of one state (6,)."""
        r, heading = x[2], x[3]
        place, velocity = self._away(x, wanted)
        push = wanted.acceleration - self.k1 * place - self.k2 * velocity
        size = jnp.sqrt(push @ push + 1e-6)
        a, j = wanted.acceleration, wanted.jerk
        turning = (a[0] * j[1] - a[1] * j[0]) / (a @ a + self.least**2)
        turned = jnp.where(wanted.has_heading, wrap(heading - wanted.heading), 0.0)
        return jnp.concatenate(
            [
                self.position * place,
                self.velocity * velocity,
                self.alignment_weight * (size * planar(heading)[:, 0] - push),
                jnp.stack([self.yaw * (r - turning), self.heading * turned]),
            ]
        )

    def _tell(self, now: Any, x: Any, first: Any, found: QuadraticSolution, cost: Any) -> RecedingHorizonOutput:
        wanted = self.reference.at(now)
        place, velocity = self._away(x, wanted)
        return RecedingHorizonOutput(
            demand=_force(first),
            thrust=first[0],
            force_angle=first[1],
            north_reference=wanted.place[0],
            east_reference=wanted.place[1],
            position_error=jnp.sqrt(place @ place),
            velocity_error=jnp.sqrt(velocity @ velocity),
            primal=found.primal,
            dual=found.dual,
            solved=found.solved,
            infeasible=found.infeasible,
            rho=found.rho,
            cost=cost,
        )


def _force(move: Any) -> PlanarForce:
    """Return the force in B for a thrust (N) and a force angle (rad)."""
    return PlanarForce(FX=move[0] * jnp.cos(move[1]), FY=-move[0] * jnp.sin(move[1]))

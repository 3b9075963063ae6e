"""State feedback about a course computed before: wanted state and input by time, as of the inversion of an output."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record, replace
from trimtab.core.signals import Estimate
from trimtab.laws.state_feedback import StateFeedback, StateFeedbackOutput, StateFeedbackState
from trimtab.laws.state_vector import add_to_input


@record
class CourseTrackingState:
    """How long it has run, and the feedback's integrals. Source: this module."""

    time: Scalar = quantity("s", "Since it began.", default=0.0)
    feedback: StateFeedbackState = part("Of the feedback.", default=StateFeedbackState(np.zeros(0)))


@record
class CourseTracking:
    """A feedforward beside a feedback: what the course says, and the gain on what is off it.

        u = u_d(t) + K (x - x_d(t)) + L z

    x_d and u_d are linear between nodes, and stay at the first and the last. Where an output is non-minimum phase, x_d
    moves before it does (`design.output_inversion`); the course belongs to the vehicle that it was computed for.

    Frames:  of the states.
    Valid:   near the course, for a gain that holds along it. A quaternion is interpolated number by number: nodes a
             small turn apart.
    Source:  S. Devasia, D. Chen, B. Paden, "Nonlinear inversion-based output tracking", IEEE Transactions on Automatic
             Control 41(7), 1996, section IV.
    """

    feedback: StateFeedback = part("The gain, about the course's first point.", default=StateFeedback())
    x: Any = quantity("1", "x_d at the nodes (k, n), as the feedback's x0.", default=np.zeros((2, 4)))
    du: Any = quantity("1", "u_d less the feedback's u0, at the nodes (k, m).", default=np.zeros((2, 2)))
    spacing: Scalar = quantity("s", "Between nodes.", default=0.1, above=0)

    def check(self) -> None:
        """Refuse a course that does not fit the gain."""
        self.feedback.check()
        k, n, m = len(self.x), np.size(self.feedback.x0), np.shape(self.feedback.K)[0]
        if k < 2 or np.shape(self.x) != (k, n) or np.shape(self.du) != (k, m):
            problem = f"x {np.shape(self.x)} and du {np.shape(self.du)} don't fit {n} states and {m} inputs"
            raise InputError("CourseTracking.x", problem, fix=f"give x (k, {n}) and du (k, {m}), k at least 2")

    @property
    def reads(self) -> tuple[str, ...]:
        """Fields of the state: those of the feedback."""
        return self.feedback.reads

    def init(self, key: Any) -> CourseTrackingState:
        """The course begins."""
        return CourseTrackingState(jnp.asarray(0.0), self.feedback.init(key))

    def step(
        self, t: Any, state: CourseTrackingState, estimate: Estimate
    ) -> tuple[CourseTrackingState, StateFeedbackOutput]:
        """The demand at integer time t."""
        x, du = jnp.asarray(self.x), jnp.asarray(self.du)
        place = jnp.clip(state.time / self.spacing, 0.0, len(x) - 1.0)
        node = jnp.minimum(jnp.floor(place), len(x) - 2.0).astype(int)
        s = place - node
        wanted = (1 - s) * x[node] + s * x[node + 1]
        u = add_to_input(self.feedback.u0, (1 - s) * du[node] + s * du[node + 1])
        feedback, output = replace(self.feedback, x0=wanted, u0=u).step(t, state.feedback, estimate)
        return CourseTrackingState(state.time + estimate.dt, feedback), output

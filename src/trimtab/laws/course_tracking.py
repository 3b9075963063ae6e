"""State feedback about a precomputed trajectory: a table of reference states and inputs over time."""

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
    """State of the law `CourseTracking`: time since its start, and integrals of the errors. Source: this module."""

    time: Scalar = quantity("s", "Time since the law started.", default=0.0)
    feedback: StateFeedbackState = part(
        "State of the feedback: integrals of the state errors.", default=StateFeedbackState(np.zeros(0))
    )


@record
class CourseTracking:
    """Law with feedforward and feedback: the input of a trajectory, plus a gain on the deviation from the trajectory.

        u = u_d(t) + K (x - x_d(t)) + L z

    x_d and u_d are the reference state and input, and z the integrals of the errors. x_d and u_d are linear between the
    nodes of the trajectory, and constant before the first and after the last node. If the output is non-minimum phase,
    x_d moves before the output (`design.output_inversion`). A trajectory is valid only for the vehicle for which it was
    computed.

    Frames:  those of the state fields.
    Valid:   near the trajectory, if the gain stabilises the vehicle along the entire trajectory. Quaternions are
             interpolated element by element, so neighbouring nodes must differ by a small rotation.
    Source:  S. Devasia, D. Chen, B. Paden, "Nonlinear inversion-based output tracking", IEEE Transactions on Automatic
             Control 41(7), 1996, section IV.
    """

    feedback: StateFeedback = part(
        "State feedback on the deviation from the trajectory. The feedback's x0 and u0 are the first point "
        "of the trajectory.",
        default=StateFeedback(),
    )
    x: Any = quantity(
        "1",
        "Reference state x_d at the k nodes of the trajectory (k, n), with columns in the order of the feedback's x0.",
        default=np.zeros((2, 4)),
    )
    du: Any = quantity(
        "1",
        "Reference input u_d minus the feedback's u0, at the k nodes of the trajectory (k, m).",
        default=np.zeros((2, 2)),
    )
    spacing: Scalar = quantity("s", "Time between two nodes of the trajectory.", default=0.1, above=0)

    def check(self) -> None:
        """Raise InputError if the shapes of trajectory and gain do not match."""
        self.feedback.check()
        k, n, m = len(self.x), np.size(self.feedback.x0), np.shape(self.feedback.K)[0]
        if k < 2 or np.shape(self.x) != (k, n) or np.shape(self.du) != (k, m):
            problem = (
                f"the shapes of x, {np.shape(self.x)}, and du, {np.shape(self.du)}, do not match {n} states "
                f"and {m} inputs"
            )
            raise InputError("CourseTracking.x", problem, fix=f"give x (k, {n}) and du (k, {m}), k at least 2")

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the names of the state fields that the feedback reads."""
        return self.feedback.reads

    def init(self, key: Any) -> CourseTrackingState:
        """Return the initial state, at the start of the trajectory."""
        return CourseTrackingState(jnp.asarray(0.0), self.feedback.init(key))

    def step(
        self, t: Any, state: CourseTrackingState, estimate: Estimate
    ) -> tuple[CourseTrackingState, StateFeedbackOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        x, du = jnp.asarray(self.x), jnp.asarray(self.du)
        place = jnp.clip(state.time / self.spacing, 0.0, len(x) - 1.0)
        node = jnp.minimum(jnp.floor(place), len(x) - 2.0).astype(int)
        s = place - node
        wanted = (1 - s) * x[node] + s * x[node + 1]
        u = add_to_input(self.feedback.u0, (1 - s) * du[node] + s * du[node + 1])
        feedback, output = replace(self.feedback, x0=wanted, u0=u).step(t, state.feedback, estimate)
        return CourseTrackingState(state.time + estimate.dt, feedback), output

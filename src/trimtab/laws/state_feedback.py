"""State feedback about a trim, with integral action: the law that uses a gain from `trimtab design --lqr`."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import option, part, quantity, record
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.laws.state_vector import add_to_input, state_error

PLANAR = ("surge_velocity", "sway_velocity", "yaw_rate", "heading")


@record
class StateFeedbackState:
    """State of the law `StateFeedback`: integrals of the errors. Source: this module."""

    integrals: Any = quantity(
        "1", "Time integrals of the elements of e listed in `integrated`, each in the unit of its state times seconds."
    )


@record
class StateFeedbackOutput:
    """Demand and signals of the law `StateFeedback`. Source: this module."""

    demand: Any = part("Demanded input of the vehicle.")
    error: Any = quantity("1", "Error e: state minus the trim state x0. Each element has the unit of its state.")
    integrals: Any = quantity(
        "1", "Time integrals of the elements of e listed in `integrated`, each in the unit of its state times seconds."
    )


@record
class StateFeedback:
    """Law of linear state feedback about a trim (x0, u0), with integral action.

        u = u0 + K e + L z        e = x - x0        z' = the elements `integrated` of e, |z| <= most

    The error of a quaternion has three elements: the rotation vector from the quaternion in x0, in body axes, as in
    `design.coordinates`. So for a state with a quaternion K has one column less than the state has numbers. To move the
    set-point, change x0 in flight.

    Frames:  those of the state fields. Vector fields in the frame X of the quaternion q_XB can be compared in body
             axes. For a field in `turned`, state and x0 are each turned into their own body axes. For a field in
             `places`, the difference is turned into the body axes of x0.
    Valid:   near (x0, u0), for which K was designed; angles are not wrapped.
    Source:  B. D. O. Anderson, J. B. Moore, "Optimal control: linear quadratic methods", Prentice Hall 1990, chapters
             3 and 4.
    """

    reads: tuple[str, ...] = option(
        "Names of the state fields that the law reads, in the order of K's columns.", default=PLANAR
    )
    K: Any = quantity(
        "1",
        "Feedback gain K (m, n) in u = u0 + K e. For negative feedback the minus sign is in K.",
        default=np.zeros((2, 4)),
    )
    x0: Any = quantity(
        "1", "Trim state x0: the values of the fields in `reads`, concatenated in this order.", default=np.zeros(4)
    )
    u0: Any = part("Trim input u0, a record of the vehicle's input type.", default=PlanarForce(0.0, 0.0))
    integrated: tuple[int, ...] = option(
        "Indices of the elements of the error e that are integrated, counted from 0.", default=()
    )
    L: Any = quantity("1", "Integral gain L (m, k) in u = u0 + K e + L z.", default=np.zeros((2, 0)))
    most: Any = quantity("1", "Maximum magnitude of each error integral (k,).", default=np.zeros(0), low=0)
    attitude: str = option("Name of the quaternion field. Needed only if turned or places is not empty.", default="")
    turned: tuple[str, ...] = option(
        "Names of vector fields, e.g. a velocity, that are compared after state and x0 were each turned into "
        "their own body axes.",
        default=(),
    )
    places: tuple[str, ...] = option(
        "Names of vector fields, e.g. a position, whose deviation from x0 is turned into the body axes of x0.",
        default=(),
    )
    design_model: Any = part(
        "Vehicle model for which K was designed, stored in the log for comparison. None: not stored.", default=None
    )

    def check(self) -> None:
        """Raise InputError if the shapes of the gains do not match."""
        K, L, k = np.shape(self.K), np.shape(self.L), len(self.integrated)
        if len(K) != 2 or len(L) != 2 or (K[0], k) != L or np.shape(self.most) != (k,):
            problem = f"the shapes of K {K}, L {L} and most {np.shape(self.most)} do not match {k} integrals"
            raise InputError(
                "StateFeedback.K",
                problem,
                fix="give K the shape (m, n), L the shape (m, k) and most the shape (k,), for m inputs and k integrals",
            )
        if any(not 0 <= row < K[1] for row in self.integrated):
            problem = f"indices must be within 0 to {K[1] - 1}, got {self.integrated}"
            raise InputError("StateFeedback.integrated", problem, fix="give indices of elements of e, counted from 0")

    def init(self, key: Any) -> StateFeedbackState:
        """Return the initial state: all integrals are zero."""
        return StateFeedbackState(jnp.zeros(len(self.integrated)))

    def step(
        self, t: Any, state: StateFeedbackState, estimate: Estimate
    ) -> tuple[StateFeedbackState, StateFeedbackOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        e = state_error(estimate.state, self.reads, self.x0, self.attitude, self.turned, self.places)
        rows = [e[i] for i in self.integrated]
        z = state.integrals
        if rows:
            z = jnp.clip(z + estimate.dt * jnp.stack(rows), -jnp.asarray(self.most), jnp.asarray(self.most))
        change = jnp.asarray(self.K) @ e
        if rows:
            change = change + jnp.asarray(self.L) @ z
        demand = add_to_input(self.u0, change)
        return StateFeedbackState(z), StateFeedbackOutput(demand, e, z)

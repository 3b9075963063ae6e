"""Law that runs a linear compensator designed elsewhere: x(k+1) = A x(k) + B e(k), u = u0 + C x(k) + D e(k)."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, period, quantity, record
from trimtab.core.signals import Estimate, PlanarForce
from trimtab.core.time import NEVER, ms
from trimtab.laws.state_feedback import PLANAR
from trimtab.laws.state_vector import add_to_input, state_error


@record
class StateSpaceState:
    """State of the law `StateSpaceLaw`. Source: this module."""

    x: Any = quantity("1", "State of the compensator.")
    u: Any = quantity("1", "Last output of the compensator, which is added to the trim input u0.")
    began: Scalar = quantity("100 ns", "Time at which the present period of the compensator began.", kind="time")


@record
class StateSpaceOutput:
    """Demand and signals of the law `StateSpaceLaw`. Source: this module."""

    demand: Any = part("Demanded input of the vehicle.")
    error: Any = quantity("1", "Error e: state fields minus the trim x0. Each element has the unit of its field.")


@record
class StateSpaceLaw:
    """Discrete linear compensator whose input is e = x - x0, for the fields in `reads`.

        x(k+1) = A x(k) + B e(k)        u(k) = u0 + C x(k) + D e(k)        once per `period`, held between

    The autopilot may run faster than `period`. `design.exchange` makes a compensator from an object of python-control
    or scipy.

    Frames:  those of the state fields.    Valid: near (x0, u0).    Not modelled: limits of the inputs.
    Source:  K. J. Åström, B. Wittenmark, "Computer-controlled systems", Prentice Hall 1997, chapters 2 and 8.
    """

    reads: tuple[str, ...] = option(
        "Names of the state fields that the law reads, in the order of B's columns.", default=PLANAR
    )
    A: Any = quantity("1", "Matrix A of the compensator (k, k).", default=np.zeros((1, 1)))
    B: Any = quantity("1", "Matrix B of the compensator (k, n), for n errors.", default=np.zeros((1, 4)))
    C: Any = quantity("1", "Matrix C of the compensator (m, k), for m inputs.", default=np.zeros((2, 1)))
    D: Any = quantity("1", "Matrix D of the compensator (m, n).", default=np.zeros((2, 4)))
    x0: Any = quantity(
        "1", "Trim state x0: the values of the fields in `reads`, concatenated in this order.", default=np.zeros(4)
    )
    u0: Any = part("Trim input u0, a record of the vehicle's input type.", default=PlanarForce(0.0, 0.0))
    period: int = period("Sample period for which A, B, C and D are designed.", default=ms(1))

    def check(self) -> None:
        """Raise InputError if the shapes of the matrices do not match."""
        A, B, C, D = (np.shape(M) for M in (self.A, self.B, self.C, self.D))
        if not (len(A) == len(B) == len(C) == len(D) == 2) or not (A[0] == A[1] == B[0] == C[1] and (C[0], B[1]) == D):
            problem = f"the shapes of A {A}, B {B}, C {C} and D {D} do not match each other"
            raise InputError(
                "StateSpaceLaw.A",
                problem,
                fix="give A (k, k), B (k, n), C (m, k) and D (m, n), for k states, n errors and m inputs",
            )

    def init(self, key: Any) -> StateSpaceState:
        """Return the initial state: the compensator's state is zero."""
        return StateSpaceState(jnp.zeros(np.shape(self.A)[0]), jnp.zeros(np.shape(self.C)[0]), np.int64(NEVER))

    def step(self, t: Any, state: StateSpaceState, estimate: Estimate) -> tuple[StateSpaceState, StateSpaceOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        e = state_error(estimate.state, self.reads, self.x0)
        began = t // self.period * self.period
        due = began != state.began
        u = jnp.where(due, jnp.asarray(self.C) @ state.x + jnp.asarray(self.D) @ e, state.u)
        x = jnp.where(due, jnp.asarray(self.A) @ state.x + jnp.asarray(self.B) @ e, state.x)
        return StateSpaceState(x, u, began), StateSpaceOutput(add_to_input(self.u0, u), e)

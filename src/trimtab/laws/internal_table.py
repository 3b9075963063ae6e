"""Internal states that go with a command that is known beforehand: computed offline, kept as a table by time."""

from typing import Any

import numpy as np
from jax import lax

from trimtab.core.errors import InputError
from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, option, quantity, record

INTERNALS = 6
"""alpha, Q, eta1, eta1', eta2, eta2'."""


@record
class InternalTable:
    """Wanted internal states zeta_d by time: cubic Hermite between nodes, held at both ends.

    With s the passed part of an interval D between the nodes z0, z1 whose rates are r0, r1:

        zeta_d = z0 + s^2 (3 - 2 s) (z1 - z0) + D s (1 - s) ((1 - s) r0 - s r1)

    It is for one command: whoever fills it says which. Order: (alpha, Q, eta1, eta1', eta2, eta2'), in rad, rad/s and
    modal units.

    Source: the interpolation formula is the textbook one (Hairer, Norsett, Wanner, "Solving ordinary differential
            equations I", section II.6); the nodes are from the bounded solution, see docs page.
    """

    nodes: Any = quantity("1", "zeta_d at the nodes (n, 6), n at least 2, each in its own unit.")
    rates: Any = quantity("1/s", "Its rate there (n, 6).")
    first: Scalar = quantity("s", "Time of the first node.", default=0.0)
    spacing: Scalar = quantity("s", "Time between nodes.", default=0.1, above=0)
    exact: bool = option("Whether the nodes solve the internal dynamics; else a linear model.", default=True)

    def check(self) -> None:
        """Refuse what is not a table of six columns, or not finite."""
        for name, value in (("nodes", self.nodes), ("rates", self.rates)):
            shape = np.shape(value)
            if len(shape) != 2 or shape[0] < 2 or shape[1] != INTERNALS:
                problem = f"has shape {shape}, wanted is (n, {INTERNALS}) with n at least 2"
                raise InputError(f"InternalTable.{name}", problem, fix="give a row for each node")
            if not np.isfinite(np.asarray(value)).all():
                row = int(np.argmin(np.isfinite(np.asarray(value)).all(axis=1)))
                raise InputError(f"InternalTable.{name}", f"row {row} is not finite", fix="build the table again")
        if np.shape(self.nodes) != np.shape(self.rates):
            problem = f"{len(self.nodes)} nodes and {len(self.rates)} rates"
            raise InputError("InternalTable.rates", problem, fix="give a rate for each node")

    def check_duration(self, seconds: float) -> None:
        """Refuse a run that outlasts the table: after its end the last node would be wanted for ever."""
        end = float(self.first + self.spacing * (np.shape(self.nodes)[0] - 1))
        if seconds > end + float(self.spacing):
            problem = f"the table ends at {end:g} s, the run at {seconds:g} s"
            fix = f"--duration {end:g}, or --set internal=preview, which needs no table"
            raise InputError("InternalTable", problem, fix=fix)

    def init(self, key: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Any) -> tuple[tuple[()], Any]:
        """zeta_d (6,) at time t (s); the command is the one that the table was made for, and isn't looked at."""
        return state, self.at(t)

    def at(self, t: Any) -> Any:
        """zeta_d (6,) at time t (s)."""
        intervals = np.shape(self.nodes)[0] - 1
        position = jnp.clip((t - self.first) / self.spacing, 0.0, 1.0 * intervals)
        begin = jnp.minimum(jnp.floor(position), intervals - 1.0)
        s, index = position - begin, begin.astype(np.uint32)
        z = lax.dynamic_slice(jnp.asarray(self.nodes), (index, np.uint32(0)), (2, INTERNALS))
        r = lax.dynamic_slice(jnp.asarray(self.rates), (index, np.uint32(0)), (2, INTERNALS))
        bend = self.spacing * s * (1 - s) * ((1 - s) * r[0] - s * r[1])
        return z[0] + s * s * (3 - 2 * s) * (z[1] - z[0]) + bend

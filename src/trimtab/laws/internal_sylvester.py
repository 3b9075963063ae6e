"""Internal states of a filtered step, linear and causal: what the filter is doing now says it all."""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.core.record import quantity, record
from trimtab.laws.path_command import FilteredClimb

STATES = 7
"""Of both filters: h - h_f, h', h'', h''', V - V_f, V', V''."""


@record
class SylvesterInternal:
    """Wanted internal states for a `FilteredClimb`, by the linearised inside, without the future.

    Both filters obey omega' = S omega with omega = (h - h_f, h', h'', h''', V - V_f, V', V''). With X S = A22 X + G,

        zeta_d = zeta_0 + X omega - A22^-1 A21 (dh, 0, dV)

    from the step on, zeta_0 before. It jumps at the step, by what the unstable mode should have begun with before it.
    Valid for small climbs, as every linearisation.

    Source: A. Isidori, "Nonlinear Control Systems", Springer 1995, section 8.4, for the equation; the filters are
            those of the command.
    """

    X: Any = quantity("1", "Follows omega (6, 7) of these wh and wV, each entry in its own unit.", shape=(6, STATES))
    rest: Any = quantity("1", "A22^-1 A21 (6, 3): by (h, h', V), each entry in its own unit.", shape=(6, 3))
    zeta_0: Any = quantity("1", "Trim at the start (6,), each in its own unit.", shape=(6,))

    def init(self, key: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: FilteredClimb) -> tuple[tuple[()], Any]:
        """zeta_d (6,) at time t (s)."""
        p = command.at(t)
        to_h, to_V = p.h - command.h0 - command.dh, p.V - command.V0 - command.dV
        omega = (to_h, p.h_rate, p.h_acceleration, p.h_jerk, to_V, p.V_rate, p.V_acceleration)
        X, rest = jnp.asarray(self.X), jnp.asarray(self.rest)
        moving = sum((X[:, i] * w for i, w in enumerate(omega)), jnp.zeros(6))
        ended = rest[:, 0] * command.dh + rest[:, 2] * command.dV
        return state, jnp.where(t < command.start, self.zeta_0, self.zeta_0 + moving - ended)

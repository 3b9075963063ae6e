"""What is refused before a path law flies: commands that no level flight ends, tables that are not the command's.

Source: docs page, Stable inversion.
"""

from functools import partial
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.float64 import jax, jnp
from trimtab.core.once import QUICKLY
from trimtab.laws.internal_quasi_static import quasi_static
from trimtab.laws.internal_table import InternalTable
from trimtab.laws.path_command import PathPoint
from trimtab.laws.path_inversion import InputLimits, internal_rates, invert

INTERNAL_SIZES = (1e-2, 1e-2, 1.0, 10.0, 1.0, 10.0)
"""Sizes of (alpha, Q, eta1, eta1', eta2, eta2')."""
SOLVED = 1e-4
"""A node solves the internal dynamics when its rates are right to this part of the sizes, each second."""
LAST = 1e5
"""A time (s) by which every command has come to its end."""
STEPS = 8


def refuse_ends(craft: Any, command: Any, limits: InputLimits) -> None:
    """Refuse a command that begins or ends where the craft believed in has no level flight within its limits."""
    found, u, h, V = (np.asarray(a) for a in _ends(craft, command))
    for i, where in enumerate(("begins", "ends")):
        if not found[i]:
            problem = f"the command {where} at {h[i]:g} ft, {V[i]:g} ft/s: no angle of attack balances the moment there"
            raise InputError("command", problem, fix="choose h0, V0, dh and dV near 85000 ft, 7700 ft/s")
    where = [f"level flight at {a:g} ft, {b:g} ft/s" for a, b in zip(h, V, strict=True)]
    _refuse_beyond(limits, u, where)


def refuse_table(craft: Any, command: Any, table: InternalTable, limits: InputLimits) -> None:
    """Refuse a table of another command or vehicle, and a command that needs more than the inputs have."""
    t = table.first + table.spacing * np.arange(len(table.nodes))
    wrong, u = (np.asarray(a) for a in _along(craft, command, t, table.nodes, table.rates))
    if not wrong.max() < SOLVED:
        when = f"its rates are off by {wrong.max():.2g} of what counts, at {t[wrong.argmax()]:g} s"
        problem = f"the table was made for another command or vehicle: {when}"
        fix = "--set internal=preview, which needs no table, or fly a scenario made with that command"
        raise InputError("internal", problem, fix=fix)
    _refuse_beyond(limits, u, [f"the command at {x:g} s" for x in t])


def _refuse_beyond(limits: InputLimits, u: Any, where: list[str]) -> None:
    """u: fuel ratio and elevator (2, n), at places `where`."""
    low, high = (np.array([*pair]) for pair in limits.pairs())
    for value, least, most, what in zip(u, low, high, ("fuel ratio", "elevator (rad)"), strict=True):
        beyond = np.maximum(least - value, value - most)
        if beyond.max() > 0:
            at = int(beyond.argmax())
            problem = f"{where[at]} needs {what} {value[at]:.4g}, limits are {least:.4g} and {most:.4g}"
            raise InputError("command", problem, fix="make the climb smaller, or wh and wV lower")


@partial(jax.jit, compiler_options=QUICKLY)
def _ends(craft: Any, command: Any) -> Any:
    """Whether level flight was found at the command's begin and end (2,), its input (2, 2), h and V (2,)."""
    p: PathPoint = command.at(jnp.array([0.0, LAST]))
    still = jnp.zeros(2)
    level = PathPoint(p.h, still, still, still, p.V, still, still)
    zeta, found = quasi_static(craft, level, jnp.full(2, 0.03), STEPS)
    u = invert(craft, p.h, still, p.V, zeta[0], still, still).u
    return found, jnp.stack([u.Phi, u.delta_e]), p.h, p.V


@partial(jax.jit, compiler_options=QUICKLY)
def _along(craft: Any, command: Any, t: Any, nodes: Any, rates: Any) -> tuple[Any, Any]:
    """How far a table's rates (n, 6) are from the internal dynamics at its nodes, in parts of INTERNAL_SIZES (n,).

    And fuel ratio and elevator (rad) that the command needs there (2, n).
    """
    p: PathPoint = command.at(t)
    path = (p.h, p.h_rate, p.V)
    found = internal_rates(craft, *path, p.h_acceleration, p.V_rate, nodes.T)
    off = jnp.abs((jnp.stack(found, axis=1) - rates) / jnp.asarray(INTERNAL_SIZES)).max(axis=1)
    u = invert(craft, *path, nodes[:, 0], p.h_acceleration, p.V_rate).u
    return off, jnp.stack([u.Phi, u.delta_e])

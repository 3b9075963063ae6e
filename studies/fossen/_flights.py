"""Flights of REMUS with prescribed fin angles, as in the simulations of [1] chapter 8."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rotation import DEG, to_euler
from trimtab.vehicles.torpedo import CRUISE, Torpedo, TorpedoControls, TorpedoState

STEP = 0.02
SPEED, ROLL = 1.54, -5 * DEG
"""Speed (m/s) and roll (rad) at the start of each flight, [1] table 8.1."""


class Flight(NamedTuple):
    """Time history of a flight in s, m, rad, m/s and rad/s.

    The velocity is that of the centre of buoyancy, as in [1].
    """

    t: Any
    place: Any
    angles: Any
    velocity: Any
    rate: Any

    def at(self, t: float, values: Any) -> float:
        """Return `values`, a time series of the flight, interpolated at time t (s)."""
        return float(np.interp(t, self.t, values))


def fly_fins(torpedo: Torpedo, rudder: Any, stern: Any, seconds: float) -> Flight:
    """Fly from the initial state of [1]. rudder, stern: fin angle (rad) as a function of time (s), without delay."""
    attitude = np.array(quaternion.from_euler(jnp.asarray(ROLL), jnp.asarray(0.0), jnp.asarray(0.0)))
    x = to_arrays(TorpedoState(attitude=attitude, velocity=np.array([SPEED, 0, 0]), shaft_speed=CRUISE))
    times = STEP * np.arange(round(seconds / STEP) + 1)
    fins = jnp.asarray(np.stack([np.vectorize(rudder)(times), np.vectorize(stern)(times)], axis=1))

    rows = _scan(to_arrays(torpedo), x, fins)
    angles = np.array(jax.vmap(lambda q: to_euler(quaternion.to_matrix(q)))(rows.attitude))
    angles[:, 2] = np.unwrap(angles[:, 2])
    rate = np.array(rows.rate)
    velocity = np.array(rows.velocity) - np.cross(rate, [0, 0, float(torpedo.lowered)])
    return Flight(times, np.array(rows.position), angles, velocity, rate)


@jax.jit
def _scan(torpedo: Torpedo, x: TorpedoState, fins: Any) -> Any:
    """Return the state at each step. A torpedo with other parameters needs no new compilation."""

    def step(x: Any, fin: Any) -> Any:
        x = replace(x, rudder=fin[0], stern=fin[1])
        told = TorpedoControls(fin[0], fin[1], CRUISE)
        return torpedo.after_step(0.0, rk4(lambda t, x: torpedo.dynamics(t, x, told), 0.0, x, STEP)), x

    return jax.lax.scan(step, x, fins)[1]

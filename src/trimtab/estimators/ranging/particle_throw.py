"""The first particles: where two ranges meet, with any heading.

Source: docs page, Particle filter.
"""

from typing import Any

import jax
import numpy as np

from trimtab.core.float64 import jnp
from trimtab.core.rng import Key, uniform2
from trimtab.core.rotation import wrap
from trimtab.estimators.inertial.mechanisation import turned_lever
from trimtab.estimators.ranging.cone_compensation import compensate
from trimtab.estimators.ranging.multilateration import two_ranges
from trimtab.estimators.ranging.particle_cloud import Cloud
from trimtab.estimators.ranging.range_update import place_information

START = 1
"""First stream of the draws."""


def thrown(form: Any, key: Key, number: Any, ranges: Any, unit: Any) -> Cloud:
    """Particles from the first ranges (n,), of which two or more are above 0; number: tells throws apart."""
    N, n = form.N, np.shape(form.beacons)[0]
    g = form.geometry(unit)
    index = number * N + jnp.arange(N)
    spin, side = uniform2(key, index, START)
    lots = jnp.stack([uniform2(key, index * n + i, START + 8)[0] for i in range(n)], axis=1)
    heading = wrap(2 * np.pi * (jnp.arange(N) + spin) / N)
    plan, height = g.beacons[:, :2], g.down - g.beacons[:, 2]
    exact = compensate(jnp.where(ranges > 0, ranges, 1.0), height)[0] if form.cone else ranges
    s = form.start
    motion, width = s.motion_variances(), jnp.full(1, (2 * np.pi / N) ** 2)
    bias = jnp.reshape(s.sigma_gyro_bias**2, 1)
    variances = jnp.concatenate([width, motion[:4], bias, motion[4:], form.errors.variances(n)])

    def one(heading: Any, side: Any, lots: Any) -> tuple[Any, Any]:
        lots = jnp.where(ranges > 0, lots, 2.0)
        rank = jnp.sum(lots[None, :] < lots[:, None], axis=1)
        pair = (rank < 2) & (ranges > 0)
        i, j = jnp.argmax(pair), n - 1 - jnp.argmax(pair[::-1])
        line = plan[j] - plan[i]
        far = jnp.where(side < 0.5, -1.0, 1.0) * jnp.stack([-line[1], line[0]])
        place = two_ranges(plan, height, exact, pair, plan[i] + line / 2 + far).place
        arm, _ = turned_lever(heading, g.lever)
        W = place_information(place, pair, g, form.start_sigma) + jnp.eye(2) / s.sigma_position**2
        det = W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]
        own = jnp.stack([jnp.stack([W[1, 1], -W[0, 1]]), jnp.stack([-W[1, 0], W[0, 0]])]) / det
        x = jnp.concatenate([heading[None], s.velocity(), place - arm, jnp.zeros(4 + n)])
        return x, jnp.diag(variances).at[3:5, 3:5].set(own)

    x, P = jax.vmap(one)(heading, side, lots)
    return Cloud(x, P, jnp.full(N, 1.0 / N))

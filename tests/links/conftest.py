"""Drives a channel as the loop does, with samples whose values encode their measurement time."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.record import to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarState, Sample, new_sample
from trimtab.core.time import ms

LIKE = new_sample(0, PlanarState(0.0, 0.0, 0.0, 0.0), fresh=False)


def sent_at(t: Any, sensor_period: Any, first: Any = 0) -> Sample:
    """Sample at t of a sensor with this period, invalid before `first`. Its value is a function of its time."""
    at = t // sensor_period * sensor_period
    s = at * 1e-7
    value = PlanarState(s, 1 - 2 * s, s * s, 3 * s)
    return Sample(value=value, t=at, age=(t - at) * 1e-7, fresh=t == at, valid=t >= first)


@functools.partial(jax.jit, static_argnums=2)
def _run(channel: Any, key: Key, n: int, sensor_period: Any, first: Any) -> Any:
    def body(state: Any, t: Any) -> Any:
        state, out = channel.step(t, state, sent_at(t, sensor_period, first))
        return state, (t, out, state)

    return jax.lax.scan(body, channel.init(key, LIKE), jnp.arange(n) * channel.period)[1]


def drive(channel: Any, key: Key, n: int, sensor_period: int = ms(1), first: int = 0) -> tuple[Any, Sample, Any]:
    """Return the instants (n,), the output at each, and the channel's state after each."""
    return jax.tree.map(np.asarray, _run(to_arrays(channel), key, n, sensor_period, first))


@pytest.fixture(name="drive", scope="session")
def _drive() -> Any:
    return drive


@pytest.fixture(name="sent_at", scope="session")
def _sent_at() -> Any:
    return sent_at

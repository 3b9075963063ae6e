"""The ideal model: the hovercraft's equations closed with a law that reads the true state."""

from functools import partial

import jax
import jax.numpy as jnp
import pytest

from trimtab.core.integrate import rk4
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

MS = 10_000


def true_estimate(t, x):
    return Estimate(t=t, age=0.0, fresh=True, valid=True, state=x)


@partial(jax.jit, static_argnames=("steps", "every"))
def _sampled(law, starts, steps, every, h):
    plant = Hovercraft()

    def one(carry, _):
        t, x, state = carry
        state, output = law.step(t, state, true_estimate(t, x))
        x = rk4(lambda t, x: plant.dynamics(t, x, output.demand), 0.0, x, h)
        return (t + MS, x, state), output

    def block(carry, _):
        start = carry[1]
        carry, first = one(carry, None)
        carry, _ = jax.lax.scan(lambda c, _: (one(c, None)[0], None), carry, length=every - 1)
        return carry, (start, first)

    def run(x):
        return jax.lax.scan(block, (jnp.int64(0), x, law.init(key(0))), length=steps // every)[1]

    return jax.vmap(run)(starts)


@partial(jax.jit, static_argnames=("steps", "every"))
def _continuous(law, starts, steps, every, h):
    plant = Hovercraft()

    def rate(t, x):
        return plant.dynamics(t, x, law.step(0, (), true_estimate(0, x))[1].demand)

    def block(x, _):
        return jax.lax.fori_loop(0, every, lambda _, x: rk4(rate, 0.0, x, h), x), x

    def run(x):
        return jax.lax.scan(block, x, length=steps // every)[1]

    return jax.vmap(run)(starts)


@pytest.fixture(scope="session")
def sampled():
    """run(law, starts, duration, every=10): law sampled each 1 ms, demand held; (states, outputs) every `every` ms."""

    def run(law, starts, duration, every=10):
        return _sampled(law, starts, round(duration * 1000), every, 1e-3)

    return run


@pytest.fixture(scope="session")
def continuous():
    """run(law, starts, duration, h, every=1): memoryless law inside the derivative, RK4 steps of h s; states."""

    def run(law, starts, duration, h, every=1):
        return _continuous(law, starts, round(duration / h), every, h)

    return run


@pytest.fixture(scope="session")
def starts():
    """make(u, v, r, heading=0): states from arrays that are stretched to one length."""

    def make(u, v, r, heading=0.0):
        n = max(jnp.size(a) for a in (u, v, r, heading))
        u, v, r, heading = (jnp.broadcast_to(jnp.asarray(a, float), (n,)) for a in (u, v, r, heading))
        zero = jnp.zeros(n)
        return HovercraftState(u, v, r, zero, zero, heading)

    return make

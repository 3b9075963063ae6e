"""The ideal model: the hovercraft's equations closed with a law that reads the true state.

The closed loop is compiled as a C block, with the law's parameters as its own: C compiles faster than XLA.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import compile_block
from trimtab.core.integrate import rk4
from trimtab.core.rng import key
from trimtab.core.signals import Estimate
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

MS = 10_000
ROWS = 500
"""That a call of the compiled block gives: so many that copying them is a loop; a few for short tables."""
PLANT = Hovercraft()


def true_estimate(t, x):
    return Estimate(t=t, age=0.0, fresh=True, valid=True, state=x)


def sample(law, carry, every, h):
    """Step the law each h s with held demand; return the carry after `every` steps and the first output."""

    def tick(_, carry):
        t, x, state = carry
        state, output = law.step(t, state, true_estimate(t, x))
        x = rk4(lambda t, x: PLANT.dynamics(t, x, output.demand), 0.0, x, h)
        return t + MS, x, state

    t, x, state = carry
    return jax.lax.fori_loop(0, every, tick, carry), law.step(t, state, true_estimate(t, x))[1]


def integrate(law, carry, every, h):
    """Integrate with a memoryless law inside the derivative."""

    def rate(t, x):
        return PLANT.dynamics(t, x, law.step(0, (), true_estimate(0, x))[1].demand)

    t, x, state = carry
    return (t, jax.lax.fori_loop(0, every, lambda _, x: rk4(rate, 0.0, x, h), x), state), ()


@functools.cache
def compiled(advance, structure, every, h, rows):
    """Return a block that gives the next rows, and their structure: (state, output)."""
    law = jax.tree.unflatten(structure, [0.0] * structure.num_leaves)
    x = HovercraftState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def init(law):
        return jnp.int64(0), x, law.init(key(0))

    def step(law, carry, given):
        start, first = given
        t, _, state = init(law)
        carry = jax.tree.map(lambda a, b: jnp.where(first, a, b), (t, start, state), carry)

        def row(carry, _):
            after, output = advance(law, carry, every, h)
            return after, (carry[1], output)

        return jax.lax.scan(row, carry, length=rows)

    block = compile_block(BlockDefinition("ideal", "The ideal model.", step, init, law, (x, False)))
    return block, jax.eval_shape(lambda law: step(law, init(law), (x, False))[1], law)


def fly(advance, law, starts, steps, every, h):
    """Return states and outputs; each leaf is (starts, rows)."""
    numbers, structure = jax.tree.flatten(law)
    count = steps // every
    size = ROWS if count % ROWS == 0 else 10
    block, rows = compiled(advance, structure, every, h, size)
    for parameter, number in zip(block.parameters.values(), numbers, strict=True):
        parameter[...] = number
    table = np.zeros((len(starts.heading), count // size, len(block.outputs)))
    for run, x in zip(table, np.stack(jax.tree.leaves(starts), axis=1), strict=True):
        for k in range(len(run)):
            block.inputs[:] = *x, k == 0
            block.step()
            run[k] = block.outputs
    shape = len(table), count
    columns = zip(block.writes.values(), jax.tree.leaves(rows), strict=True)
    leaves = [table[:, :, where].reshape(shape + v.shape[1:]).astype(v.dtype) for where, v in columns]
    return jax.tree.structure(rows).unflatten(leaves)


@pytest.fixture(scope="session")
def sampled():
    """run(law, starts, duration, every=10): law sampled each 1 ms, demand held; (states, outputs) every `every` ms."""

    def run(law, starts, duration, every=10):
        return fly(sample, law, starts, round(duration * 1000), every, 1e-3)

    return run


@pytest.fixture(scope="session")
def continuous():
    """run(law, starts, duration, h, every=1): memoryless law inside the derivative, RK4 steps of h s; states."""

    def run(law, starts, duration, h, every=1):
        return fly(integrate, law, starts, round(duration / h), every, h)[0]

    return run


@pytest.fixture(scope="session")
def starts():
    """make(u, v, r, heading=0): states from arrays broadcast to one length."""

    def make(u, v, r, heading=0.0):
        n = max(np.size(a) for a in (u, v, r, heading))
        u, v, r, heading = (np.broadcast_to(np.asarray(a, float), (n,)) for a in (u, v, r, heading))
        zero = np.zeros(n)
        return HovercraftState(u, v, r, zero, zero, heading)

    return make

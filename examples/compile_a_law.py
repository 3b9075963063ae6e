"""Compile any JAX function to C: calls in under a microsecond, lanes, its gradient, and C for a board.

trimtab export examples/compile_a_law.py:thrust --out thrust
"""

import tempfile

import jax
import jax.numpy as jnp
import numpy as np

import trimtab


def thrust(state, gains):
    """Return thrust (N) and torque (N m) that bring a boat to rest. state: velocity forward (m/s), yaw rate (rad/s)."""
    wish = -gains["k"] * state
    return {"force": 2.0 * jnp.tanh(wish[0] / 2.0), "torque": 0.3 * jnp.tanh(wish[1] / 0.3)}


example = (np.array([0.4, 0.1]), {"k": np.array([3.0, 0.5])})
"""Arguments of `thrust` for `trimtab export`: shapes and types matter; the numbers are test data."""


def main() -> None:
    """Compile, call, differentiate, evaluate many, export."""
    law = trimtab.compile(thrust, *example)
    state, gains = example
    print("one:", law(state, gains))

    states = np.random.default_rng(0).normal(size=(1000, 2))
    many = law.lanes(states, gains)  # the gains have no run axis: all runs share them
    print("many:", many["force"].shape, "the same bits:", many["force"][7] == law(states[7], gains)["force"])

    def effort(gains, state):
        return sum(jnp.square(x) for x in thrust(state, gains).values())

    slope = trimtab.compile(jax.grad(effort), gains, state)
    print("slope:", slope(gains, state)["k"])

    with tempfile.TemporaryDirectory() as folder:
        print("written:", ", ".join(sorted(f.name for f in law.export(folder))))
    try:
        law(state[:1], gains)
    except trimtab.InputError as refusal:
        print("refused:", refusal)


if __name__ == "__main__":
    main()

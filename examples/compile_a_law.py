"""Any JAX function in C: called in under a microsecond, in lanes, with its gradient, and written for a board.

trimtab export examples/compile_a_law.py:thrust --out thrust
"""

import tempfile

import jax
import jax.numpy as jnp
import numpy as np

import trimtab


def thrust(state, gains):
    """Thrust (N) and torque (N m) that bring a boat to rest. state: velocity forward (m/s), yaw rate (rad/s)."""
    wish = -gains["k"] * state
    return {"force": 2.0 * jnp.tanh(wish[0] / 2.0), "torque": 0.3 * jnp.tanh(wish[1] / 0.3)}


example = (np.array([0.4, 0.1]), {"k": np.array([3.0, 0.5])})
"""Arguments of `thrust`, for `trimtab export`: shapes and types count; the numbers are its test."""


def main() -> None:
    """Compile, call, differentiate, fly many, write."""
    law = trimtab.compile(thrust, *example)
    state, gains = example
    print("one:", law(state, gains))

    states = np.random.default_rng(0).normal(size=(1000, 2))
    many = law.lanes(states, gains)  # the gains have no axis of runs: they are the same for all
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

"""Functions of blackjax: kernels of Markov chains and of particle filters, as whole transitions."""

from typing import Any

import blackjax
import jax
import jax.numpy as jnp
import numpy as np

from compiler.foreign.case import Case


def _log_density(x: Any) -> Any:
    """A banana in two of four dimensions."""
    return -0.5 * (x[0] ** 2 + (x[1] - x[0] ** 2) ** 2 / 0.25 + jnp.sum(x[2:] ** 2))


def _transition(algorithm: Any) -> Any:
    """Start, and one transition with this key."""

    def step(seed: Any, x: Any) -> Any:
        state, info = algorithm.step(jax.random.key(seed), algorithm.init(x))
        return state.position, state.logdensity, getattr(info, "acceptance_rate", 0.0)

    return step


def _chain(algorithm: Any, steps: int) -> Any:
    def run(seed: Any, x: Any) -> Any:
        keys = jax.random.split(jax.random.key(seed), steps)

        def step(state: Any, key: Any) -> Any:
            state, _ = algorithm.step(key, state)
            return state, state.position

        return jax.lax.scan(step, algorithm.init(x), keys)[1]

    return run


def _seed_and_place(rng: np.random.Generator) -> tuple[Any, ...]:
    return np.uint32(rng.integers(1 << 30)), rng.normal(size=4)


def _weights(rng: np.random.Generator) -> tuple[Any, ...]:
    w = rng.uniform(size=64)
    return np.uint32(rng.integers(1 << 30)), w / w.sum()


def _resample(kind: Any) -> Any:
    return lambda seed, weights: kind(jax.random.key(seed), weights, 64)


MASS = np.ones(4)
CASES = [
    Case(
        "random walk Metropolis, 50 steps",
        _chain(
            blackjax.additive_step_random_walk(_log_density, blackjax.mcmc.random_walk.normal(0.5 * jnp.eye(4))), 50
        ),
        _seed_and_place,
    ),
    Case("HMC, one step", _transition(blackjax.hmc(_log_density, 0.1, MASS, 10)), _seed_and_place),
    Case("HMC, 20 steps", _chain(blackjax.hmc(_log_density, 0.1, MASS, 10), 20), _seed_and_place),
    Case("NUTS, one step", _transition(blackjax.nuts(_log_density, 0.2, MASS)), _seed_and_place),
    Case("MALA, one step", _transition(blackjax.mala(_log_density, 0.05)), _seed_and_place),
    Case(
        "elliptical slice sampler",
        _transition(blackjax.elliptical_slice(_log_density, mean=jnp.zeros(4), cov=jnp.eye(4))),
        _seed_and_place,
    ),
    Case("Barker proposal", _transition(blackjax.barker_proposal(_log_density, 0.1)), _seed_and_place),
    Case("systematic resampling", _resample(blackjax.smc.resampling.systematic), _weights),
    Case("residual resampling", _resample(blackjax.smc.resampling.residual), _weights),
]

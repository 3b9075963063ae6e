"""Functions of equinox: networks, with their weights as constants or as arguments."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from compiler.foreign.case import Case, normal

KEY = jax.random.key(0)
POLICY = eqx.nn.MLP(12, 4, 64, 2, activation=jnp.tanh, key=KEY)
SMALL = eqx.nn.MLP(3, 1, 8, 2, key=KEY)
CELL = eqx.nn.GRUCell(4, 16, key=KEY)
LSTM = eqx.nn.LSTMCell(4, 8, key=KEY)
ATTENTION = eqx.nn.MultiheadAttention(2, 16, key=KEY)
NORM = eqx.nn.LayerNorm(16)
CONVOLUTIONS = eqx.nn.Sequential(
    [
        eqx.nn.Conv2d(1, 4, 3, key=KEY),
        eqx.nn.Lambda(jax.nn.relu),
        eqx.nn.MaxPool2d(2, 2),
        eqx.nn.Lambda(jnp.ravel),
        eqx.nn.Linear(4 * 7 * 7, 5, key=KEY),
    ]
)
SIGNAL = eqx.nn.Conv1d(2, 3, 5, stride=2, padding=2, key=KEY)


def _weights(network: Any) -> Any:
    """The arrays of a network, which are arguments of what is compiled, and the rest of it."""
    return eqx.partition(network, eqx.is_array)


ARRAYS, REST = _weights(SMALL)


def _loss(arrays: Any, x: Any, y: Any) -> Any:
    network = eqx.combine(arrays, REST)
    return jnp.mean((jax.vmap(network)(x)[:, 0] - y) ** 2)


def _train(arrays: Any, x: Any, y: Any) -> Any:
    """One step of gradient descent on 16 examples."""
    return jax.tree.map(lambda w, g: w - 0.05 * g, arrays, jax.grad(_loss)(arrays, x, y))


def _batch(rng: np.random.Generator) -> tuple[Any, ...]:
    arrays = jax.tree.map(lambda w: np.asarray(w) + 0.1 * rng.normal(size=w.shape), ARRAYS)
    return arrays, rng.normal(size=(16, 3)), rng.normal(size=16)


def _recurrent(xs: Any) -> Any:
    def step(h: Any, x: Any) -> Any:
        h = CELL(x, h)
        return h, h[:2]

    return jax.lax.scan(step, jnp.zeros(16), xs)


CASES = [
    Case("MLP 12-64-64-4", POLICY, normal((12,))),
    Case("Jacobian of an MLP", jax.jacrev(SMALL), normal((3,))),
    Case("MLP, batch of 32", jax.vmap(SMALL), normal((32, 3))),
    Case("loss and gradient", jax.value_and_grad(_loss), _batch),
    Case("training step", _train, _batch),
    Case("GRU cell over 20 samples", _recurrent, normal((20, 4))),
    Case("LSTM cell", lambda x, h, c: LSTM(x, (h, c)), normal((4,), (8,), (8,))),
    Case("attention over 6 tokens", lambda x: ATTENTION(jax.vmap(NORM)(x), x, x), normal((6, 16))),
    Case("convolutional network, 16 by 16", CONVOLUTIONS, normal((1, 16, 16))),
    Case("strided convolution of a signal", SIGNAL, normal((2, 40))),
]

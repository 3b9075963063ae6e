"""Train the small neural policy that flies quadrotor/track: it imitates the geometric law over states drawn at random.

python examples/neural_policy/train_policy.py --out policy.json    minutes on two cores; the same numbers each time
trimtab run quadrotor/track --set law=neural --set autopilot.law.policy=policy.json
"""

import argparse
import functools
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.spatial_reference import SpatialPoint
from trimtab.laws.geometric_tracking import GeometricTracking, command_attitude, heading_vector
from trimtab.laws.neural_policy import INPUTS, OUTPUTS, Network, evaluate, observe
from trimtab.scenarios.quadrotor.track import CRAFT
from trimtab.vehicles.quadrotor import MultirotorState

SCALE = np.repeat([0.8, 2.0, 4.0, 1.6, 1.0, 8.0], 3)
"""Of errors of position (m) and velocity (m/s), rate (rad/s), vertical (g), heading, jerk (m/s^3)."""
TILT = 1.2
"""Largest error of attitude that is shown, about each axis (rad)."""
ACCELERATION = 5.0
WEIGHT = float(CRAFT.mass * CRAFT.gravity)
CENTRE, SPAN = np.array([WEIGHT, 0, 0, 0]), np.array([1.2 * WEIGHT, 14.0, 14.0, 8.0])
FINEST = -1.7
"""Exponent of ten of the smallest drawn error, as a fraction of the scale. The largest drawn error is the scale."""
SOFT = 0.02
"""Output, in spans, below which the absolute error counts. Above it, the error relative to the output counts."""
TEACHER = GeometricTracking(craft=CRAFT)


def draw_pair(key: Any) -> tuple[Any, Any]:
    """Return the observation at a random state (18,), and the demand of the teacher there, in spans (4,)."""
    keys = iter(jax.random.split(key, 12))

    def draw(size: float) -> Any:
        power = jax.random.uniform(next(keys), minval=FINEST, maxval=0.0)
        return size * 10**power * jax.random.uniform(next(keys), (3,), minval=-1.0, maxval=1.0)

    zero = jnp.zeros(3)
    wanted = SpatialPoint(zero, zero, draw(ACCELERATION), draw(SCALE[-1]), zero, zero[0], zero[0], zero[0])
    x = MultirotorState(draw(SCALE[0]), draw(SCALE[3]), jnp.array(quaternion.IDENTITY), draw(SCALE[6]))
    command = command_attitude(TEACHER.command_force(wanted, x, jnp.eye(3)), heading_vector(wanted))
    x = MultirotorState(
        x.position, x.velocity, quaternion.retract(quaternion.from_matrix(command.R), draw(TILT)), x.rate
    )
    demand = TEACHER.track(wanted, x).demand
    y = (jnp.concatenate([demand.thrust[None], demand.moment]) - CENTRE) / SPAN
    return observe(wanted, x, CRAFT.gravity), jnp.clip(y, -1, 1)


def first_layers(key: Any, widths: list[int]) -> list[tuple[Any, Any]]:
    """Return the initial layers: random weights by Glorot's rule, and zero bias."""
    sizes = list(zip([INPUTS, *widths], [*widths, OUTPUTS], strict=True))
    return [
        (jax.random.normal(k, (n, m)) * np.sqrt(2 / (n + m)), jnp.zeros(n))
        for k, (m, n) in zip(jax.random.split(key, len(sizes)), sizes, strict=True)
    ]


def cost(layers: Any, seen: Any, wanted: Any) -> Any:
    """Return the mean squared error of a batch, relative to the wanted outputs."""
    network = Network(SCALE, layers, np.zeros(OUTPUTS), np.ones(OUTPUTS))
    error = jax.vmap(functools.partial(evaluate, network))(seen) - wanted
    return jnp.mean(error**2 / (SOFT**2 + wanted**2))


@functools.partial(jax.jit, static_argnames=("steps", "batch"))
def train(layers: Any, key: Any, *, steps: int, batch: int, rate: float) -> tuple[Any, Any]:
    """Train by Adam with a learning rate that decreases along a cosine. Return the layers and the cost of each step."""

    def step(carried: Any, k: Any) -> tuple[Any, Any]:
        layers, mean, square = carried
        pairs = jax.vmap(draw_pair)(jax.random.split(jax.random.fold_in(key, k), batch))
        value, gradient = jax.value_and_grad(cost)(layers, *pairs)
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, mean, gradient)
        square = jax.tree.map(lambda s, g: 0.999 * s + 0.001 * g * g, square, gradient)
        now = rate * (0.5 + 0.5 * jnp.cos(jnp.pi * k / steps)) * jnp.sqrt(1 - 0.999 ** (k + 1)) / (1 - 0.9 ** (k + 1))
        layers = jax.tree.map(lambda x, m, s: x - now * m / (jnp.sqrt(s) + 1e-8), layers, mean, square)
        return (layers, mean, square), value

    nothing = jax.tree.map(jnp.zeros_like, layers)
    (layers, _, _), costs = jax.lax.scan(step, (layers, nothing, nothing), jnp.arange(steps))
    return layers, costs


def main() -> None:
    """Train the network, print its errors at states that were not used for training, and write the file."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", required=True, help="JSON file for the scales, weights and biases of the network")
    words.add_argument("--steps", type=int, default=40_000, help="number of training steps")
    words.add_argument("--batch", type=int, default=1024, help="number of states in each training step")
    words.add_argument("--width", type=int, nargs="+", default=[32, 32], help="number of neurons in each hidden layer")
    words.add_argument("--seed", type=int, default=0, help="seed of the random numbers")
    told = words.parse_args()
    first, during, after = jax.random.split(jax.random.key(told.seed), 3)
    layers, costs = train(first_layers(first, told.width), during, steps=told.steps, batch=told.batch, rate=4e-3)
    layers = jax.tree.map(lambda x: np.array([float(f"{v:.6g}") for v in np.ravel(x)]).reshape(x.shape), layers)
    seen, wanted = jax.vmap(draw_pair)(jax.random.split(after, 20_000))
    network = Network(SCALE, layers, np.zeros(OUTPUTS), np.ones(OUTPUTS))
    error = np.asarray(jax.vmap(functools.partial(evaluate, network))(seen) - wanted) * SPAN
    rms = np.sqrt(np.mean(error**2, axis=0))
    names = ("thrust (N)", "roll", "pitch", "yaw moment (N m)")
    said = ", ".join(f"{name} {value:.3f}" for name, value in zip(names, rms, strict=True))
    print(f"cost {np.mean(costs[-200:]):.4f}; rms errors at 20 000 new states: {said}")
    content = {
        "about": "python examples/neural_policy/train_policy.py "
        f"--steps {told.steps} --batch {told.batch} --seed {told.seed}",
        "scale": SCALE.tolist(),
        "centre": CENTRE.tolist(),
        "span": SPAN.tolist(),
        "layers": [{"weights": np.asarray(W).tolist(), "bias": np.asarray(b).tolist()} for W, b in layers],
    }
    with open(told.out, "w", encoding="utf-8") as file:
        json.dump(content, file, indent=None)
        file.write("\n")


if __name__ == "__main__":
    main()

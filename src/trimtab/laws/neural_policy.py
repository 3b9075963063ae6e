"""Small neural network as the tracking law of a multirotor. The weights are read from a file.

    y = W3 tanh(W2 tanh(W1 x + b1) + b2) + b3        any number of layers

The training program is `examples/neural_policy/train_policy.py`. Source: the tanh perceptron of Rumelhart, Hinton,
Williams, "Learning representations by back-propagating errors", Nature 323 (1986); a network of this size that flies a
quadrotor: Hwangbo, Sa, Siegwart, Hutter, "Control of a quadrotor with reinforcement learning", IEEE RA-L 2 (2017), two
layers of 64.
"""

import functools
import json
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from trimtab.core import quaternion
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.core.rng import Key
from trimtab.core.signals import Estimate
from trimtab.core.spatial_reference import FixedPlace, SpatialPoint
from trimtab.core.user_file import read_user_text
from trimtab.laws.geometric_tracking import flyable_state
from trimtab.vehicles.quadrotor import Multirotor, RotorDemand

SUFFIX = ".json"
INPUTS, OUTPUTS = 18, 4
STANDARD_GRAVITY = 9.80665
"""Standard gravity (m/s^2), the unit of the network's input for the apparent vertical."""


class Network(NamedTuple):
    """Weights and scales of a policy.

    scale: divisors (18,) of the inputs. The quotients are clipped to -1 to 1.  layers: weights (n, m) and bias (n,) of
    each layer.  centre, span: centre and half width (4,) of the range of thrust (N) and moments (N m): an output of -1
    to 1 is mapped to centre - span to centre + span.
    """

    scale: Any
    layers: tuple[tuple[Any, Any], ...]
    centre: Any
    span: Any


@functools.cache
def read_network(name: str) -> Network:
    """Return the network read from a weight file. A name without the suffix .json is a network of the package."""
    file = Path(name) if name.endswith(SUFFIX) else Path(__file__).with_name(f"policy_{name}{SUFFIX}")
    try:
        told = json.loads(read_user_text(file))
        layers = tuple((np.array(x["weights"], float), np.array(x["bias"], float)) for x in told["layers"])
        network = Network(
            np.array(told["scale"], float), layers, *(np.array(told[n], float) for n in ("centre", "span"))
        )
    except OSError as error:
        own = [f.stem.removeprefix("policy_") for f in Path(__file__).parent.glob(f"policy_*{SUFFIX}")]
        problem = f"weight file '{name}' cannot be read ({error.strerror})"
        raise InputError(
            "policy", problem, choices=own, fix="python examples/neural_policy/train_policy.py --out mine.json"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        problem = f"the file '{name}' does not contain weights: {error}"
        raise InputError(
            "policy", problem, fix="python examples/neural_policy/train_policy.py --out mine.json"
        ) from None
    _check_network(name, network)
    return network


def _check_network(name: str, network: Network) -> None:
    """Raise InputError if the weights do not match each other or the law's inputs and outputs."""
    width, problem = INPUTS, ""
    for weights, bias in network.layers:
        if weights.ndim != 2 or weights.shape[1] != width or bias.shape != weights.shape[:1]:
            problem = f"weights of shape {weights.shape} and bias of shape {bias.shape} do not match {width} inputs"
            break
        width = len(bias)
    if not problem and (
        width != OUTPUTS or any(len(x) != OUTPUTS for x in network[2:]) or len(network.scale) != INPUTS
    ):
        problem = f"the network must have {INPUTS} inputs and {OUTPUTS} outputs, got {len(network.scale)} and {width}"
    numbers = np.concatenate([np.ravel(x) for x in (network.scale, *sum(network.layers, ()), *network[2:])])
    if not problem and not (np.isfinite(numbers).all() and (network.scale > 0).all()):
        problem = "all weights must be finite, and all scales above 0"
    if problem:
        raise InputError(
            "policy", f"'{name}': {problem}", fix="python examples/neural_policy/train_policy.py --out mine.json"
        )


def observe(wanted: SpatialPoint, x: Any, gravity: Any) -> Any:
    """Return the inputs of the network (18,), all in B, so that they do not depend on position or compass direction.

    The inputs are: position error (m), velocity error (m/s), angular rate (rad/s), apparent vertical under the
    reference acceleration (g), direction of the reference heading, and reference jerk (m/s^3).
    """
    R_BW = quaternion.to_matrix(x.attitude).T
    heading = jnp.stack([jnp.cos(wanted.heading), jnp.sin(wanted.heading), jnp.zeros_like(wanted.heading)])
    vertical = (gravity * jnp.array([0.0, 0.0, 1.0]) - wanted.acceleration) / STANDARD_GRAVITY
    return jnp.concatenate(
        [
            R_BW @ (x.position - wanted.place),
            R_BW @ (x.velocity - wanted.velocity),
            x.rate,
            R_BW @ vertical,
            R_BW @ heading,
            R_BW @ wanted.jerk,
        ]
    )


def evaluate(network: Network, seen: Any) -> Any:
    """Return thrust (N) and moments (N m) (4,) for the inputs (18,), limited to the network's output range."""
    h = jnp.clip(seen / network.scale, -1, 1)
    for weights, bias in network.layers[:-1]:
        h = jnp.tanh(jnp.asarray(weights) @ h + bias)
    weights, bias = network.layers[-1]
    return network.centre + network.span * jnp.clip(jnp.asarray(weights) @ h + bias, -1, 1)


@record
class NeuralPolicyOutput:
    """Demand, tracking errors, and largest scaled input of the network. Source: this module."""

    demand: RotorDemand = part("Demanded thrust and moments of the rotors.")
    position_error: Any = quantity("m", "Position error: position minus reference.", frame="W", shape=(3,))
    velocity_error: Any = quantity("m/s", "Velocity error: velocity minus reference.", frame="W", shape=(3,))
    distance: Scalar = quantity("m", "Length of the position error.")
    stretch: Scalar = quantity(
        "1", "Largest input of the network, divided by its training range. Inputs above 1 are clipped to 1."
    )


@record
class NeuralPolicyState:
    """State of the policy: time since its start. Source: this module."""

    time: Scalar = quantity("s", "Time since the law started.", default=0.0)


@record
class NeuralPolicy:
    """Law that computes thrust and moments by a trained network, from the inputs of `observe`.

    The network has no state. The network is not trained for another mass or inertia, a reference that changes its
    heading, or wind. Inputs beyond the training range are clipped (signal `stretch`), and so are outputs beyond their
    range. Stability is not proved.

    Frames:  W north-east-down, B body.
    Valid:   the craft for which the network was trained, inputs within `scale`, and a reference with constant heading.
    Source:  this project; trained by examples/neural_policy/train_policy.py to imitate laws/geometric_tracking.py.
    """

    craft: Multirotor = part("Vehicle model used by the law: gravity and the number of rotors.", default=Multirotor())
    reference: Any = part("Reference position in space, as a function of time.", default=FixedPlace())
    policy: str = option(
        "Weights of the network: the name of a network in the package, or the path of a .json file.",
        default="quadrotor",
    )

    reads: ClassVar[tuple[str, ...]] = ("position", "velocity", "attitude", "rate")

    def check(self) -> None:
        """Raise InputError if the file contains no weights, or weights of wrong sizes."""
        read_network(self.policy)

    def init(self, key: Key) -> NeuralPolicyState:
        """Return the initial state, at time zero."""
        return NeuralPolicyState()

    def step(
        self, t: Any, state: NeuralPolicyState, estimate: Estimate
    ) -> tuple[NeuralPolicyState, NeuralPolicyOutput]:
        """Return the demand at time t (unit: 100 ns)."""
        output = self.track(self.reference.at(state.time), flyable_state(estimate))
        return NeuralPolicyState(state.time + estimate.dt), output

    def track(self, wanted: SpatialPoint, x: Any) -> NeuralPolicyOutput:
        """Return the demand for a state x with the fields that the law reads, and for a reference point."""
        network = read_network(self.policy)
        seen = observe(wanted, x, self.craft.gravity)
        y = evaluate(network, seen)
        error = x.position - wanted.place
        return NeuralPolicyOutput(
            demand=RotorDemand(y[0], y[1:], jnp.ones(jnp.shape(self.craft.rotors.spins), bool)),
            position_error=error,
            velocity_error=x.velocity - wanted.velocity,
            distance=jnp.sqrt(error @ error + 1e-24),
            stretch=jnp.max(jnp.abs(seen) / network.scale),
        )

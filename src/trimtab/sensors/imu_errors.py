"""The errors of a triad of an inertial unit, three accelerometers or three gyros: what stands between h(x) and output.

    z = quantised( clip( (I + S + M) L(h) + b + w ) ),   b = b0 + b_turn_on + walk

S scale factors (diagonal), M misalignments (off the diagonal), L the low-pass of the band, w white noise. The noise
stands behind the low-pass: its density is that of the output.
"""

from typing import Any

import numpy as np

from trimtab.core.float64 import jax, jnp
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.second_order import SectionState, at_rest, filtered, low_pass

UNIT_DRAWS = 12
"""Standard normals that a triad keeps for a run: 3 turn-on biases, 3 scale factors, 6 misalignments."""
OFF_DIAGONAL = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
SOURCE = "IEEE Std 952-1997, annex C"


@record
class AccelerometerErrors:
    """Errors of three accelerometers; zero switches one off. Frames: the unit's own axes. Source: IEEE Std 952-1997."""

    noise: Scalar = quantity("m/s^2/Hz^0.5", "White noise: velocity random walk N.", default=0.0, low=0, source=SOURCE)
    bias: Any = quantity("m/s^2", "Constant bias, the same in every run.", default=(0.0, 0.0, 0.0), shape=(3,))
    turn_on_bias: Scalar = quantity("m/s^2", "Standard deviation, drawn for each run.", default=0.0, low=0)
    bias_walk: Scalar = quantity("m/s^2/s^0.5", "Random walk of the bias, K.", default=0.0, low=0, source=SOURCE)
    scale_factor: Scalar = quantity("1", "Standard deviation of each axis, drawn for each run.", default=0.0, low=0)
    misalignment: Scalar = quantity("rad", "Standard deviation of an axis towards another.", default=0.0, low=0)
    bandwidth: Scalar = quantity("Hz", "-3 dB of a second-order Butterworth; 0: no limit.", default=0.0, low=0)
    resolution: Scalar = quantity("m/s^2", "Step of the converter; 0: none.", default=0.0, low=0)
    range: Scalar = quantity("m/s^2", "Greatest output; 0: no limit.", default=0.0, low=0)
    response: Any = part("Dynamics in place of the low-pass, with start(u) and respond(state, u).", default=None)


@record
class GyroErrors:
    """Errors of three gyros; zero switches one off. Frames: the unit's own axes. Source: IEEE Std 952-1997."""

    noise: Scalar = quantity("rad/s/Hz^0.5", "White noise: angle random walk N.", default=0.0, low=0, source=SOURCE)
    bias: Any = quantity("rad/s", "Constant bias, the same in every run.", default=(0.0, 0.0, 0.0), shape=(3,))
    turn_on_bias: Scalar = quantity("rad/s", "Standard deviation, drawn for each run.", default=0.0, low=0)
    bias_walk: Scalar = quantity("rad/s/s^0.5", "Rate random walk K of the bias.", default=0.0, low=0, source=SOURCE)
    scale_factor: Scalar = quantity("1", "Standard deviation of each axis, drawn for each run.", default=0.0, low=0)
    misalignment: Scalar = quantity("rad", "Standard deviation of an axis towards another.", default=0.0, low=0)
    bandwidth: Scalar = quantity("Hz", "-3 dB of a second-order Butterworth; 0: no limit.", default=0.0, low=0)
    resolution: Scalar = quantity("rad/s", "Step of the converter; 0: none.", default=0.0, low=0)
    range: Scalar = quantity("rad/s", "Greatest output; 0: no limit.", default=0.0, low=0)
    response: Any = part("Dynamics in place of the low-pass, with start(u) and respond(state, u).", default=None)


Errors = AccelerometerErrors | GyroErrors


@record
class TriadState:
    """What a triad remembers. Frames: the unit's own axes. Source: this module."""

    draws: Any = quantity("1", "Standard normals of this run.", shape=(UNIT_DRAWS,))
    walk: Any = quantity("1", "In-run change of the bias, in the unit of the output.", shape=(3,))
    started: Scalar = quantity("1", "Whether the low-pass has seen a sample.", kind="flag")
    memory: Any = part("Memory of the low-pass, or of the response in its place.")


def triad_state(errors: Errors, draws: Any) -> TriadState:
    """The first state, out of standard normals (12,)."""
    zero = jnp.zeros(3)
    memory = SectionState(zero, zero) if errors.response is None else errors.response.start(zero)
    return TriadState(draws=draws, walk=zero, started=jnp.asarray(False), memory=memory)


def distortion(errors: Errors, draws: Any) -> Any:
    """I + S + M (3, 3) of this run."""
    rows = [[1.0 + errors.scale_factor * draws[3 + i] if i == j else 0.0 for j in range(3)] for i in range(3)]
    for k, (i, j) in enumerate(OFF_DIAGONAL):
        rows[i][j] = errors.misalignment * draws[6 + k]
    return jnp.stack([jnp.stack(row) for row in rows])


def corrupted(errors: Errors, state: TriadState, true: Any, dt: float, white: Any, step: Any) -> tuple[Any, Any, Any]:
    """The triad's output for a true input (3,): next state, output (3,), whether an axis is saturated.

    Args:
        errors: of the triad.
        state: its state.
        true: noise-free input along the unit's axes.
        dt: time between samples (s).
        white: standard normals (3,) of this sample's noise.
        step: standard normals (3,) of the bias's step to the next sample.
    """
    memory, passed = _banded(errors, state, true, dt)
    bias = jnp.stack([errors.bias[i] + errors.turn_on_bias * state.draws[i] + state.walk[i] for i in range(3)])
    noisy = distortion(errors, state.draws) @ passed + bias + errors.noise / np.sqrt(dt) * white
    limited = errors.range > 0
    saturated = limited & (jnp.max(jnp.abs(noisy)) >= errors.range)
    clipped = jnp.where(limited, jnp.clip(noisy, -errors.range, errors.range), noisy)
    coarse = errors.resolution > 0
    grain = jnp.where(coarse, errors.resolution, 1.0)
    out = jnp.where(coarse, grain * jnp.floor(clipped / grain + 0.5), clipped)
    walk = state.walk + errors.bias_walk * np.sqrt(dt) * step
    return TriadState(draws=state.draws, walk=walk, started=jnp.asarray(True), memory=memory), out, saturated


def _banded(errors: Errors, state: TriadState, true: Any, dt: float) -> tuple[Any, Any]:
    """Memory and output of the low-pass or the response; its first sample finds it settled."""
    if errors.response is not None:
        rest = errors.response.start(true)
        memory = _either(state.started, state.memory, rest)
        return errors.response.respond(memory, true)
    narrow = errors.bandwidth > 0
    section = low_pass(jnp.where(narrow, errors.bandwidth, 0.1 / dt), np.sqrt(0.5), dt)
    memory, passed = filtered(section, _either(state.started, state.memory, at_rest(section, true)), true)
    return memory, jnp.where(narrow, passed, true)


def _either(condition: Any, a: Any, b: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)

"""Ranges from a vehicle's antenna to anchors at known positions, as measured by ultra-wideband radios."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals, split, uniform2
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms

ZERO = (0.0, 0.0, 0.0)
HALL = ((0.0, 0.0, -3.0), (8.0, 0.0, -0.3), (8.0, 6.0, -3.0), (0.0, 6.0, -0.3), (4.0, 3.0, -4.0), (4.0, 0.0, -1.5))
"""Default positions of the anchors: six around a hall of 8 by 6 m, at different heights."""


@record
class AnchorRanges:
    """Sample of the ranging radio: a range to each anchor. Source: docs page, Sensors for three dimensions."""

    range: Any = quantity(
        "m", "Range to each anchor (n,). For an anchor that was not received, the last received range."
    )
    received: Any = quantity("1", "True for each anchor that was received (n,).", kind="flag")


@record
class AnchorRangingState:
    """State of the ranging radio. Source: docs page, Sensors for three dimensions."""

    key: Key = part("Key of the random number generator for the noise.")
    bias: Any = quantity("m", "Range bias of each anchor (n,) in this run.")
    last: Any = quantity("m", "Last received range of each anchor (n,).")


@record
class AnchorRanging:
    """Ranging radio: two-way ranges to n anchors, all measured at one instant.

        z_i = | p + R_WB l - a_i | + b_i + w + e_i

    p is the vehicle's position, l the lever arm of the antenna and a_i the position of anchor i. b_i is the bias of
    anchor i (antenna delays) and w is white noise. The error e_i is exponentially distributed and occurs occasionally,
    when the first signal to arrive is a reflected one. Anchors out of reach are not received, and other anchors are
    lost at random.

    Frames:  anchors a_i in W, lever arm l of the antenna in B.
    Not modelled: anchors that answer in turn (`sensors.ultrasonic_ranging` has slots); reflections that persist.
    Source:  Mueller, Hamer, D'Andrea, "Fusing ultra-wideband range measurements with accelerometers and rate gyroscopes
             for quadrocopter state estimation", ICRA 2015. The sizes of the errors are our own choice.
    """

    anchors: Any = quantity("m", "Positions of the anchors (n, 3): north, east, down.", frame="W", default=HALL)
    noise: Scalar = imperfection("m", "Standard deviation of the noise of each range.", "anchor-noise", default=0.05)
    bias: Scalar = imperfection(
        "m", "Standard deviation of each anchor's range bias, drawn for each run.", "anchor-bias", default=0.05
    )
    late_paths: Scalar = imperfection(
        "1", "Probability that a range is measured along a reflected path.", "anchor-late-paths", default=0.02, high=1
    )
    late_length: Scalar = quantity(
        "m", "Mean extra length of a reflected path over the direct path.", default=0.8, low=0
    )
    losses: Scalar = imperfection(
        "1", "Probability that an anchor is not received.", "anchor-losses", default=0.05, high=1
    )
    reach: Scalar = quantity(
        "m", "Longest range at which an anchor is received.", default=30.0, above=0, off={"anchor-reach": 1e9}
    )
    lever_arm: Any = quantity("m", "Position of the antenna on the vehicle, in B.", frame="B", default=ZERO, shape=(3,))
    period: int = period("Time between samples.", default=ms(50))

    def check(self) -> None:
        """Raise InputError if the shape of the anchors' positions is not (n, 3)."""
        shape = np.shape(self.anchors)
        if len(shape) != 2 or shape[1] != 3 or not shape[0]:
            problem = f"the positions must have shape (n, 3), got {shape}"
            raise InputError(
                "anchors", problem, fix="give north, east, down of each anchor: ((0, 0, -3), (8, 0, -1), …)"
            )

    def init(self, key: Key) -> AnchorRangingState:
        """Return the initial state, with the biases drawn for this run."""
        n = np.shape(self.anchors)[0]
        return AnchorRangingState(key.at("noise"), self.bias * normals(key.at("unit"), 0, n), jnp.zeros(n))

    def measure(self, motion: Motion) -> AnchorRanges:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        antenna = motion.p_WB + from_euler(*motion.attitude) @ jnp.asarray(self.lever_arm)
        away = antenna - jnp.asarray(self.anchors)
        ranges = jnp.sqrt(jnp.maximum(jnp.sum(away * away, axis=1), 1e-12))
        return AnchorRanges(range=ranges, received=ranges <= self.reach)

    def step(self, t: Any, state: AnchorRangingState, motion: Motion) -> tuple[AnchorRangingState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, k = self.measure(motion), t // self.period
        n = np.shape(self.anchors)[0]
        each = split(state.key.at("paths"), n)
        is_late, length = uniform2(each, k)
        is_lost, _ = uniform2(each, k, 1)
        late = jnp.where(is_late < self.late_paths, -self.late_length * jnp.log(length), 0.0)
        measured = true.range + state.bias + self.noise * normals(state.key, k, n) + late
        received = true.received & (is_lost >= self.losses)
        ranges = jnp.where(received, measured, state.last)
        return AnchorRangingState(state.key, state.bias, ranges), new_sample(t, AnchorRanges(ranges, received))

"""Optical flow sensor: a camera measures the flow of the ground's image, and a ranger scales it to a velocity."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, imperfection, part, period, quantity, record
from trimtab.core.rng import Key, normals
from trimtab.core.rotation import from_euler
from trimtab.core.signals import Motion, Sample, new_sample
from trimtab.core.time import ms

LEAST_COSINE = 0.1
"""Smallest cosine of the tilt. Beyond a tilt of 84° the distance to the ground is computed as at 84°."""


@record
class FlowReading:
    """Sample of an optical flow sensor. Source: docs page, Sensors for three dimensions."""

    flow: Any = quantity(
        "rad/s",
        "Flow of the ground's image along B's x and y axes, not compensated for rotation.",
        frame="B",
        shape=(2,),
    )
    distance: Scalar = quantity("m", "Distance to the ground along B's z axis.")
    surge_velocity: Scalar = quantity(
        "m/s", "Velocity along the body's x axis, compensated for the body's rotation.", frame="B"
    )
    sway_velocity: Scalar = quantity(
        "m/s", "Velocity along the body's y axis, compensated for the body's rotation.", frame="B"
    )
    usable: Scalar = quantity(
        "1", "True if distance and flow are within the limits of the ranger and the camera.", kind="flag"
    )


@record
class FlowState:
    """State of an optical flow sensor: random key and gyro zero error. Source: docs page, Optical flow."""

    key: Key = part("Key of the random number generator for the noise.")
    gyro_offset: Any = quantity("rad/s", "Zero error of the gyro: roll and pitch rate.", frame="B", shape=(2,))


@record
class OpticalFlow:
    """Camera with a gyro and a ranger. The camera looks along the body's z axis at level ground.

        flow = ( -u/d - q,  -v/d + p )        u = -d (flow_x + q_gyro),  v = -d (flow_y - p_gyro)

    d is the distance to the ground, (u, v) the velocity, and (p, q) the roll and pitch rate.

    Frames:  B; the ground is the plane at `ground` in W.
    Valid:   level ground, tilt below 84°. Not modelled: texture, light, vibration, exposure time, lever arm.
    Source:  Honegger et al., "An open source and open hardware embedded metric optical flow CMOS camera", ICRA 2013.
             The sizes of the errors are our own choice.
    """

    noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the flow noise of each sample.", "optical-flow-noise", default=0.02
    )
    scale_factor: Scalar = imperfection(
        "1", "Relative error of the camera's focal length.", "optical-flow-scale-factor", default=0.01, low=None
    )
    gyro_noise: Scalar = imperfection(
        "rad/s", "Standard deviation of the gyro noise of each sample.", "optical-flow-gyro-noise", default=0.005
    )
    gyro_bias: Scalar = imperfection(
        "rad/s",
        "Standard deviation of the gyro's zero error, drawn for each run.",
        "optical-flow-gyro-bias",
        default=0.005,
    )
    range_noise: Scalar = imperfection(
        "m", "Standard deviation of the noise of each range sample.", "optical-flow-range-noise", default=0.01
    )
    ground: Scalar = quantity("m", "Down coordinate of the ground in W.", frame="W", default=0.0)
    nearest: Scalar = quantity("m", "Shortest distance that the ranger measures.", default=0.08, low=0)
    farthest: Scalar = quantity("m", "Largest distance that the ranger measures.", default=10.0, above=0)
    fastest: Scalar = quantity("rad/s", "Largest flow that the camera can follow.", default=7.4, above=0)
    period: int = period("Time between samples.", default=ms(20))

    def init(self, key: Key) -> FlowState:
        """Return the initial state, with the zero error drawn for this run."""
        return FlowState(key.at("noise"), self.gyro_bias * normals(key.at("unit"), 0, 2))

    def measure(self, motion: Motion) -> FlowReading:
        """Return the measurement h(x) for the vehicle's motion, without error."""
        p, q = motion.w_WB_B[0], motion.w_WB_B[1]
        u, v = motion.v_WB_B[0], motion.v_WB_B[1]
        d = self._distance(motion)
        return self._reading(jnp.stack([-u / d - q, -v / d + p]), d, jnp.stack([p, q]), d)

    def step(self, t: Any, state: FlowState, motion: Motion) -> tuple[FlowState, Sample]:
        """Return the sample at time t (unit: 100 ns)."""
        true, z = self.measure(motion), normals(state.key, t // self.period, 5)
        flow = (1 + self.scale_factor) * true.flow + self.noise * z[:2]
        gyro = motion.w_WB_B[:2] + state.gyro_offset + self.gyro_noise * z[2:4]
        distance = true.distance + self.range_noise * z[4]
        return state, new_sample(t, self._reading(flow, distance, gyro, true.distance))

    def _distance(self, motion: Motion) -> Any:
        """Return the distance (m) along B's z axis to the ground, at least 1 mm."""
        cosine = jnp.maximum(from_euler(*motion.attitude)[2, 2], LEAST_COSINE)
        return jnp.maximum((self.ground - motion.p_WB[2]) / cosine, 1e-3)

    def _reading(self, flow: Any, distance: Any, gyro: Any, true_distance: Any) -> FlowReading:
        within = (true_distance >= self.nearest) & (true_distance <= self.farthest)
        return FlowReading(
            flow=flow,
            distance=distance,
            surge_velocity=-distance * (flow[0] + gyro[1]),
            sway_velocity=-distance * (flow[1] - gyro[0]),
            usable=within & jnp.all(jnp.abs(flow) <= self.fastest),
        )

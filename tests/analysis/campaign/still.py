"""A vehicle at rest whose gyro has white noise and a bias, and nothing else: what it says is a Gaussian."""

import numpy as np

from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build

NOISE, BIAS, PERIOD, SAMPLES = 0.002, 0.01, 0.01, 20
"""Of white noise (rad/s/sqrt(Hz)); standard deviation of the bias (rad/s) where it is spread; s; samples of a run."""
SPREAD = {"world.sensors.imu.gyro.bias[2]": f"normal(0, {BIAS})"}
SIGMA = float(np.hypot(BIAS, NOISE / np.sqrt(PERIOD * SAMPLES)))
"""Of the mean rate of a run."""


def scenario() -> Scenario:
    """`navigation/still` for a fifth of a second, a sample each 10 ms."""
    off = ("bandwidth", "bias-walk", "misalignment", "quantisation", "saturation", "scale-factor", "turn-on-bias")
    settings = {
        "duration": "200 ms",
        "world.sensors.imu.period": "10 ms",
        "world.sensors.imu.gyro.noise": str(NOISE),
    }
    return build("navigation/still", settings, [f"imu-{name}" for name in off])


def mean_rate(rows):
    """Mean of the rate about z that the gyro says, (n,)."""
    return rows["sensors.imu.value.angular_rate"][:, :, 2].mean(axis=1)


mean_rate.signals = ("sensors.imu.value.angular_rate",)

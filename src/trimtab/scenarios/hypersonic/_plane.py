"""World of the hypersonic vehicle with lags of engine and elevator, turbulence, and errors of the accelerometer.

Source: Bolender, Doman, "Nonlinear longitudinal dynamical model of an air-breathing hypersonic vehicle", Journal of
Spacecraft and Rockets 44(2), 2007, for the form of the lags; MIL-F-8785C for the turbulence. The sizes of the lags and
errors are our choice (docs, What it needs).
"""

from typing import Any

from trimtab.actuators.bank import ActuatorBank
from trimtab.actuators.lag import SecondOrderLag
from trimtab.core.record import replace
from trimtab.core.rotation import DEG
from trimtab.core.time import ms
from trimtab.environment.turbulence import Turbulence
from trimtab.loop.world import World
from trimtab.sensors.angular_accelerometer import AngularAccelerometerUnit

ENGINE, ELEVATOR = 20.0, 100.0
"""Natural frequencies of the second-order lags of the engine and the elevator servo (rad/s)."""
ELEVATOR_RATE = 100 * DEG
"""Maximum rate of the elevator (rad/s)."""
SEVERE = 1e-5
"""Probability that the turbulence intensity is exceeded. It corresponds to an intensity of 5.1 ft/s at 80 000 ft and
above. The figure in MIL-F-8785C ends at 80 000 ft."""
SERVO_PERIOD = ms(1)


def plane_truth(world: World, noise: float) -> World:
    """Return the world with lags of engine and elevator, severe turbulence, and errors of the angular accelerometer.

    noise: standard deviation of the accelerometer's noise (rad/s^2).
    """
    actuators: Any = world.actuators
    stages = {
        "Phi": SecondOrderLag(frequency=ENGINE),
        "delta_e": SecondOrderLag(frequency=ELEVATOR, rate_limit=ELEVATOR_RATE),
    }
    tick = actuators.period
    unit = AngularAccelerometerUnit(
        period=tick, noise=noise, bias=0.02, scale_factor=0.005, bandwidth=60.0, delay=0.001
    )
    return replace(
        world,
        sensors={**world.sensors, "angular-accelerometer": unit},
        actuators=ActuatorBank(actuators.neutral_input, stages, period=SERVO_PERIOD),
        turbulence=Turbulence(exceedance=SEVERE, period=tick),
    )

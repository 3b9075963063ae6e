"""Brushed motor with propeller and encoder, supplied by a battery whose voltage sags: the plant of a speed regulator.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.integrate import rk4
from trimtab.core.record import Scalar, period, quantity, record
from trimtab.core.time import ms, to_seconds

RPM = 30 / np.pi
"""Conversion factor from rad/s to rpm."""
TURN_COUNTS = 2**16
"""Number of counts after which the encoder's counter wraps to zero."""


@record
class MotorInput:
    """Input of the motor. Frames: positive drives forward. Source: docs page, Motor."""

    duty: Scalar = quantity(
        "1", "Duty of the motor: fraction of the time for which the battery is connected, negative in reverse."
    )
    voltage: Scalar = quantity("V", "Voltage of the battery under load.", default=7.2)


@record
class MotorState:
    """State of the motor. Frames: positive turns forward. Source: docs page, Motor."""

    speed: Scalar = quantity("rad/s", "Speed of the motor shaft.", default=np.float64(0.0))
    turned: Scalar = quantity(
        "1",
        "Encoder position in counts, including the fraction of a count. It wraps with the encoder's counter.",
        default=np.float64(0.0),
    )


@record
class MotorOutput:
    """Output of the motor. Frames: positive turns forward. Source: docs page, Motor."""

    speed_rpm: Scalar = quantity("rpm", "Speed of the motor shaft.")
    count: Scalar = quantity("1", "Counter of the encoder, 0 to 65535, as in a 16-bit register.", kind="count")


@record
class Motor:
    """Brushed motor with a linear torque curve, and a propeller whose torque is quadratic in the speed.

        I dω/dt = T_stall (duty V/V_nominal − n/n_free) − k_prop n |n|

    ω is the shaft speed (n in rpm), V the voltage of the battery and I the moment of inertia. The propeller's torque
    balances the motor's torque at 12 000 rpm and full duty: T_stall (1 − 12/19.2) = k_prop 12².

    Frames:  positive turns forward.
    Valid:   continuous current.    Not modelled: friction, inductance, heating, inflow to the propeller, the
             controller's brake (see Speed controller).
    Source:  [1] chapter 4: 12 oz-in at stall, 19 200 rpm free, about 12 000 rpm loaded, 7.2 V, encoder of 100 cycles a
             turn. The inertia and the propeller's torque are our own choice.
    """

    stall_torque: Scalar = quantity(
        "N m", "Stall torque: torque at rest with full duty.", default=0.08474, above=0, source="[1] chapter 4"
    )
    free_rpm: Scalar = quantity(
        "rpm",
        "No-load speed: speed at full duty without a propeller.",
        default=19200.0,
        above=0,
        source="[1] chapter 4",
    )
    nominal_voltage: Scalar = quantity(
        "V",
        "Nominal voltage, to which stall torque and no-load speed refer.",
        default=7.2,
        above=0,
        source="[1] chapter 4",
    )
    inertia: Scalar = quantity("kg m^2", "Moment of inertia of rotor and propeller.", default=2.2e-5, above=0)
    propeller: Scalar = quantity(
        "N m/krpm^2", "Coefficient of the propeller's torque: torque divided by speed squared.", default=2.207e-4, low=0
    )
    counts: Scalar = quantity(
        "1", "Number of encoder edges per turn of the shaft.", default=400.0, above=0, source="[1] chapter 4"
    )
    period: int = period("Time step of the motor model.", default=ms(1))

    def init(self) -> MotorState:
        """Return the initial state, at rest."""
        return MotorState()

    def torque(self, speed: Any, input: MotorInput) -> Any:
        """Return the motor's torque (N m) at a speed (rad/s), without the torque of the propeller."""
        n = speed * (RPM * 1e-3)
        return self.stall_torque * (input.duty * input.voltage / self.nominal_voltage - n / (self.free_rpm * 1e-3))

    def acceleration(self, speed: Any, input: MotorInput) -> Any:
        """Return the acceleration of the shaft (rad/s^2) at a speed (rad/s)."""
        n = speed * (RPM * 1e-3)
        return (self.torque(speed, input) - self.propeller * n * abs(n)) / self.inertia

    def current(self, speed: Any, input: MotorInput) -> Any:
        """Return the current through the windings (A) at a speed (rad/s).

        The battery supplies the fraction `duty` of this current. The current is the torque divided by the motor
        constant. The motor constant is the nominal voltage divided by the no-load speed in rad/s.
        """
        return self.torque(speed, input) * self.free_rpm / (RPM * self.nominal_voltage)

    def duty(self, speed_rpm: Any, voltage: Any = 7.2) -> Any:
        """Return the duty that keeps a speed (rpm) constant at a battery voltage `voltage` (V)."""
        n = speed_rpm * 1e-3
        load = self.propeller * n * abs(n) / self.stall_torque + speed_rpm / self.free_rpm
        return load * self.nominal_voltage / voltage

    def step(self, t: Any, state: MotorState, input: MotorInput) -> tuple[MotorState, MotorOutput]:
        """Return the state after one period with constant duty and voltage."""

        def rate(_: Any, x: MotorState) -> MotorState:
            return MotorState(speed=self.acceleration(x.speed, input), turned=x.speed * (self.counts / (2 * np.pi)))

        x = rk4(rate, to_seconds(t), state, to_seconds(self.period))
        turned = x.turned - jnp.floor(x.turned / TURN_COUNTS) * TURN_COUNTS
        new = MotorState(speed=x.speed, turned=turned)
        return new, MotorOutput(speed_rpm=x.speed * RPM, count=jnp.floor(turned).astype(np.int32))

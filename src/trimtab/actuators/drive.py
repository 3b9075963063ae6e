"""Drive of the vectored fan, from command to force: servo frames, brake, tables and stops.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.actuators.failsafe import Failsafe
from trimtab.actuators.lookup import BilinearTable, check_thrust_table, thrust_table
from trimtab.actuators.regulated_fan import RegulatedFan, RegulatedFanOutput, RegulatedFanState
from trimtab.actuators.rudder import RudderGeometry, RudderServo
from trimtab.actuators.thruster import Thruster
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, period, quantity, record, switch
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarForce, Sample
from trimtab.core.time import format_time, ms, to_seconds

MODES = ("forward", "reverse", "braking")
FORWARD, REVERSE, BRAKING = range(3)


@record
class SpeedControllerState:
    """State of the speed controller: direction of the last non-zero speed, and state of the brake.

    Frames:  none.
    Source:  [1] section 6.1.
    """

    mode: Scalar = quantity(
        "1",
        "Mode of the speed controller: forward, braking or reverse.",
        kind="mode",
        modes=MODES,
        default=np.int32(FORWARD),
    )
    brake_until: Scalar = quantity(
        "100 ns", "Time at which the last braking phase ends.", kind="time", default=np.int64(0)
    )
    brakings: Scalar = quantity(
        "1", "Number of times that the fan has been braked since the start.", kind="count", default=np.int32(0)
    )


@record
class SpeedController:
    """Speed controller that forwards the commanded speed, and brakes for a fixed time between reverse and forward.

        forward  --negative-->  reverse        at once
        reverse  --positive-->  braking        output 0 until t + brake
        braking  --negative-->  reverse        at once: the brake is cancelled
        braking  --brake over-> forward

    A zero command does not change the mode. The controller stores the last direction of the fan, so a pause at zero
    between reverse and forward does not avoid the brake. This is reconstructed: [1] does not describe pauses.

    Frames:  positive speed pushes the vehicle forward.
    Source:  [1] chapter 4 and section 6.1: 150 ms, wired so that the delay occurs from reverse to forward.
    """

    brake: int = period(
        "Duration of the braking phase; 0 switches the brake off.", default=ms(150), low=0, off={"braking": 0}
    )

    def init(self) -> SpeedControllerState:
        """Return the initial state: fan at rest, mode forward."""
        return SpeedControllerState()

    def step(self, t: Any, state: SpeedControllerState, speed_rpm: Any) -> tuple[SpeedControllerState, Any]:
        """Return the new state and the forwarded speed (rpm) at integer time t.

        The times of successive calls must increase, but need not have a fixed period.
        """
        negative, positive = speed_rpm < 0, speed_rpm > 0
        was_reverse = state.mode == REVERSE
        turns = was_reverse & positive
        until = jnp.where(turns, t + self.brake, state.brake_until)
        braking = (turns | (state.mode == BRAKING)) & ~negative & (t < until)
        reverse = negative | (was_reverse & ~positive)
        mode = jnp.where(braking, BRAKING, jnp.where(reverse, REVERSE, FORWARD)).astype(np.int32)
        brakings = state.brakings + (turns & braking)
        new = SpeedControllerState(mode=mode, brake_until=until, brakings=brakings)
        return new, jnp.where(braking, 0.0, speed_rpm)


@record
class DriveCommand:
    """Command for the drive of the vectored fan. Frames: positive speed pushes forward. Source: [1] chapter 5."""

    rudder_pulse: Scalar = quantity("s", "Pulse width of the rudder servo.")
    speed_rpm: Scalar = quantity("rpm", "Speed of the fan, negative in reverse.")

    def failsafe(self) -> Failsafe:
        """Return the default failsafe of a vehicle with this drive, for scenarios that define no failsafe."""
        return drive_failsafe()


NEUTRAL_COMMAND = DriveCommand(rudder_pulse=RudderServo().neutral_pulse, speed_rpm=0.0)
"""Neutral command: rudder in the middle, fan at rest."""


def drive_failsafe() -> Failsafe:
    """Return the failsafe of a vectored fan, limited to the pulse range of its servo and the no-load speed of its
    motor."""
    return Failsafe(
        safe=NEUTRAL_COMMAND,
        low=DriveCommand(rudder_pulse=0.8e-3, speed_rpm=-19200.0),
        high=DriveCommand(rudder_pulse=2.2e-3, speed_rpm=19200.0),
    )


@record
class FanDriveState:
    """State of the drive of the vectored fan.

    Frames:  none. Source: this module.
    """

    rudder_pulse: Scalar = quantity("s", "Pulse width of the rudder servo, latched in the last servo frame.")
    commanded_rpm: Scalar = quantity("rpm", "Commanded fan speed, latched in the last servo frame.")
    controller: SpeedControllerState = part("State of the speed controller.")
    speed_rpm: Scalar = quantity("rpm", "Speed of the fan.")
    fan: RegulatedFanState | None = part(
        "Regulator, motor and battery of the fan; None if the fan is not regulated.", default=None
    )


@record
class DriveOutput:
    """Output of the vectored fan. Frames: angles from the body's x axis, force in B. Source: this module."""

    u: PlanarForce = part("Force at the rudder pivot.")
    thrust: Scalar = quantity("N", "Thrust in the direction of the force angle; negative in reverse.")
    rudder: Scalar = quantity("rad", "Rudder angle.", kind="angle")
    speed_rpm: Scalar = quantity("rpm", "Speed of the fan, negative in reverse.")
    mode: Scalar = quantity("1", "Mode of the speed controller: forward, reverse or braking.", kind="mode", modes=MODES)
    brakings: Scalar = quantity("1", "Number of times that the fan has been braked since the start.", kind="count")
    rudder_saturated: Scalar = quantity("1", "True if the rudder is at a stop.", kind="flag")
    speed_saturated: Scalar = quantity("1", "True if the fan is at its top speed.", kind="flag")
    fan: RegulatedFanOutput | None = part(
        "Regulator, motor and battery of the fan; None if the fan is not regulated.", default=None
    )


@record
class FanDrive:
    """Drive of a reversible fan with a rudder behind it: servo, speed controller and fan.

        every servo frame: latch the command
        pulse -> theta (servo table, stops)
        commanded speed -> brake -> n (lag, if any); with a regulated fan: -> regulator -> duty -> brake -> motor -> n
        f = table(theta, n)    psi = (offset - theta)/ratio    FX = f cos psi    FY = -f sin psi

    theta is the rudder angle, psi the force angle, n the fan speed and f the thrust. If the imperfection "lookup-table"
    or "saturation" is off, f is computed from the thruster's formula. The allocation then uses the formula too, so the
    allocation remains the inverse of the drive.

    Frames:  force in B at the rudder pivot; positive speed pushes forward.
    Valid:   at rest: no inflow.    Not modelled: slew rate of the servo; motor lag unless a time constant is set.
    Source:  [1] section 6.1 (brake, reverse table, components of the force), chapter 5 (20 ms frame).
    """

    rudder: RudderServo = part("Servo of the rudder.", default=RudderServo())
    geometry: RudderGeometry = part("Relation between rudder angle and force angle.", default=RudderGeometry())
    controller: SpeedController = part("Speed controller of the fan.", default=SpeedController())
    thruster: Thruster = part("Model of the fan's thrust as a function of its speed.", default=Thruster())
    table: BilinearTable | None = part(
        "Table of the thrust over rudder angle and fan speed. None: use the thruster's formula.",
        default=thrust_table(Thruster()),
        off={"lookup-table": None},
    )
    effectiveness: Scalar = quantity("1", "Factor on the thrust, e.g. below 1 for a weak fan.", default=1.0, low=0)
    fan: RegulatedFan | None = part(
        "Regulator, motor and battery of the fan. None: the fan speed follows the command, as in Kulis (2006).",
        default=None,
        optional=RegulatedFan(),
    )
    frame: int = period("Period of the command pulses to the servo and the speed controller.", default=ms(20))
    period: int = period("Time step of the drive.", default=ms(1))
    saturation: bool = switch("True: the rudder angle and the fan speed are limited.", "saturation")

    def check(self) -> None:
        """Raise InputError if the servo frame is not a multiple of the drive's period, or the table was made from
        another thruster."""
        if self.frame % self.period:
            frame, own = format_time(self.frame), format_time(self.period)
            problem = f"the servo frame of {frame} must be a multiple of the drive's period of {own}"
            raise InputError("frame", problem, fix="choose a frame that is a multiple of the period")
        if self.table is not None:
            check_thrust_table(self.table, self.thruster)
        if self.fan is not None:
            self.fan.check()
            if self.fan.motor.period != self.period:
                problem = (
                    f"the motor's period of {format_time(self.fan.motor.period)} must equal the drive's "
                    f"period of {format_time(self.period)}"
                )
                raise InputError("fan.motor.period", problem, fix="set both periods to the same value")

    def neutral(self) -> DriveOutput:
        """Return the output with the fan at rest and the rudder at the servo's neutral pulse."""
        return DriveOutput(
            u=PlanarForce(0.0, 0.0),
            thrust=0.0,
            rudder=_neutral_angle(self),
            speed_rpm=0.0,
            mode=np.int32(0),
            brakings=np.int32(0),
            rudder_saturated=np.bool_(False),
            speed_saturated=np.bool_(False),
            fan=None if self.fan is None else self.fan.neutral(),
        )

    def init(self, key: Key) -> FanDriveState:
        """Return the initial state: neutral command latched, fan at rest."""
        zero = np.float64(0.0)
        fan = None if self.fan is None else self.fan.init()
        return FanDriveState(self.rudder.neutral_pulse, zero, self.controller.init(), zero, fan)

    def step(self, t: Any, state: FanDriveState, command: Sample) -> tuple[FanDriveState, DriveOutput]:
        """Return the new state, and the force that acts from integer time t on.

        An invalid command counts as neutral.
        """
        pulse, commanded = self._latch(t, state, command)
        controller, speed, fan, regulated = self._turn(t, state, commanded)
        rudder = self._rudder_angle(pulse)
        thrust = self.effectiveness * self._thrust(speed, rudder)
        psi = self.geometry.force_angle(rudder)
        output = DriveOutput(
            u=PlanarForce(FX=thrust * jnp.cos(psi), FY=-thrust * jnp.sin(psi)),
            thrust=thrust,
            rudder=rudder,
            speed_rpm=speed,
            mode=controller.mode,
            brakings=controller.brakings,
            rudder_saturated=self.rudder.is_at_stop(rudder) & self.saturation,
            speed_saturated=(abs(speed) >= self.thruster.speed_max_rpm * (1 - 1e-9)) & self.saturation,
            fan=regulated,
        )
        return FanDriveState(pulse, commanded, controller, speed, fan), output

    def _turn(self, t: Any, state: FanDriveState, commanded: Any) -> tuple[SpeedControllerState, Any, Any, Any]:
        """Return the speed controller's state, the fan speed (rpm), and the regulated fan's state and output (None
        without a regulated fan)."""
        if self.fan is None or state.fan is None:
            controller, wanted = self.controller.step(t, state.controller, commanded)
            return controller, self.thruster.follow_speed(state.speed_rpm, wanted, to_seconds(self.period)), None, None
        fan = self.fan.regulate(t, state.fan, commanded)
        controller, duty = self.controller.step(t, state.controller, fan.duty)
        fan, speed, output = self.fan.turn(t, fan, duty)
        return controller, speed, fan, output

    def _latch(self, t: Any, state: FanDriveState, command: Sample) -> tuple[Any, Any]:
        value = command.value
        speed = value.speed_rpm
        if self.saturation:
            speed = jnp.clip(speed, -self.thruster.speed_max_rpm, self.thruster.speed_max_rpm)
        due = t % self.frame == 0
        pulse = jnp.where(command.valid, value.rudder_pulse, self.rudder.neutral_pulse)
        speed = jnp.where(command.valid, speed, 0.0)
        return jnp.where(due, pulse, state.rudder_pulse), jnp.where(due, speed, state.commanded_rpm)

    def _rudder_angle(self, pulse: Any) -> Any:
        angle = self.rudder.angle(pulse)
        return self.rudder.limit_angle(angle) if self.saturation else angle

    def _thrust(self, speed_rpm: Any, rudder_angle: Any) -> Any:
        if self.table is None or not self.saturation:
            return self.thruster.force(speed_rpm, rudder_angle)
        return self.table.at(rudder_angle, speed_rpm)


@jax.jit
def _neutral_angle(drive: FanDrive) -> Any:
    """Return the neutral rudder angle.

    It is compiled as one program, because JAX would otherwise compile each operation separately.
    """
    return drive._rudder_angle(drive.rudder.neutral_pulse)

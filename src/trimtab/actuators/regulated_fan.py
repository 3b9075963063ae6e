"""Thrust fan driven by the vehicle's firmware: speed regulator, speed controller, motor, encoder and battery.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.actuators.battery import Battery, BatteryOutput, BatteryState
from trimtab.actuators.motor import Motor, MotorInput, MotorState
from trimtab.actuators.speed_regulator import SpeedRegulator, SpeedRegulatorInput, SpeedRegulatorState
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record, tree_where
from trimtab.core.time import format_time


@record
class RegulatedFanState:
    """State of the regulated fan. Frames: positive speed pushes forward. Source: docs page, Regulated fan."""

    regulator: SpeedRegulatorState = part("State of the speed regulator.")
    motor: MotorState = part("State of motor and encoder.")
    battery: BatteryState = part("State of the battery.")
    count: Scalar = quantity("1", "Value of the encoder's counter.", kind="count", default=np.int32(0))
    duty: Scalar = quantity("1", "Duty of the motor that the regulator requests.", default=np.float64(0.0))
    fault: Scalar = quantity("1", "True if the encoder is faulty.", kind="flag", default=np.bool_(False))


@record
class RegulatedFanOutput:
    """Output of the regulated fan. Frames: positive speed pushes forward. Source: docs page, Regulated fan."""

    duty: Scalar = quantity("1", "Duty of the motor, -1 to 1, negative in reverse.")
    encoder_fault: Scalar = quantity("1", "True if the encoder is faulty.", kind="flag")
    battery: BatteryOutput = part("Voltage, current and remaining charge of the battery.")


@record
class RegulatedFan:
    """Regulated fan: the blocks of the firmware, followed by motor, propeller and battery.

        every period of the regulator: encoder's counter, commanded speed -> duty
        duty -> speed controller (brake) -> motor and propeller on the battery's voltage -> speed, counter
        current of the motor -> battery -> voltage of the next step

    Frames:  positive speed pushes forward.    Not modelled: the servo frame of the duty's pulses, 20 ms.
    Source:  [1] chapter 4 (PI regulator in the firmware; encoder). The docstrings of the parts name the values
             that are our own choice.
    """

    regulator: SpeedRegulator = part("Speed regulator of the firmware.", default=SpeedRegulator())
    motor: Motor = part("Motor with propeller and encoder.", default=Motor())
    battery: Battery = part("Battery of the motor.", default=Battery())

    def check(self) -> None:
        """Raise InputError if the periods of regulator, motor and battery do not match."""
        step, tick, other = self.motor.period, self.regulator.period, self.battery.period
        if tick % step or other != step:
            problem = (
                f"the periods do not match: regulator {format_time(tick)}, motor {format_time(step)}, "
                f"battery {format_time(other)}"
            )
            fix = "set motor and battery to equal periods, and the regulator's period to a multiple of this period"
            raise InputError("RegulatedFan.period", problem, fix=fix)
        self.battery.check()

    def init(self) -> RegulatedFanState:
        """Return the initial state, at rest."""
        return RegulatedFanState(regulator=self.regulator.init(), motor=self.motor.init(), battery=self.battery.init())

    def neutral(self) -> RegulatedFanOutput:
        """Return the output of the fan at zero duty."""
        other = self.battery.other
        power = BatteryOutput(voltage=self.battery.init().voltage, current=other, remaining=self.battery.initial)
        return RegulatedFanOutput(duty=0.0, encoder_fault=np.bool_(False), battery=power)

    def regulate(self, t: Any, state: RegulatedFanState, rpm_command: Any) -> RegulatedFanState:
        """Return the state with the duty for a commanded speed. The duty changes only when t is a multiple of
        `regulator.period`.
        """
        given = SpeedRegulatorInput(rpm_command=rpm_command, count=state.count)
        regulator, out = self.regulator.step(t, state.regulator, given)
        due = t % self.regulator.period == 0
        return RegulatedFanState(
            regulator=tree_where(due, regulator, state.regulator),
            motor=state.motor,
            battery=state.battery,
            count=state.count,
            duty=jnp.where(due, out.duty, state.duty),
            fault=jnp.where(due, out.fault, state.fault),
        )

    def turn(self, t: Any, state: RegulatedFanState, duty: Any) -> tuple[RegulatedFanState, Any, RegulatedFanOutput]:
        """Return the state, the speed (rpm) and the output after one period with a constant duty (-1 to 1).

        t: integer time at the start of the period.
        """
        given = MotorInput(duty=duty, voltage=state.battery.voltage)
        motor, moved = self.motor.step(t, state.motor, given)
        drawn = duty * self.motor.current(motor.speed, given)
        battery, power = self.battery.step(t, state.battery, drawn)
        new = RegulatedFanState(state.regulator, motor, battery, moved.count, state.duty, state.fault)
        return new, moved.speed_rpm, RegulatedFanOutput(duty=duty, encoder_fault=state.fault, battery=power)

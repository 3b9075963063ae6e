"""Battery whose voltage falls with the current and with the charge drawn.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, period, quantity, record, switch
from trimtab.core.time import ms, to_seconds


@record
class BatteryState:
    """State of a battery. Frames: none. Source: docs page, Battery."""

    drawn: Scalar = quantity("A s", "Charge drawn from the battery since it was full.")
    voltage: Scalar = quantity("V", "Voltage at the terminals.")


@record
class BatteryOutput:
    """Output of a battery. Frames: none. Source: docs page, Battery."""

    voltage: Scalar = quantity("V", "Voltage at the terminals.")
    current: Scalar = quantity("A", "Current drawn from the battery.")
    remaining: Scalar = quantity("1", "Remaining charge, as a fraction of the capacity.")


@record
class Battery:
    """Voltage source with a series resistance. The open-circuit voltage falls linearly with the charge drawn.

        V = full − (full − empty) min(drawn/capacity, 1) − resistance i

    V is the voltage, i the current, and `drawn` the charge drawn.

    Frames:  none.    Valid: down to `empty`.    Not modelled: recovery, temperature, the drop when nearly empty.
    Source:  [1] chapter 4: 7.2 V. All other values are our own choice, because [1] does not give them.
    """

    full: Scalar = quantity(
        "V", "Open-circuit voltage of the full battery.", default=7.2, above=0, source="[1] chapter 4"
    )
    empty: Scalar = quantity("V", "Open-circuit voltage of the empty battery.", default=6.2, above=0)
    capacity: Scalar = quantity("A s", "Capacity of the battery; the default is 3 A h.", default=10800.0, above=0)
    resistance: Scalar = quantity("ohm", "Internal resistance of the battery, with its leads.", default=0.03, low=0)
    other: Scalar = quantity("A", "Current drawn by the lift fan and the electronics.", default=3.0, low=0)
    initial: Scalar = quantity(
        "1", "Charge at the start of the run, as a fraction of the capacity.", default=1.0, low=0, high=1
    )
    period: int = period("Time step of the battery model.", default=ms(1))
    sags: bool = switch(
        "True: the voltage falls with the current and the charge drawn. False: it is constant.", "battery-sag"
    )

    def check(self) -> None:
        """Raise InputError for a battery whose voltage rises as it is discharged."""
        if float(self.empty) > float(self.full):
            problem = (
                f"the empty voltage of {float(self.empty):g} V must be at most the full voltage, {float(self.full):g} V"
            )
            raise InputError("Battery.empty", problem, fix="set empty below full")

    def init(self) -> BatteryState:
        """Return the initial state, with the charge given by `initial`."""
        drawn = (1.0 - self.initial) * self.capacity
        return BatteryState(drawn=jnp.asarray(drawn, np.float64), voltage=self.terminal_voltage(drawn, self.other))

    def terminal_voltage(self, drawn: Any, current: Any) -> Any:
        """Return the terminal voltage (V) after a charge (A s) has been drawn from the full battery, at a current
        (A)."""
        sag = (self.full - self.empty) * jnp.minimum(drawn / self.capacity, 1.0) + self.resistance * current
        return jnp.where(self.sags, self.full - sag, self.full)

    def step(self, t: Any, state: BatteryState, current: Any) -> tuple[BatteryState, BatteryOutput]:
        """Return the battery's state and output after one period.

        current: current (A) drawn in addition to that of the lift fan and the electronics.
        """
        whole = current + self.other
        drawn = state.drawn + whole * to_seconds(self.period)
        voltage = self.terminal_voltage(drawn, whole)
        remaining = jnp.clip(1.0 - drawn / self.capacity, 0.0, 1.0)
        return BatteryState(drawn=drawn, voltage=voltage), BatteryOutput(voltage, whole, remaining)

"""A battery: its voltage falls with what is drawn now, and with what has been drawn.

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
    """Frames: none. Source: docs page, Battery."""

    drawn: Scalar = quantity("A s", "Charge drawn so far.")
    voltage: Scalar = quantity("V", "At the terminals.")


@record
class BatteryOutput:
    """Frames: none. Source: docs page, Battery."""

    voltage: Scalar = quantity("V", "At the terminals.")
    current: Scalar = quantity("A", "Drawn from it.")
    remaining: Scalar = quantity("1", "Share of the capacity that is left.")


@record
class Battery:
    """A source of voltage behind a resistance; the source's voltage falls in a straight line with the charge drawn.

        V = full − (full − empty) min(drawn/capacity, 1) − resistance i

    Frames:  none.    Valid: down to `empty`.    Not modelled: recovery, temperature, the drop at the very end.
    Source:  [1] chapter 4: 7.2 V. Everything else is reconstructed.
    """

    full: Scalar = quantity("V", "Without load, full.", default=7.2, above=0, source="[1] chapter 4")
    empty: Scalar = quantity("V", "Without load, empty.", default=6.2, above=0)
    capacity: Scalar = quantity("A s", "Charge from full to empty: 3 A h.", default=10800.0, above=0)
    resistance: Scalar = quantity("ohm", "Within it, and of the leads.", default=0.03, low=0)
    other: Scalar = quantity("A", "What lift fan and electronics draw.", default=3.0, low=0)
    initial: Scalar = quantity("1", "Share of the capacity that is left at the start.", default=1.0, low=0, high=1)
    period: int = period("How far one step goes.", default=ms(1))
    sags: bool = switch("Whether the voltage falls at all.", "battery-sag")

    def check(self) -> None:
        """Refuse a battery whose voltage rises as it is emptied."""
        if float(self.empty) > float(self.full):
            problem = f"empty at {float(self.empty):g} V, above {float(self.full):g} V"
            raise InputError("Battery.empty", problem, fix="set it below full")

    def init(self) -> BatteryState:
        """Nothing drawn yet but what `initial` says."""
        drawn = (1.0 - self.initial) * self.capacity
        return BatteryState(drawn=jnp.asarray(drawn, np.float64), voltage=self.terminal_voltage(drawn, self.other))

    def terminal_voltage(self, drawn: Any, current: Any) -> Any:
        """The voltage (V) after so much charge (A s), under a current (A)."""
        sag = (self.full - self.empty) * jnp.minimum(drawn / self.capacity, 1.0) + self.resistance * current
        return jnp.where(self.sags, self.full - sag, self.full)

    def step(self, t: Any, state: BatteryState, current: Any) -> tuple[BatteryState, BatteryOutput]:
        """One period further with a current (A) drawn, on top of `other`."""
        whole = current + self.other
        drawn = state.drawn + whole * to_seconds(self.period)
        voltage = self.terminal_voltage(drawn, whole)
        remaining = jnp.clip(1.0 - drawn / self.capacity, 0.0, 1.0)
        return BatteryState(drawn=drawn, voltage=voltage), BatteryOutput(voltage, whole, remaining)

"""Law of a rotating platform: a commanded rate of turn over time, independent of the navigation."""

import math
from typing import Any, ClassVar

import jax.numpy as jnp

from trimtab.core.record import Scalar, option, part, quantity, record
from trimtab.core.signals import Estimate
from trimtab.core.time import to_seconds
from trimtab.vehicles.rotating_platform import PlatformDrive


@record
class TurntableOutput:
    """Demand of the law `Turntable`. Source: this module."""

    demand: PlatformDrive = part("Commanded rate of turn of the platform.")


@record
class Turntable:
    """Law that commands a rate of turn over time: a constant, a square wave or a sine.

        constant:  rate min(1, t/ramp)      square:  rate sign(sin(2 pi t/T))      sine:  rate sin(2 pi t/T)

    t is the time since the start of the run. Nothing is commanded before the first valid estimate, so a ramp that ends
    before this time has no effect. The values of the estimate are not used.

    Source:  [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006,
             section 6.2.1: constant rates, and a square wave.
    """

    reads: ClassVar[tuple[str, ...]] = ()

    rate: Scalar = quantity(
        "rad/s", "Amplitude of the rate of turn. A negative amplitude reverses the turn.", default=math.radians(-115)
    )
    ramp: Scalar = quantity(
        "s", "Time in which the rate rises from 0 to its constant value; 0: without delay.", default=1.0, low=0
    )
    cycle: Scalar = quantity("s", "Period T of the square wave or sine.", default=2.0, above=0)
    waveform: str = option(
        "Waveform of the commanded rate: constant, square or sine.",
        default="constant",
        choices=("constant", "square", "sine"),
    )

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], TurntableOutput]:
        """Return the commanded rate at time t (unit: 100 ns)."""
        return state, TurntableOutput(PlatformDrive(rate=self.rate * self.share(to_seconds(t))))

    def share(self, s: Any) -> Any:
        """Return the commanded rate at a time s (s), divided by the amplitude."""
        if self.waveform == "constant":
            return jnp.where(s < self.ramp, s / jnp.where(self.ramp > 0, self.ramp, 1.0), 1.0)
        phase = s / self.cycle - jnp.floor(s / self.cycle)
        if self.waveform == "square":
            return jnp.where(phase < 0.5, 1.0, -1.0)
        return jnp.sin(2 * math.pi * phase)

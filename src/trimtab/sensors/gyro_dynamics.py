"""How a gyro of the hovercraft's inertial unit follows a changing rate: two models, as part `response` of `GyroErrors`.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

import math
from typing import Any

import numpy as np

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, option, part, period, quantity, record
from trimtab.core.second_order import Section, SectionState, at_rest, filtered, low_pass
from trimtab.core.time import ms, to_seconds

TICK = ms("6.5536")


@record
class IdentifiedGyro:
    """The source's identified model, a difference equation of its 6.5536 ms tick.

        y_k = b0 u_k - a1 y_{k-1} - a2 y_{k-2}        y/u = 0.3236 z²/(z² - 0.9805 z + 0.2898)     [1, eq. 6.2]

    Poles 0.490 ± 0.222 i. Its gain for a constant rate is 1.046; `normalised` scales b0 so that it is 1.

    Valid:   below 20 Hz, sampled each 6.5536 ms.    Source: [1] eq. 6.2.
    """

    b0: Scalar = quantity("1", "Of the newest rate.", default=0.3236, above=0, source="[1] eq. 6.2")
    a1: Scalar = quantity("1", "Of the output before.", default=-0.9805, source="[1] eq. 6.2")
    a2: Scalar = quantity("1", "Of the output two before.", default=0.2898, source="[1] eq. 6.2")
    normalised: bool = option("Scale b0 to a gain of 1 at rest.", default=True, choices=(True, False))

    def section(self) -> Section:
        """The difference equation."""
        return Section(b0=1 + self.a1 + self.a2 if self.normalised else self.b0, a1=self.a1, a2=self.a2)

    def start(self, u: Any) -> SectionState:
        """The memory after a constant rate u for all time."""
        return at_rest(self.section(), u)

    def respond(self, state: SectionState, u: Any) -> tuple[SectionState, Any]:
        """The next memory, and the output for the newest rate u."""
        return filtered(self.section(), state, u)


@record
class DelayedGyroState:
    """Rates on their way and the low-pass's memory. Source: this module."""

    line: Any = quantity("rad/s", "Rates of the ticks before, newest first.")
    memory: Any = part("Memory of the low-pass.")


@record
class DelayedGyro:
    """What may stand behind the source's measured gains and phases: a delay of whole samples and a low-pass.

    Reconstructed: within 0.05 of the gains of [1, table 6.5] at all its frequencies; the phase is right at 5 and 15 Hz
    but lags too much above (0.3 rad at 20 Hz). Below 20 Hz only.

    Source:  [1] table 6.5 (fit reconstructed, see docs Errata).
    """

    samples: int = option("Delay, in samples.", default=2)
    bandwidth: Scalar = quantity("Hz", "-3 dB of the second-order Butterworth.", default=30.0, above=0)
    sampling: int = period("Time between samples.", default=TICK)

    def section(self) -> Section:
        """The low-pass."""
        return low_pass(self.bandwidth, math.sqrt(0.5), to_seconds(self.sampling))

    def start(self, u: Any) -> DelayedGyroState:
        """The state after a constant rate u for all time."""
        return DelayedGyroState(jnp.stack([jnp.asarray(u)] * self.samples), at_rest(self.section(), u))

    def respond(self, state: DelayedGyroState, u: Any) -> tuple[DelayedGyroState, Any]:
        """The next state, and the output for the newest rate u."""
        memory, y = filtered(self.section(), state.memory, state.line[-1])
        line = jnp.concatenate([jnp.asarray(u)[None], state.line[:-1]])
        return DelayedGyroState(line, memory), y


def frequency_response(section: Section, frequency: Any, sampling_period: float, delay: int = 0) -> Any:
    """Complex gain of a section and a delay of whole samples, at frequencies (Hz); for design and tests."""
    z1 = np.exp(-2j * np.pi * np.asarray(frequency) * sampling_period)
    over = section.b0 + section.b1 * z1 + section.b2 * z1**2
    return z1**delay * over / (1 + section.a1 * z1 + section.a2 * z1**2)

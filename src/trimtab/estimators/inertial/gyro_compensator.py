"""The inverse of a gyro's identified dynamics: what the gyro was turned by, out of what it says.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.core.record import Scalar, option, quantity, record
from trimtab.core.second_order import Section


@record
class CompensatorState:
    """The two measurements before; any shape, each component alone. Source: [1] eq. 6.2."""

    y1: Any = quantity("rad/s", "The one before.")
    y2: Any = quantity("rad/s", "The one before that.")


@record
class GyroCompensator:
    """Difference equation that undoes a second-order gyro.

        u_k = (y_k + a1 y_{k-1} + a2 y_{k-2})/b0          [1, eq. 6.2 inverted]

    It needs no look-ahead and is always stable. It raises the noise: 4.4 times in standard deviation, 7 times at half
    the sampling rate; and above 15 Hz, where the identified model is too weak, it gives more than the true rate: 1.5
    times at 20 Hz.

    Valid:   samples each 6.5536 ms.    Source: [1] eq. 6.2 and table 6.5.
    """

    b0: Scalar = quantity(
        "1", "Of the newest rate, in the gyro's model.", default=0.3236, above=0, source="[1] eq. 6.2"
    )
    a1: Scalar = quantity("1", "Of the output before.", default=-0.9805, source="[1] eq. 6.2")
    a2: Scalar = quantity("1", "Of the output two before.", default=0.2898, source="[1] eq. 6.2")
    normalised: bool = option("Keep a constant rate as it is: b0 = 1 + a1 + a2.", default=True, choices=(True, False))

    def section(self) -> Section:
        """The compensator as a difference equation."""
        b0 = 1 + self.a1 + self.a2 if self.normalised else self.b0
        return Section(b0=1 / b0, b1=self.a1 / b0, b2=self.a2 / b0)

    def start(self, y: Any) -> CompensatorState:
        """The state after a constant measurement y for all time."""
        return CompensatorState(y1=jnp.asarray(y), y2=jnp.asarray(y))

    def compensate(self, state: CompensatorState, y: Any) -> tuple[CompensatorState, Any]:
        """The next state, and the compensated rate of the newest measurement y."""
        s = self.section()
        return CompensatorState(y1=y, y2=state.y1), s.b0 * y + s.b1 * state.y1 + s.b2 * state.y2

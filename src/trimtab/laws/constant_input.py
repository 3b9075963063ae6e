"""Law with a constant demand, to show a vehicle's own motion or its response to input steps."""

from typing import Any, ClassVar

from trimtab.core.record import part, record
from trimtab.core.signals import Estimate, PlanarForce


@record
class ConstantInputOutput:
    """Demand of the law `ConstantInput`. Source: docs page, Constant input."""

    demand: Any = part("Demanded input of the vehicle.")


@record
class ConstantInput:
    """Law that demands the input u0, independent of the estimate. A schedule may change u0 in flight.

    Frames: those of the vehicle's input.
    Source:  docs page, Constant input.
    """

    u0: Any = part("Constant input, a record of the vehicle's input type.", default=PlanarForce(0.0, 0.0))

    reads: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Any) -> tuple[()]:
        """Return an empty record, because this law has no state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], ConstantInputOutput]:
        """Return the demand: the constant input."""
        return state, ConstantInputOutput(self.u0)

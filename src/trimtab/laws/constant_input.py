"""A law that wants the same input all the time: to see what a vehicle does by itself, or under steps of its input."""

from typing import Any, ClassVar

from trimtab.core.record import part, record
from trimtab.core.signals import Estimate, PlanarForce


@record
class ConstantInputOutput:
    """What is wanted. Source: docs page, Constant input."""

    demand: Any = part("Wanted input.")


@record
class ConstantInput:
    """Wants the input u0, whatever the estimate says. Its numbers may change in flight by a schedule.

    Frames:  the input's.
    Source:  docs page, Constant input.
    """

    u0: Any = part("The input, a record of the vehicle's.", default=PlanarForce(0.0, 0.0))

    reads: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], estimate: Estimate) -> tuple[tuple[()], ConstantInputOutput]:
        """The input."""
        return state, ConstantInputOutput(self.u0)

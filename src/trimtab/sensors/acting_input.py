"""What the actuators really do, told back: position of a control surface, flow of fuel, voltage at a motor."""

from typing import Any, ClassVar

from trimtab.core.record import period, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, new_sample
from trimtab.core.time import ms


@record
class ActingInput:
    """The vehicle's input as it acts, limits and holds included, without error.

    It is sampled before a new command acts, so it tells what has acted **since** the last command: what an estimator
    that knows its vehicle must be given. A command that was asked for is not it, once something saturates.

    Frames:  the input's.    Not modelled: noise, lag of the transducers.
    Source:  docs page, Acting input.
    """

    period: int = period("Time between samples.", default=ms(5))

    FEELS: ClassVar[str] = "input"

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, u: Any) -> Any:
        """The input record itself."""
        return u

    def step(self, t: Any, state: tuple[()], u: Any) -> tuple[tuple[()], Sample]:
        """The sample at integer time t."""
        return state, new_sample(t, self.measure(u))

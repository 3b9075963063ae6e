"""A wire: what goes in comes out at once."""

from typing import Any, ClassVar

from trimtab.core.record import period, record
from trimtab.core.rng import Key
from trimtab.core.signals import Sample, held
from trimtab.core.time import ms


@record
class Wire:
    """A channel without any fault: the sample comes out at the instant at which it went in, with its age.

    A wire has no memory, so it is as fast as what it carries; for a slower link that looks at its input only now and
    then, use `DelayChain(period, steps=0)`.

    Frames:  those of the values carried.    Not modelled: anything.    Source: docs page.
    """

    period: int = period("How often the wire is looked at.", default=ms(1))

    IMPERFECTIONS: ClassVar[tuple[str, ...]] = ()

    def init(self, key: Key, like: Sample) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], sample: Sample) -> tuple[tuple[()], Sample]:
        """The same sample, as seen at integer time t."""
        return state, held(t, sample, fresh=sample.fresh)

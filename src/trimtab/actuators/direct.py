"""Actuators without any fault: the demand acts as it is."""

from typing import Any

import jax
import jax.numpy as jnp

from trimtab.core.record import part, period, record
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarForce, Sample
from trimtab.core.time import ms


@record
class DirectAllocation:
    """Sends the demand itself as the command. Frames: the demand's. Source: docs page, Direct."""

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], demand: Any) -> tuple[tuple[()], Any]:
        """The demand."""
        return state, demand


@record
class DirectOutput:
    """What acts on the vehicle. Frames: the input's. Source: docs page, Direct."""

    u: Any = part("The vehicle's input.")


@record
class DirectActuation:
    """Gives the commanded value to the vehicle at once; until there is one, the neutral input.

    Frames:  the input's.    Source:  docs page, Direct.
    """

    neutral_input: Any = part("Input without a command, a record like the command's.", default=PlanarForce(0.0, 0.0))
    period: int = period("How often the input changes.", default=ms(1))

    def neutral(self) -> DirectOutput:
        """The neutral input."""
        return DirectOutput(u=self.neutral_input)

    def init(self, key: Key) -> tuple[()]:
        """No state."""
        return ()

    def step(self, t: Any, state: tuple[()], command: Sample) -> tuple[tuple[()], DirectOutput]:
        """The command's value where it is valid."""
        u = jax.tree.map(lambda a, b: jnp.where(command.valid, a, b), command.value, self.neutral_input)
        return state, DirectOutput(u=u)

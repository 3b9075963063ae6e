"""Gaps: between drive and load (backlash), and about zero, where a command does nothing (dead band).

Stages of an ActuatorBank. Source: [1] Gelb, Vander Velde, "Multiple-input describing functions and nonlinear system
design", McGraw-Hill 1968, appendix B.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, option, quantity, record


@record
class Backlash:
    """The play of a gear or a linkage: the load moves when the drive has crossed the gap, and stays where it was left.

        y = what is nearest to the last y between command - width/2 and command + width/2

    Exact for a command that goes one way within a period.

    Frames:  its field's.    Valid: a load that friction holds.    Not modelled: impact, a load with momentum.
    Source:  [1], the friction-controlled backlash.
    """

    width: Scalar = quantity("1", "Whole gap, in the field's unit.", default=0.02, low=0, off={"backlash": 0.0})

    def init(self, rest: Any) -> Any:
        """The load stands where it should."""
        return jnp.asarray(rest, float)

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Where the load stands."""
        y = jnp.clip(state, value - self.width / 2, value + self.width / 2)
        return y, StageOutput(value=y, limited=np.bool_(False))


@record
class DeadBand:
    """Commands up to a size do nothing.

    Larger ones lose what the band takes, as a valve with overlap; with `cuts` they come out whole, as from a motor that
    friction holds.

    Frames:  its field's.    Source:  [1].
    """

    half_width: Scalar = quantity(
        "1", "Size up to which nothing comes, in the field's unit.", default=0.01, low=0, off={"dead-band": 0.0}
    )
    cuts: bool = option("Whether what is larger comes out whole.", default=False, choices=(False, True))

    def init(self, rest: Any) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: tuple[()], value: Any, dt: Any) -> tuple[tuple[()], StageOutput]:
        """What comes through."""
        inside = jnp.clip(value, -self.half_width, self.half_width)
        y = jnp.where(abs(value) > self.half_width, value, 0.0) if self.cuts else value - inside
        return state, StageOutput(value=y, limited=np.bool_(False))

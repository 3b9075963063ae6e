"""Backlash between drive and load, and a dead band about zero in which a command has no effect.

Both are stages of an ActuatorBank.

Source: [1] Gelb, Vander Velde, "Multiple-input describing functions and nonlinear system design", McGraw-Hill 1968,
appendix B.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.interfaces import StageOutput
from trimtab.core.record import Scalar, option, quantity, record


@record
class Backlash:
    """Backlash of a gear or a linkage: the load stays where it is until the drive has crossed the gap.

        y = last y, limited to [command - width/2, command + width/2]

    y is the position of the load. The result is exact for a command that moves in one direction within a period.

    Frames:  those of the actuated value.    Valid: a load that friction holds in place.
    Not modelled: impact, load inertia.
    Source:  [1], friction-controlled backlash.
    """

    width: Scalar = quantity(
        "1", "Total width of the gap, in the unit of the actuated value.", default=0.02, low=0, off={"backlash": 0.0}
    )

    def init(self, rest: Any) -> Any:
        """Return the initial state, with the load at the rest value."""
        return jnp.asarray(rest, float)

    def step(self, state: Any, value: Any, dt: Any) -> tuple[Any, StageOutput]:
        """Return the position of the load."""
        y = jnp.clip(state, value - self.width / 2, value + self.width / 2)
        return y, StageOutput(value=y, limited=np.bool_(False))


@record
class DeadBand:
    """Dead band: commands with a magnitude up to `half_width` have no effect.

    Larger commands are reduced by `half_width`, as in a valve with overlap. If `cuts` is True, they pass unchanged, as
    in a motor with static friction.

    Frames:  those of the actuated value.    Source:  [1].
    """

    half_width: Scalar = quantity(
        "1",
        "Largest magnitude of a command that has no effect, in the unit of the actuated value.",
        default=0.01,
        low=0,
        off={"dead-band": 0.0},
    )
    cuts: bool = option(
        "True: commands beyond the dead band pass unchanged. False: they are reduced by its half width.",
        default=False,
        choices=(False, True),
    )

    def init(self, rest: Any) -> tuple[()]:
        """Return an empty record, because this stage has no state."""
        return ()

    def step(self, state: tuple[()], value: Any, dt: Any) -> tuple[tuple[()], StageOutput]:
        """Return the command's value after the dead band."""
        inside = jnp.clip(value, -self.half_width, self.half_width)
        y = jnp.where(abs(value) > self.half_width, value, 0.0) if self.cuts else value - inside
        return state, StageOutput(value=y, limited=np.bool_(False))

"""The receiving end of an uplink as a compiled step, in front of the failsafe of a vehicle on a real line.

Source: docs page, Vehicle.
"""

from typing import Any

import jax
import numpy as np

from trimtab.compiler.block import ExportedBlock, export_step
from trimtab.core.record import part, quantity, record, to_arrays
from trimtab.core.rng import Key
from trimtab.core.signals import Command, Sample


@record
class UplinkInput:
    """What comes out of the line, and when it is looked at. Source: docs page, Vehicle."""

    t: Any = quantity("100 ns", "Now, by the vehicle's clock.", kind="time")
    command: Sample = part("Newest command out of the line.")


@record
class UplinkParameters:
    """Parameters of the step. Source: docs page, Vehicle."""

    uplink: Any = part("The channel.")
    key: Any = part("Seed and run of the random numbers.")


@record
class UplinkOutput:
    """What the receiving end holds. Source: docs page, Vehicle."""

    command: Sample = part("Newest command out of the channel.")


def uplink_step(uplink: Any, command: Command, *, seed: int = 0) -> ExportedBlock:
    """The text of a channel between a line and the failsafe, for commands of this structure."""
    no = np.bool_(False)
    value = jax.tree.map(lambda v: np.zeros(np.shape(v)), command.value)
    newest = Sample(value=value, t=np.int64(0), age=np.float64(0), fresh=no, valid=no)

    def init(p: UplinkParameters) -> Any:
        return p.uplink.init(p.key.at("uplink"), newest)

    def step(p: UplinkParameters, s: Any, given: UplinkInput) -> Any:
        after, held = p.uplink.step(given.t, s, given.command)
        return jax.tree.map(lambda v, old: jax.numpy.asarray(v, old.dtype), after, s), UplinkOutput(command=held)

    return export_step(
        "uplink",
        "Receiving end of the uplink: what the failsafe is given.",
        UplinkParameters(uplink=to_arrays(uplink), key=Key(np.uint32(seed), np.uint32(0))),
        init,
        step,
        UplinkInput(t=np.int64(0), command=newest),
        "f64",
    )

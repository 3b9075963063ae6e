"""The vehicle's failsafe as a compiled step, for a virtual vehicle; a microcontroller runs the same text.

Source: docs page, Vehicle.
"""

from typing import Any

import jax
import numpy as np

from trimtab.actuators.drive import DriveCommand, drive_failsafe
from trimtab.actuators.failsafe import Failsafe, FailsafeInput
from trimtab.compiler.block import ExportedBlock, export_step
from trimtab.core.record import part, quantity, record, to_arrays
from trimtab.core.signals import Command, Sample
from trimtab.loop.scenario import Scenario

UNLIMITED = 1e300
"""Any number that is finite is believed, of a command about which nothing is known."""


@record
class FailsafeStepInput:
    """What the failsafe is given, and when. Source: docs page, Failsafe."""

    t: Any = quantity("100 ns", "Now, by the vehicle's clock.", kind="time")
    given: Any = part("What the firmware has.")


def choose_failsafe(scenario: Scenario, command: Command) -> Failsafe:
    """The scenario's failsafe; where it has none, the one of a fan drive for commands to a fan drive.

    For others, one that stops on silence and believes all finite numbers.
    """
    if isinstance(scenario.failsafe, Failsafe):
        return scenario.failsafe
    if isinstance(command.value, DriveCommand):
        return drive_failsafe()

    def filled(number: float) -> Any:
        return jax.tree.map(lambda v: np.full(np.shape(v), number), command.value)

    return Failsafe(safe=filled(0.0), low=filled(-UNLIMITED), high=filled(UNLIMITED))


def failsafe_step(failsafe: Failsafe, command: Command, *, name: str = "failsafe", real: str = "f64") -> ExportedBlock:
    """The text of a failsafe, for commands of this structure. real: "f64" or "f32"."""
    value = jax.tree.map(lambda v: np.zeros(np.shape(v)), command.value)
    no = np.bool_(False)
    newest = Sample(value=value, t=np.int64(0), age=np.float64(0), fresh=no, valid=no)
    given = FailsafeInput(command=newest, manual=value, takeover=no, radio=no, arm=no, disarm=no)
    return export_step(
        name,
        "Failsafe: what the vehicle does when nobody commands it, and who may.",
        to_arrays(failsafe),
        lambda p: p.init(),
        lambda p, s, moment: p.step(moment.t, s, moment.given),
        FailsafeStepInput(t=np.int64(0), given=given),
        real,
    )

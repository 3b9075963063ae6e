"""Stick of a compiled autopilot. A pilot moves the stick in flight, and a piloted control law reads the stick's
position as a sample.

Source: docs pages, Console and Piloted.
"""

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.interfaces import optional_member
from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.loop.scenario import Scenario

FIELDS = ("value.forward", "value.turn", "value.mode", "t", "age", "fresh", "valid")


class CompiledStick:
    """Stick of a compiled autopilot. If the control law does not read a stick, moving the stick has no effect."""

    def __init__(self, scenario: Scenario, step: CompiledBlock) -> None:
        """step: compiled autopilot of the scenario."""
        self._step = step
        sample = f"samples.{optional_member(scenario.autopilot.law, 'stick')}"
        slots = {f: step.reads[path] for f in FIELDS if (path := f"{sample}.{f}") in step.reads}
        self._slots = slots if len(slots) == len(FIELDS) else None
        self._is_moved = False

    @property
    def is_there(self) -> bool:
        """True if the control law reads the position of a stick."""
        return self._slots is not None

    @property
    def mode(self) -> int:
        """Mode of the stick that the last call of `move` has set."""
        return 0 if self._slots is None else int(self._step.inputs[self._slots["value.mode"]])

    def move(self, forward: float, turn: float, mode: int, t: int) -> None:
        """Set the position (each axis from -1 to 1) and the mode of the stick at integer time t, for the next control
        period."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["value.forward"]], inputs[at["value.turn"]], inputs[at["value.mode"]] = forward, turn, mode
        inputs[at["t"]], inputs[at["valid"]], self._is_moved = t, True, True

    def set_inputs(self, t: int) -> None:
        """Write the stick's sample into the inputs of the compiled autopilot, for the control period at integer time
        t."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["fresh"]], self._is_moved = self._is_moved, False
        inputs[at["age"]] = (t - inputs[at["t"]]) * SECONDS_PER_UNIT

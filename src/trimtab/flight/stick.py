"""Stick inside a compiled autopilot: a pilot moves it in flight, and a piloted law reads it as a sample.

Source: docs pages, Console and Piloted.
"""

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.core.interfaces import optional_member
from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.loop.scenario import Scenario

FIELDS = ("value.forward", "value.turn", "value.mode", "t", "age", "fresh", "valid")


class CompiledStick:
    """Stick of a compiled step. Moving it has no effect if the law does not read a stick."""

    def __init__(self, scenario: Scenario, step: CompiledBlock) -> None:
        """step: the compiled autopilot of this scenario."""
        self._step = step
        sample = f"samples.{optional_member(scenario.autopilot.law, 'stick')}"
        slots = {f: step.reads[path] for f in FIELDS if (path := f"{sample}.{f}") in step.reads}
        self._slots = slots if len(slots) == len(FIELDS) else None
        self._is_moved = False

    @property
    def is_there(self) -> bool:
        """True if the law reads a stick."""
        return self._slots is not None

    @property
    def mode(self) -> int:
        """Mode that the last call of `move` has set."""
        return 0 if self._slots is None else int(self._step.inputs[self._slots["value.mode"]])

    def move(self, forward: float, turn: float, mode: int, t: int) -> None:
        """Set position and mode of the stick at integer time t, each axis from -1 to 1. The next step reads them."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["value.forward"]], inputs[at["value.turn"]], inputs[at["value.mode"]] = forward, turn, mode
        inputs[at["t"]], inputs[at["valid"]], self._is_moved = t, True, True

    def set_inputs(self, t: int) -> None:
        """Set the stick's inputs for the step at integer time t."""
        if self._slots is None:
            return
        inputs, at = self._step.inputs, self._slots
        inputs[at["fresh"]], self._is_moved = self._is_moved, False
        inputs[at["age"]] = (t - inputs[at["t"]]) * SECONDS_PER_UNIT

"""Outputs of a vehicle in flight. Output rows are sent to the process of the outputs, and reports of this process are
announced.

Source: docs page, Vehicle (Watchdog).
"""

from pathlib import Path

import numpy as np

from trimtab.core.record import leaves
from trimtab.flight.exchange import slot_indices
from trimtab.flight.mavlink.protocol import ArmRequest, Severity
from trimtab.flight.outputs import Outputs
from trimtab.flight.real_time import NS
from trimtab.flight.vehicle_parts import VehicleParts


class VehicleOutputs:
    """Connection of one run of a vehicle to the process of its outputs."""

    def __init__(
        self, parts: VehicleParts, problems: list[str], watchdog: int, folder: Path | None, wanted_real_time: bool
    ) -> None:
        """Start the process of the outputs.

        Args:
            parts: parts of the vehicle.
            problems: list to which problems are appended for the JSON report.
            watchdog: time (100 ns) without output rows after which the outputs become safe.
            folder: folder for the port and the log of the process of the outputs.
            wanted_real_time: True to ask the system for real-time scheduling.
        """
        self._parts, self._problems, world, rules = parts, problems, parts.body.world, parts.duties.failsafe
        safe = [(f"command.value.{p}", v) for p, v, _ in leaves(rules.safe)]
        self._slots = slot_indices(world.reads, [p for p, _ in safe], len(world.inputs))
        self._latch = int(rules.timeout) * NS
        self._outputs = Outputs(
            [float(x) for _, v in safe for x in np.ravel(np.asarray(v, float))],
            timeout=watchdog * NS,
            lift_delay=int(rules.lift_delay) * NS,
            latch=max(self._latch, watchdog * NS),
            folder=folder,
            wanted_real_time=wanted_real_time,
            clock=parts.machine.clock,
            start=parts.machine.start_outputs,
        )

    @property
    def problem(self) -> str:
        """Problem of the process of the outputs, or an empty string while the process works."""
        return self._outputs.problem

    def hand_over(self, t: int) -> None:
        """Send the current output row to the process of the outputs, and announce new reports and problems of this
        process."""
        outputs, duties = self._outputs, self._parts.duties
        if not outputs.is_alive:
            return
        values = self._parts.body.world.inputs[self._slots].tolist()
        silence = outputs.hand_over(duties.is_commanded, bool(duties.step.result("lift")), values)
        if silence:
            self._problems.append("the outputs went safe on their own")
            self._announce(f"outputs went safe: no data for {silence * 1e-6:.0f} ms")
            if silence >= self._latch:
                duties.handle_event(ArmRequest(False), t)
        if not outputs.is_alive:
            self._problems.append(outputs.problem)
            self._announce(outputs.problem)

    def _announce(self, text: str) -> None:
        self._parts.announcer.announce(Severity.CRITICAL, text)

    def close(self) -> None:
        """Make the outputs safe and end the process of the outputs."""
        self._outputs.close()

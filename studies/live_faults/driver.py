"""Driver of a vehicle's servos and motors in virtual time, and the check of what it applies.

The driver reads the port of the outputs once a millisecond, by the rule of `output_port.OutputReader`. The check knows
which programs were frozen, starved or dead, and when the vehicle last got an autopilot's packet. It needs no log.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from trimtab.core.clock import NS_PER_SECOND
from trimtab.flight.output_port import OutputReader
from trimtab.flight.virtual_time import VirtualClock, VirtualProgram, VirtualTime

PERIOD_S = 0.001
PROCESS_S, RADIO_S = 0.1, 0.25
"""Longest time (s) for which outputs act after the vehicle or its outputs stopped, and after the last packet."""
TRANSIT_S = 0.002
"""Longest time (s) from a packet's departure to its effect on the outputs."""
SILENCE = "the last packet of an autopilot"


class OutputsCheck:
    """Check of the outputs that the driver of one vehicle applied."""

    def __init__(
        self, name: str, time: VirtualTime, programs: dict[str, VirtualProgram], last_heard: Callable[[], int]
    ) -> None:
        """Watch the outputs of a vehicle.

        Args:
            name: name of the vehicle.
            time: virtual time of the flight.
            programs: description -> program that must run for the outputs to act.
            last_heard: returns when the vehicle last got a packet of an autopilot (ns).
        """
        self.name, self._time, self._programs, self._last_heard = name, time, programs, last_heard
        self._ran = dict.fromkeys(programs, time.now)
        self.longest_s: dict[str, float] = {}
        """Reason why the outputs should be safe -> longest time (s) for which they acted nevertheless."""

    def run(self, clock: VirtualClock, port: Path) -> None:
        """Apply the rows of a port, until the vehicle and its outputs have ended and the outputs are safe."""
        reader = OutputReader(port)
        safe = reader.safe_values
        while True:
            row, now = reader.row_to_apply(clock.monotonic_ns()), self._time.now
            self._ran |= {what: now for what, program in self._programs.items() if program.can_act(now)}
            if row.values != safe:
                self._note(now)
            elif all(program.has_ended for program in self._programs.values()):
                return
            clock.wait(None, PERIOD_S)

    def _note(self, now: int) -> None:
        since = {f"its {what} stopped": ran for what, ran in self._ran.items()}
        since[SILENCE] = self._last_heard()
        for what, start in since.items():
            self.longest_s[what] = max(self.longest_s.get(what, 0.0), (now - start) / NS_PER_SECOND)

    def list_violations(self, command_delay_s: float = 0.0) -> list[str]:
        """Return the violations: outputs that acted for too long.

        command_delay_s: delay of commands within the vehicle.
        """
        return [
            f"{self.name}: the outputs still acted {seconds * 1e3:.0f} ms after {what}"
            for what, seconds in self.longest_s.items()
            if seconds > (PROCESS_S if what != SILENCE else RADIO_S + TRANSIT_S + command_delay_s) + PERIOD_S
        ]


def longest_times(checks: Iterable[OutputsCheck]) -> dict[str, float]:
    """Return the longest time (s) for which outputs acted, by the reason why they should have been safe."""
    longest: dict[str, float] = {}
    for what, seconds in (item for check in checks for item in check.longest_s.items()):
        longest[what] = max(longest.get(what, 0.0), seconds)
    return longest

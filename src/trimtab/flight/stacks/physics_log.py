"""Logs and messages for the flights of a virtual vehicle that ArduPilot or PX4 flies. Each flight has its own log."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.core.record import Quantity
from trimtab.core.time import ms
from trimtab.flight.flight_log import FlightRecorder, close_flight_log, list_log_problems, open_flight_log
from trimtab.flight.stacks.pulsed_vehicle import PulsedVehicle
from trimtab.logs.stream import LogFileSummary
from trimtab.loop.scenario import Scenario

MOST_TOLD = 100
"""Maximum number of different messages to report, so that a flood of faulty packets cannot fill terminal and log."""


class PhysicsSummary(NamedTuple):
    """Result of all flights. t, release_time (None if the vehicle was never released), log and file belong to the last
    flight.

    tally: a dataclass that counts the received packets.
    """

    t: int
    release_time: int | None
    flights: int
    tally: Any
    log: LogFileSummary | None
    file: Path | None
    problems: tuple[str, ...]


class PhysicsFlights:
    """Record of all flights of a virtual vehicle: logs, messages and problems.

    summary: summary of the last log.  problems: problems of all logs, and problems passed to `add_problem`.
    """

    def __init__(
        self,
        scenario: Scenario,
        vehicle: PulsedVehicle,
        signals: Mapping[str, tuple[str, Quantity]],
        *,
        seed: int,
        file: Path | None = None,
        period: int = ms(1),
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """signals: declarations of the log signals in addition to the signals of the simulated world.

        file: path of the first flight's log, or None for no log. The log of the second flight is called NAME-2.
        period: time between log rows (100 ns).
        """
        self.scenario, self.vehicle, self.signals, self.seed = scenario, vehicle, signals, seed
        self.file, self.period, self.tell = file, period, tell
        self.count = 0
        self.problems, self._told = list[str](), set[str]()
        self._log: FlightRecorder | None = None
        self.summary: LogFileSummary | None = None

    def prepare(self, file: Path | None, tell: Callable[[str], None], period: int | None = None) -> None:
        """Prepare for the first flight.

        file: path of the first flight's log.  tell: function that receives the messages for the user.  period: time
        between log rows (100 ns).
        """
        self.file, self.tell, self.period = file, tell, self.period if period is None else period

    def begin(self, text: str) -> None:
        """Begin a new flight from the vehicle's initial state. text: message that announces the flight."""
        self.close()
        if self.count:
            self.vehicle.reset()
        self.count += 1
        sources = self.vehicle.body.log_sources()
        options: dict[str, Any] = {"side": "vehicle", "seed": self.seed, "log_period": self.period}
        self._log = open_flight_log(self.log_file(), sources, self.signals, self.scenario, **options)
        self.report(f"flight {self.count}: {text}")

    def log_file(self) -> Path | None:
        """Return the path of this flight's log."""
        if self.file is None or self.count == 1:
            return self.file
        return self.file.with_name(f"{self.file.stem}-{self.count}{self.file.suffix}")

    def write_row(self, t: int, values: Sequence[Any]) -> None:
        """Write the log row of the last instant before t, if a row is due. values: values of the signals in
        `signals`."""
        body = self.vehicle.body
        if self._log is None or not t or body.row_t % self.period:
            return
        self._log.await_room()
        self._log.write_row(body.row_t, tuple(values))

    def close(self, lost_lines: int = 0) -> None:
        """End the flight's log. lost_lines: number of lines for the user that were lost."""
        log, self._log = self._log, None
        if log is not None:
            self.summary = close_flight_log(log, lost_lines, self.vehicle.body.final_truth())
            self.problems += list_log_problems(log, self.summary)

    def report(self, text: str) -> None:
        """Report a line of text to the user and to the log."""
        self.tell(text)
        if self._log is not None:
            self._log.write_event(text)

    def report_once(self, text: str) -> None:
        """Report a line of text, unless the same line was already reported."""
        if text not in self._told and len(self._told) < MOST_TOLD:
            self._told.add(text)
            self.report(text)

    def add_problem(self, text: str) -> None:
        """Report a problem that ends the flight and sets the program's exit code to 1."""
        self.problems.append(text)
        self.report(text)

    def summarise(self, tally: Any) -> PhysicsSummary:
        """Return the result of all flights. tally: counts of the received packets."""
        vehicle, file = self.vehicle, self.log_file() if self.count else None
        problems = tuple(dict.fromkeys(self.problems))
        return PhysicsSummary(vehicle.body.t, vehicle.release_time, self.count, tally, self.summary, file, problems)

"""Signals logged each control period, and the summary of a flight.

Source: docs page, Fly.
"""

from collections.abc import Mapping
from typing import NamedTuple

from trimtab.core.record import Quantity
from trimtab.flight.flight_log import frame_signals
from trimtab.flight.real_time import Deadlines, RealTimeGrant
from trimtab.logs.stream import LogFileSummary

FLIGHT_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "loop.late": ("f8", Quantity("s", "Delay from the deadline to the wake-up.")),
    "loop.step": ("f8", Quantity("s", "Duration of the compiled step alone.")),
    "loop.overruns": ("i8", Quantity("1", "Periods so far whose work ended after the next deadline.", kind="count")),
    "loop.skipped": ("i8", Quantity("1", "Periods skipped so far.", kind="count")),
    "link.samples": ("i8", Quantity("1", "Samples received so far.", kind="count")),
    "link.overtaken": ("i8", Quantity("1", "Samples so far that arrived after a newer sample.", kind="count")),
    "link.backwards": ("i8", Quantity("1", "Samples so far of sensors with decreasing time stamps.", kind="count")),
    "link.implausible": (
        "i8",
        Quantity("1", "Samples so far whose time stamp was too far from the current time.", kind="count"),
    ),
    "link.silence": ("f8", Quantity("s", "Time since the last data from the vehicle.")),
    "link.offset": ("f8", Quantity("s", "The vehicle's clock minus the autopilot's clock.")),
    **frame_signals("link"),
    "link.connected": ("?", Quantity("1", "The transport of the link is connected.", kind="flag")),
    "vehicle.owned": ("?", Quantity("1", "The vehicle accepts this autopilot as its owner.", kind="flag")),
    "vehicle.armed": ("?", Quantity("1", "The vehicle reports that it is armed.", kind="flag")),
}
"""Signals of an autopilot's log, in addition to the inputs and outputs of its step."""


class LiveFlightSummary(NamedTuple):
    """Result of a flight. arming_time: time of the first report that the vehicle is armed (100 ns); None: never."""

    t: int
    arming_time: int | None
    grant: RealTimeGrant
    deadlines: Deadlines
    skipped: int
    """Number of control periods that were skipped."""
    log: LogFileSummary | None
    cause: str
    """Reason for an early end of the flight; empty for a normal end."""
    problems: tuple[str, ...]
    """Problems listed in the JSON report: an early end, a failsafe, a vehicle not armed at the end, a lost log."""

"""Signals that an autopilot logs in each control period, and the summary of a flight.

Source: docs page, Fly.
"""

from collections.abc import Mapping
from typing import NamedTuple

from trimtab.core.record import Quantity
from trimtab.flight.flight_log import frame_signals
from trimtab.flight.real_time import Deadlines, RealTimeGrant
from trimtab.logs.stream import LogFileSummary

FLIGHT_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "loop.late": ("f8", Quantity("s", "Delay from the deadline to the wake-up of the control loop.")),
    "loop.step": ("f8", Quantity("s", "Computing time of the compiled autopilot in this period.")),
    "loop.overruns": (
        "i8",
        Quantity(
            "1", "Number of control periods so far whose work ended after the start of the next period.", kind="count"
        ),
    ),
    "loop.skipped": ("i8", Quantity("1", "Number of control periods skipped so far.", kind="count")),
    "link.samples": ("i8", Quantity("1", "Number of sensor samples received so far.", kind="count")),
    "link.overtaken": (
        "i8",
        Quantity("1", "Number of samples so far that arrived after a newer sample of the same sensor.", kind="count"),
    ),
    "link.backwards": (
        "i8",
        Quantity(
            "1", "Number of samples so far that were rejected because the sensor's time stamps decreased.", kind="count"
        ),
    ),
    "link.implausible": (
        "i8",
        Quantity("1", "Number of samples so far whose time stamp was too far from the current time.", kind="count"),
    ),
    "link.silence": ("f8", Quantity("s", "Time since the last data from the vehicle.")),
    "link.offset": (
        "f8",
        Quantity("s", "Estimated time of the vehicle's clock minus the time of the autopilot's clock."),
    ),
    **frame_signals("link"),
    "link.connected": (
        "?",
        Quantity("1", "True while the transport of the link (e.g. UDP, serial) is connected.", kind="flag"),
    ),
    "vehicle.owned": ("?", Quantity("1", "True while the vehicle accepts this autopilot as its owner.", kind="flag")),
    "vehicle.armed": ("?", Quantity("1", "True while the vehicle reports that it is armed.", kind="flag")),
}
"""Signals of an autopilot's log, in addition to the inputs and outputs of the compiled autopilot."""


class LiveFlightSummary(NamedTuple):
    """Result of a flight. arming_time: time (100 ns) of the first report that the vehicle is armed, or None if the
    vehicle was never armed."""

    t: int
    arming_time: int | None
    grant: RealTimeGrant
    deadlines: Deadlines
    skipped: int
    """Number of control periods that were skipped because the loop was too late."""
    log: LogFileSummary | None
    cause: str
    """Reason for an early end of the flight; empty for a normal end."""
    problems: tuple[str, ...]
    """Problems listed in the JSON report: an early end, a failsafe, a vehicle not armed at the end, a lost log."""

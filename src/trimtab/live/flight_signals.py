"""What is told of a flight: what a row of its log has besides frame and outputs, and what became of it at its end.

Source: docs page, Fly.
"""

from collections.abc import Mapping
from typing import NamedTuple

from trimtab.core.record import Quantity
from trimtab.live.flight_log import frame_signals
from trimtab.live.real_time import Deadlines, RealTimeGrant
from trimtab.logs.stream import LogFileSummary

FLIGHT_SIGNALS: Mapping[str, tuple[str, Quantity]] = {
    "loop.late": ("f8", Quantity("s", "From the deadline to the wake-up.")),
    "loop.step": ("f8", Quantity("s", "The compiled step alone.")),
    "loop.overruns": ("i8", Quantity("1", "Periods so far whose work ended after the next deadline.", kind="count")),
    "loop.skipped": ("i8", Quantity("1", "Periods so far that were passed over.", kind="count")),
    "link.samples": ("i8", Quantity("1", "Samples heard so far.", kind="count")),
    "link.overtaken": ("i8", Quantity("1", "Samples so far that came after a later one.", kind="count")),
    "link.backwards": ("i8", Quantity("1", "Samples so far of sensors whose time runs backwards.", kind="count")),
    "link.implausible": ("i8", Quantity("1", "Samples so far whose times were not of now.", kind="count")),
    "link.silence": ("f8", Quantity("s", "Time since the vehicle was last heard.")),
    "link.offset": ("f8", Quantity("s", "The vehicle's clock minus this one.")),
    **frame_signals("link"),
    "link.connected": ("?", Quantity("1", "The transport has a connection.", kind="flag")),
    "vehicle.owned": ("?", Quantity("1", "The vehicle has taken this end for its owner.", kind="flag")),
    "vehicle.armed": ("?", Quantity("1", "The vehicle says that it is armed.", kind="flag")),
}
"""What a row of a flight's log has besides frame and outputs."""


class LiveFlightSummary(NamedTuple):
    """What became of a flight. arming_time: when the vehicle first said that it is armed (100 ns), None if never."""

    t: int
    arming_time: int | None
    grant: RealTimeGrant
    deadlines: Deadlines
    log: LogFileSummary | None
    cause: str
    """What ended it before its time; empty where nothing did."""
    problems: tuple[str, ...]
    """All that a script should know of: that, a failsafe, a vehicle that was not armed at the end, a lost log."""

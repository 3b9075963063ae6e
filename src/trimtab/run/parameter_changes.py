"""Changes of an autopilot's parameters in flight. The log contains an event for each change. A replay repeats them.

    parameter autopilot.law.k1[0] = 2.5 from 1.2340000 s

In an event, the value is written with all digits. The time is that of the first control step with the new value.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import with_leaf
from trimtab.core.time import UNITS_PER_SECOND
from trimtab.logs.log import Log

EVENT = re.compile(r"parameter autopilot\.(\S+)\[(\d+)\] = (\S+) from (\d+)\.(\d{7}) s")


class AutopilotChange(NamedTuple):
    """Change of one element of an autopilot's parameter.

    t: integer time from which on the new value is used.  path: path of the parameter, relative to the autopilot.  slot:
    index of the element in the flattened parameter.  value: new value.
    """

    t: int
    path: str
    slot: int
    value: float

    def __str__(self) -> str:
        whole, part = divmod(self.t, UNITS_PER_SECOND)
        return f"parameter autopilot.{self.path}[{self.slot}] = {self.value!r} from {whole}.{part:07} s"

    def put_into(self, parameters: Mapping[str, Any]) -> None:
        """Write the new value into the parameter arrays of a compiled step."""
        parameters[self.path].flat[self.slot] = self.value


def read_changes(log: Log) -> list[AutopilotChange]:
    """Return the parameter changes that the log of a flight contains, in the order of their times."""
    found = (EVENT.fullmatch(event["text"]) for event in log.metadata.get("events") or ())
    changes = [
        AutopilotChange(int(m[4]) * UNITS_PER_SECOND + int(m[5]), m[1], int(m[2]), float(m[3])) for m in found if m
    ]
    return sorted(changes, key=lambda change: change.t)


def with_changes(autopilot: Any, changes: Sequence[AutopilotChange]) -> Any:
    """Return a copy of an autopilot's parameters in which the changes have been made."""
    for change in changes:

        def set_number(old: Any, _declared: Any, change: AutopilotChange = change) -> Any:
            new = np.array(old)
            new.flat[change.slot] = change.value
            return new

        autopilot = with_leaf(autopilot, change.path, set_number)
    return autopilot

"""Settings that could disable a safety function. If a value is beyond its limit, the user must confirm the setting by
its name.

Source: docs page, Arming.
"""

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

from trimtab.actuators.failsafe import Failsafe
from trimtab.core.errors import InputError, argument
from trimtab.core.suggestions import closest
from trimtab.core.time import to_seconds
from trimtab.flight.station.arming import ArmingCheck
from trimtab.loop.vehicle_limits import VehicleLimits

WATCHDOG = "watchdog"


class SafetyLimit(NamedTuple):
    """Upper limit of a safety setting. A larger value needs the user's confirmation."""

    largest: float
    unit: str


LIMITS: Mapping[str, SafetyLimit] = {
    WATCHDOG: SafetyLimit(0.5, "s"),
    "failsafe.timeout": SafetyLimit(2.0, "s"),
    "failsafe.lift_delay": SafetyLimit(10.0, "s"),
    "failsafe.patience": SafetyLimit(60.0, "s"),
    "limits.patience": SafetyLimit(1.0, "s"),
    "limits.rest_speed": SafetyLimit(1.0, "m/s"),
    "limits.rest_rate": SafetyLimit(2.0, "rad/s"),
}
"""Upper limit of each safety setting. A larger time-out, or a larger speed that counts as rest, would disable a safety
function."""


def check_confirmations(names: Collection[str]) -> frozenset[str]:
    """Return the names of the confirmed settings. Raise InputError for a name that is not in LIMITS."""
    for name in names:
        if name not in LIMITS:
            near = closest(name, LIMITS, 1) or [WATCHDOG]
            problem = f"{name!r} is not a setting that needs a confirmation"
            raise InputError("confirm", problem, choices=LIMITS, fix=argument("confirm", near[0]))
    return frozenset(names)


def safety_checks(
    failsafe: Failsafe, limits: VehicleLimits, watchdog: int | None, confirmed: Collection[str] = ()
) -> list[ArmingCheck]:
    """Return a check for each safety setting. A confirmed setting passes with any value.

    Args:
        failsafe: failsafe of the vehicle.
        limits: fence, envelope, and limits of speed and turn rate at rest.
        watchdog: time (100 ns) without an output row after which the outputs become safe, or None without a process of
            the outputs.
        confirmed: names of the settings that the user has confirmed.
    """
    values = {
        WATCHDOG: math.nan if watchdog is None else to_seconds(watchdog),
        "failsafe.timeout": to_seconds(failsafe.timeout),
        "failsafe.lift_delay": to_seconds(failsafe.lift_delay),
        "failsafe.patience": to_seconds(failsafe.patience),
        "limits.patience": to_seconds(limits.patience),
        "limits.rest_speed": float(limits.rest_speed),
        "limits.rest_rate": float(limits.rest_rate),
    }
    checks = []
    for name, limit in LIMITS.items():
        remedy = "give a shorter --watchdog" if name == WATCHDOG else f"remove --set {name}"
        largest = math.inf if name in confirmed else limit.largest
        advice = f"{remedy}, or type --confirm {name}"
        checks.append(ArmingCheck(name, values[name], largest, limit.unit, advice, heals=False))
    return checks

"""Motion of a vehicle as measured by the vehicle's own sensors, to check its limits and whether it is at rest.

Source: docs page, Arming.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from trimtab.core.errors import InputError
from trimtab.core.time import SECONDS_PER_UNIT
from trimtab.flight.virtual_vehicle import VirtualVehicle
from trimtab.loop.vehicle_limits import NO_LIMIT, VehicleLimits

FENCE, ENVELOPE = "fence", "envelope"


class SensedQuantity(NamedTuple):
    """Quantity of a vehicle's motion, e.g. its speed. The value is the norm of a group of sensor fields.

    fields: possible groups of sensor fields, the preferred group first.
    """

    kind: str
    unit: str
    fields: Sequence[Sequence[str]]


QUANTITIES: Mapping[str, SensedQuantity] = {
    "distance": SensedQuantity(FENCE, "m", (("north", "east"),)),
    "speed": SensedQuantity(ENVELOPE, "m/s", (("surge_velocity", "sway_velocity"), ("speed",))),
    "rate": SensedQuantity(ENVELOPE, "rad/s", (("yaw_rate",), ("angular_rate",), ("pitch_rate",))),
    "angle": SensedQuantity(ENVELOPE, "rad", (("alpha",),)),
}


class Breach(NamedTuple):
    """Limit that the vehicle violates: kind of the limit (e.g. fence), and a description for the user."""

    kind: str
    text: str


class _SensedSlots(NamedTuple):
    sensor: str
    slots: list[Any]
    time: Any
    valid: Any


class SensedMotion:
    """Motion of a vehicle, computed from the newest samples of the vehicle's sensors."""

    def __init__(self, body: VirtualVehicle, limits: VehicleLimits) -> None:
        """Find a sensor for each quantity. Raise InputError if a limit is set for a quantity that no sensor
        measures."""
        self._outputs, self._limits = body.world.outputs, limits
        self._slots = {name: slots for name in QUANTITIES if (slots := _find_sensor(body, name)) is not None}
        self.bounds = {name: bound for name in QUANTITIES if (bound := float(getattr(limits, name))) < NO_LIMIT}
        for name in self.bounds:
            if name not in self._slots:
                problem = f"no sensor of this vehicle measures the {name}, for which a limit is set"
                fix = f"remove the limit; of the motion, the sensors measure {', '.join(self._slots) or 'nothing'}"
                raise InputError(f"limits.{name}", problem, choices=self._slots, fix=fix)
        self._outside_since: dict[str, int] = {}
        self._moments: deque[tuple[int, float, float]] = deque()

    def sensor(self, name: str) -> str:
        """Return the name of the sensor that measures a quantity, or "" if no sensor measures it."""
        return self._slots[name].sensor if name in self._slots else ""

    def value(self, name: str) -> float:
        """Return the newest value of a quantity, or NaN if no sensor has measured the quantity yet."""
        at = self._slots.get(name)
        if at is None or not self._outputs[at.valid]:
            return math.nan
        return math.hypot(*(x for s in at.slots for x in self._outputs[s].ravel().tolist()))

    def find_breach(self, t: int, silences: Mapping[str, float]) -> Breach | None:
        """Return the first limit that has been violated for longer than its delay or whose sensor sends no data, or
        None.

        silences: time without data (s) of each sensor that has sent no data for too long, by the sensor's name.
        """
        for name, bound in self.bounds.items():
            value, sensor, quantity = self.value(name), self.sensor(name), QUANTITIES[name]
            if sensor in silences:
                return Breach(quantity.kind, f"{name} not known, no data from {sensor} for {silences[sensor]:.3g} s")
            since = self._outside_since.setdefault(name, t) if not value <= bound else self._outside_since.pop(name, t)
            if not value <= bound and t - since >= self._limits.patience:
                return Breach(quantity.kind, f"{name} {value:.3g} {quantity.unit}, at most {bound:.3g}, by {sensor}")
        return None

    def note_moment(self, t: int) -> None:
        """Record the current motion, for `mean_motion`."""
        self._moments.append((t, self.value("speed"), self.value("rate")))
        while t - self._moments[0][0] > self._limits.rest_time:
            self._moments.popleft()

    def mean_motion(self) -> tuple[float, float]:
        """Return mean speed and mean turn rate over the last `rest_time`. Both are infinite while the record is shorter
        than this time.

        The mean of a quantity that no sensor measures is NaN.
        """
        if not self._moments:
            return math.inf, math.inf
        span = (self._moments[-1][0] - self._moments[0][0]) * SECONDS_PER_UNIT
        is_whole = span >= 0.9 * self._limits.rest_time * SECONDS_PER_UNIT
        means = []
        for name, k in (("speed", 1), ("rate", 2)):
            values = [moment[k] for moment in self._moments]
            means.append(math.nan if name not in self._slots else sum(values) / len(values) if is_whole else math.inf)
        return means[0], means[1]


def _find_sensor(body: VirtualVehicle, name: str) -> _SensedSlots | None:
    """Return the output indices of the fields of a quantity, for the first sensor that measures it, or None without
    such a sensor."""
    writes = body.world.writes
    for fields in QUANTITIES[name].fields:
        for sensor in body.samples:
            paths = [f"downlink.{sensor}.value.{field}" for field in fields]
            if all(p in writes for p in paths):
                time, valid = writes[f"downlink.{sensor}.t"], writes[f"downlink.{sensor}.valid"]
                return _SensedSlots(sensor, [writes[p] for p in paths], time, valid)
    return None

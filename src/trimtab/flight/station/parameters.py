"""Parameters of a vehicle for ground stations, with MAVLink's names of up to 16 characters and values of 32 bits.

The name of a parameter is made from its path: the initials of the leading names, then the last name, e.g. WV_MASS for
"world.vehicle.mass". The words of a long name are shortened. If two parameters would have the same name, or if the name
is still too long, it ends in five digits of a hash of the path. A list of parameters is sent at a limited rate, and
starts with a hash of all names and values. A station that already has this hash needs no list, and sets the parameter
_HASH_CHECK. A change is answered with the value that is then in use.
Source: https://mavlink.io/en/services/parameter.html (values as C casts); _HASH_CHECK as in PX4.
"""

import hashlib
import math
import re
import struct
import zlib
from collections import Counter, deque
from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.record import Quantity, leaves
from trimtab.core.time import seconds
from trimtab.flight.mavlink.definitions import Message, arrange_values
from trimtab.flight.mavlink.dialect import unique_name
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.protocol import REAL_32, ParameterChange

LONGEST = 16
MOST_NUMBERS = 64
"""Maximum number of elements of a quantity that is sent as parameters. Larger quantities are tables, whose transfer
would take minutes."""
FLOAT = struct.Struct("<f")
WORD = 4
"""Number of letters that remain of each word when a long name is shortened."""
HASH, UNSTATED, UNSIGNED_32, NO_INDEX = "_HASH_CHECK", 0, 5, 0xFFFF
PERIOD = seconds("0.02")
"""Time (100 ns) between two values of a parameter list."""
SMALLEST = 2.0**-126
"""Smallest normal 32-bit float. A smaller number is usually an integer whose bytes were sent as a float by mistake."""
LARGEST_FACTOR = 10.0
"""Factor by which a parameter without a declared bound may differ from its value at the start."""
FAULT = "fault"
"""Name in the path of a fault's parameters. These parameters are zero at the start, so no bounds are derived from their
start values."""


ChangedValues = Mapping[str, list[float]]
"""Values of each changed quantity (a number or an array with all elements), by path."""
NO_STORE = "no file (--parameters FILE)"


class Parameter(NamedTuple):
    """Parameter of a vehicle: MAVLink name, path of the quantity, index of the element in an array, and declaration of
    the quantity."""

    name: str
    path: str
    slot: int
    declaration: Quantity


class Parameters:
    """Parameters of a record, e.g. a scenario's world, in the order of declaration, accessible by name and by index."""

    def __init__(self, tree: Any, path: str = "", only: Container[str] | None = None) -> None:
        """Collect all quantities of the record `tree`, except tables. path: prefix of all paths.

        only: paths to include, or None to include all.
        """
        numbers = [
            (where, slot if np.shape(value) else None, declared, float(number))
            for where, value, declared in leaves(tree, path)
            if isinstance(declared, Quantity) and np.size(value) <= MOST_NUMBERS and (only is None or where in only)
            for slot, number in enumerate(np.ravel(np.asarray(value, float)))
        ]
        names = parameter_names([where if slot is None else f"{where}.{slot}" for where, slot, *_ in numbers])
        self.listed = tuple(Parameter(n, w, s or 0, d) for n, (w, s, d, _) in zip(names, numbers, strict=True))
        self.values = [value for *_, value in numbers]
        self.defaults = tuple(self.values)
        """Values of all parameters at the start."""
        self._changed = set[str]()
        self._index = {p.name: k for k, p in enumerate(self.listed)}
        self._places = {(p.path, p.slot): k for k, p in enumerate(self.listed)}

    def table(self) -> dict[str, tuple[str, int]]:
        """Return, for each parameter name, the path of the quantity and the index of the element in an array."""
        return {p.name: (p.path, p.slot) for p in self.listed}

    @property
    def digest(self) -> int:
        """Hash of all parameters: CRC-32, without inversions, of all names and values (4 bytes each), in the order of
        the names."""
        pairs = sorted(zip([p.name for p in self.listed], self.values, strict=True))
        data = b"".join(name.encode() + FLOAT.pack(round_to_float32(value)) for name, value in pairs)
        return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF

    def changed_values(self) -> ChangedValues:
        """Return the values of each quantity that has changed since the start, by path."""
        changed: dict[str, list[float]] = {path: [] for path in sorted(self._changed)}
        for own, value in zip(self.listed, self.values, strict=True):
            if own.path in changed:
                changed[own.path].append(value)
        return changed

    def find_index(self, name: str, index: int) -> int | None:
        """Return the index of a requested parameter, or None if the parameter does not exist. If the index is negative,
        the name selects the parameter."""
        if index < 0:
            return self._index.get(name)
        return index if index < len(self.listed) else None

    def index_of(self, path: str, slot: int) -> int | None:
        """Return the index of the parameter for the element `slot` of the quantity at `path`, or None if the element is
        not a parameter."""
        return self._places.get((path, slot))

    def bounds(self, index: int) -> tuple[float, float]:
        """Return the smallest and the largest value that a ground station may write.

        If a bound is declared, it is used. Otherwise the bound is derived from the parameter's value at the start. For
        a positive start value of a quantity that must not be negative, the upper bound is ten times this value; if it
        must be positive, the lower bound is a tenth. Other parameters may change by ten times the magnitude of this
        value, or by ten if the magnitude is below one.
        """
        own, start = self.listed[index], self.defaults[index]
        declared = own.declaration
        low = declared.low if declared.low is not None else declared.above
        if FAULT in own.path.split(".") or declared.modes or declared.kind == "flag":
            span = math.inf
        else:
            span = LARGEST_FACTOR * max(abs(start), 1.0)
        if low is not None and declared.high is None and start > max(low, 0.0) == 0.0:
            return (start / LARGEST_FACTOR if declared.above is not None else low), start * LARGEST_FACTOR
        low = start - span if low is None else low
        return low, start + span if declared.high is None else declared.high

    def change_value(self, index: int, value: float) -> str:
        """Set the value of a parameter if the declaration allows the value. Return the reason if the value is refused,
        or an empty string.

        If the new value is the old value rounded to a 32-bit float, the old value is kept with all digits.
        """
        if round_to_float32(self.values[index]) == value:
            return ""
        refusal = _refusal(self.listed[index].declaration, value, self.bounds(index))
        if not refusal:
            self.values[index] = value
            self._changed.add(self.listed[index].path)
        return refusal


def parameter_names(paths: Sequence[str]) -> list[str]:
    """Return a unique MAVLink parameter name for each path, in the order of the paths."""
    plain = [_short_name(path) for path in paths]
    counts, used_names = Counter(plain), set[str]()
    hashed = (name if counts[name] == 1 else _hash_name(path) for name, path in zip(plain, paths, strict=True))
    return [unique_name(name, used_names) for name in hashed]


def _short_name(path: str) -> str:
    *leading, own = re.sub(r"[^A-Za-z0-9_.]", "_", path).upper().split(".")
    if own.isdigit() and leading:
        own = f"{leading.pop()}_{own}"
    before = "".join(word[0] for part in leading for word in part.split("_") if word)[-6:]
    for name in (own, "_".join(word[:WORD] for word in own.split("_"))):
        whole = f"{before}_{name}" if before else name
        if len(whole) <= LONGEST:
            return whole
    return _hash_name(path)


def _hash_name(path: str) -> str:
    own = re.sub(r"[^A-Za-z0-9_]", "_", path.rpartition(".")[2]).upper()
    return f"{own[: LONGEST - 6]}_{hashlib.sha256(path.encode()).hexdigest()[:5].upper()}"


def round_to_float32(value: float) -> float:
    """Return a number rounded to a float of 32 bits."""
    try:
        return FLOAT.unpack(FLOAT.pack(value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)


def _refusal(declared: Quantity, value: float, bounds: tuple[float, float]) -> str:
    if not math.isfinite(value):
        return "is not a number"
    if 0 < abs(value) < SMALLEST:
        return "is smaller than any normal number of 32 bits: send the value as REAL32"
    if declared.kind not in ("real", "angle") and value != int(value):
        return "must be a whole number"
    if declared.kind == "flag" and value not in (0, 1):
        return "must be 0 or 1"
    if declared.modes and not 0 <= value < len(declared.modes):
        return f"must be from 0 to {len(declared.modes) - 1}"
    if declared.above is not None and not value > declared.above:
        return f"must be above {declared.above:g}"
    if declared.low is not None and value < declared.low:
        return f"must be at least {declared.low:g}"
    if declared.high is not None and value > declared.high:
        return f"must be at most {declared.high:g}"
    low, high = bounds
    if value < low:
        return f"must be at least {low:g} in flight; a restart with --set accepts smaller values"
    if value > high:
        return f"must be at most {high:g} in flight; a restart with --set accepts larger values"
    return ""


class ParameterService:
    """MAVLink service that sends and changes the parameters of one vehicle. Times are by the vehicle's clock, in 100
    ns."""

    def __init__(self, endpoint: Endpoint, parameters: Parameters) -> None:
        """Start without a requested list of parameters."""
        self._endpoint, self._parameters = endpoint, parameters
        self._listing: deque[int | None] = deque()
        self._sent_at: int | None = None

    def start_list(self) -> None:
        """Start to send the hash, then all parameters, at a limited rate. If the request is repeated, send only the
        parameters."""
        values = range(len(self._parameters.listed))
        self._listing = deque(values if self._listing else [None, *values])

    def due(self, now: int) -> list[bytes]:
        """Return a packet with the next parameter of the requested list if it is due, otherwise an empty list."""
        if not self._listing or (self._sent_at is not None and 0 <= now - self._sent_at < PERIOD):
            return []
        self._sent_at = now
        index = self._listing.popleft()
        return [self._hash_packet() if index is None else self.value(index)]

    def read(self, message: Message) -> list[bytes]:
        """Return the packet with the parameter that a PARAM_REQUEST_READ requests, or an empty list if the parameter
        does not exist."""
        if message.get("param_index") < 0 and message.get("param_id") == HASH:
            return [self._hash_packet()]
        index = self._parameters.find_index(message.get("param_id"), message.get("param_index"))
        return [] if index is None else [self.value(index)]

    def change_value(self, message: Message) -> tuple[list[bytes], list[ParameterChange], str]:
        """Handle a PARAM_SET message.

        Return the packet with the value in use, the changes (at most one), and the reason if the value is refused, or
        "".
        """
        name = message.get("param_id")
        if name == HASH:  # the station has all values
            self._listing.clear()
            return [], [], ""
        index = self._parameters.find_index(name, -1)
        if index is None:
            return [], [], f"no parameter {name!r}"
        own, before = self._parameters.listed[index], self._parameters.values[index]
        kind = message.get("param_type")
        if kind in (UNSTATED, REAL_32):
            refusal = self._parameters.change_value(index, message.get("param_value"))
        else:
            refusal = f"must be sent as REAL32 (type {REAL_32}), got type {kind}"
        value = self._parameters.values[index]
        events = [ParameterChange(own.path, own.slot, value)] if value != before else []
        return [self.value(index)], events, f"{name} ({own.path}) {refusal}" if refusal else ""

    def _hash_packet(self) -> bytes:
        definition = self._endpoint.dialect.definitions["PARAM_VALUE"]
        fields = {"param_id": HASH, "param_type": UNSIGNED_32, "param_index": NO_INDEX}
        fields |= {"param_count": len(self._parameters.listed)}
        payload = definition.packing.pack(*arrange_values(definition, fields))
        bits = self._parameters.digest.to_bytes(FLOAT.size, "little")
        return self._endpoint.pack("PARAM_VALUE", bits + payload[len(bits) :])  # the value is the first field

    def value(self, index: int) -> bytes:
        """Return the packet with the value of the parameter that has this index."""
        own = self._parameters.listed[index]
        fields = {"param_id": own.name, "param_value": self._parameters.values[index], "param_type": REAL_32}
        fields |= {"param_count": len(self._parameters.listed), "param_index": index}
        return self._endpoint.pack("PARAM_VALUE", fields)

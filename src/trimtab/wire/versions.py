"""The fields of AUTOPILOT_VERSION. Source: https://mavlink.io/en/messages/common.html."""

import re
from typing import Any

from trimtab import __version__
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.protocol import Capability


def version_fields(endpoint: Endpoint) -> dict[str, Any]:
    """What an end can do, trimtab's version, and the fingerprint of its dialect."""
    numbers = [min(int(n), 255) for n in re.findall(r"\d+", f"{__version__}.0.0")[:3]]
    return {
        "capabilities": Capability.COMMAND_INT | Capability.MAVLINK2 | Capability.PARAMETERS_AS_FLOAT,
        "flight_sw_version": int.from_bytes(bytes([*numbers, 0])),
        "flight_custom_version": endpoint.dialect.fingerprint,
        "uid": endpoint.system,
    }

"""File for ground stations that describes the parameters: unit, meaning, bounds, default, names of modes.

The message COMPONENT_METADATA contains the path of a general file, which contains the path of the parameters' file.
Ground stations read both files by MAVLink's file transfer.
Source: https://mavlink.io/en/services/component_information.html.
"""

import json
import lzma
import math
import zlib
from collections.abc import Mapping
from typing import Any

from trimtab.flight.station.parameters import Parameter, Parameters

GENERAL, PARAMETERS = "general.json.xz", "parameters.json.xz"
PARAMETER_TYPE = 1
"""Code of the metadata type for parameters: MAVLink's COMP_METADATA_TYPE_PARAMETER."""
LONGEST_SHORT = 100
GROUP_DEPTH = 2


def metadata_documents(parameters: Parameters) -> dict[str, bytes]:
    """Return the contents of the general file and of the parameters' file, by file name."""
    listed = [
        _describe(p, default, parameters.bounds(k))
        for k, (p, default) in enumerate(zip(parameters.listed, parameters.defaults, strict=True))
    ]
    own = _compress({"version": 1, "parameters": listed})
    types = [{"type": PARAMETER_TYPE, "uri": f"mftp:///{PARAMETERS}", "fileCrc": file_checksum(own)}]
    return {GENERAL: _compress({"version": 1, "metadataTypes": types}), PARAMETERS: own}


def component_metadata(now_ms: int, documents: Mapping[str, bytes]) -> Mapping[str, Any]:
    """Return the fields of the message COMPONENT_METADATA."""
    crc = file_checksum(documents[GENERAL])
    return {"time_boot_ms": now_ms, "file_crc": crc, "uri": f"mftp:///{GENERAL}"}


def file_checksum(data: bytes) -> int:
    """Return the CRC-32 that MAVLink uses for files: without inversion at the start and the end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _describe(parameter: Parameter, default: float, bounds: tuple[float, float]) -> dict[str, Any]:
    declared = parameter.declaration
    about: dict[str, Any] = {
        "name": parameter.name,
        "type": "Float",
        "shortDesc": declared.doc[:LONGEST_SHORT],
        "longDesc": f"{parameter.path}, number {parameter.slot}: {declared.doc}",
        "group": ".".join(parameter.path.split(".")[:GROUP_DEPTH]),
        "default": default,
    }
    if declared.unit != "1":
        about["units"] = declared.unit
    about |= {name: bound for name, bound in zip(("min", "max"), bounds, strict=True) if math.isfinite(bound)}
    if declared.modes:
        about |= {"min": 0, "max": len(declared.modes) - 1}
        about["values"] = [{"value": k, "description": name} for k, name in enumerate(declared.modes)]
    if declared.kind == "flag":
        about |= {"min": 0, "max": 1}
    if declared.kind not in ("real", "angle"):
        about |= {"decimalPlaces": 0, "increment": 1}
    return about


def _compress(content: Mapping[str, Any]) -> bytes:
    return lzma.compress(json.dumps(content, separators=(",", ":")).encode())

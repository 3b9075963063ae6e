"""Which topic of a log file carries which signals, and the JSON Schema of each topic's messages.

Source: JSON Schema, draft 2020-12; of it what Foxglove reads: one type a property, enumerations as oneOf of const.
"""

from typing import Any

import numpy as np

from trimtab.core.record import Quantity
from trimtab.logs.log import Log

Fields = dict[str, tuple[str, ...]]
"""Path of a signal -> the keys that lead to it in a message."""
GROUPED = ("sensors", "downlink")
"""Blocks of which there are several: each has a topic of its own."""
NOTE = "One message an instant. In numbers null stands for NaN, 1e999 for infinity."


def topics_of(paths: tuple[str, ...]) -> dict[str, Fields]:
    """Topic -> path -> the keys that lead to the value in a message."""
    found: dict[str, Fields] = {}
    for path in paths:
        names = path.split(".")
        split = 2 if names[0] in GROUPED and len(names) > 2 else 1
        found.setdefault("/" + "/".join(names[:split]), {})[path] = tuple(names[split:])
    return found


def schema_of(log: Log, topic: str, fields: Fields) -> dict[str, Any]:
    """The JSON Schema of a topic: each property with its type, unit, meaning and, for a mode, the names."""
    title = f"trimtab{topic.replace('/', '.')}"
    root: dict[str, Any] = {"title": title, "description": NOTE, "type": "object", "properties": {}}
    for path, keys in fields.items():
        node = root
        for key in keys[:-1]:
            node = node["properties"].setdefault(key, {"type": "object", "properties": {}})
        node["properties"][keys[-1]] = _property(log.signals[path], log.declared.get(path))
    return root


def _property(values: np.ndarray, declared: Quantity | None) -> dict[str, Any]:
    """One type each: viewers refuse a schema with a union such as number or null."""
    kind = {"b": "boolean", "f": "number"}.get(values.dtype.kind, "integer")
    found: dict[str, Any] = {"type": kind}
    if values.ndim == 2:
        size = values.shape[1]
        found = {"type": "array", "items": {"type": kind}, "minItems": size, "maxItems": size}
    if declared is None:
        return found
    about = declared.doc + (f" [{declared.unit}]" if declared.unit != "1" else "")
    about += f" In {declared.frame}." if declared.frame else ""
    if declared.modes:
        about += " " + ", ".join(f"{i}: {mode}" for i, mode in enumerate(declared.modes)) + "."
        if kind == "integer" and values.ndim == 1:
            found["oneOf"] = [{"title": mode, "const": i} for i, mode in enumerate(declared.modes)]
    found |= {"description": about, "unit": declared.unit}
    return found | ({"frame": declared.frame} if declared.frame else {})

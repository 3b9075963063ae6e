"""JSON content of a log file: topics with their signals, JSON Schemas, and one message for each log row.

Numbers are stored exactly. A float is written as the shortest JSON text from which the same float is read. Infinity is
written as ``1e999`` or ``-1e999``, which is valid JSON and is read as infinity. NaN is written as ``null``.

Source: JSON Schema, draft 2020-12, as far as Foxglove reads it: one type per property, enumerations as oneOf of const.
"""

import dataclasses
import json
import math
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log, to_plain

Fields = dict[str, tuple[str, ...]]
"""Path of a signal -> keys under which the signal's value is nested in a message."""
GROUPED = ("sensors", "downlink")
"""Blocks of the loop with several members, e.g. sensors. Each member has a separate topic in the log file."""
NOTE = "One message an instant. In numbers null stands for NaN, 1e999 for infinity."
RUN, LAYOUT, FORMAT = "trimtab", "trimtab.layout", "1"
"""Name of the metadata record of the run, name of the metadata record of the signals, and version of the log's
format."""
CLOCK, EPOCH = "trimtab.clock", "epoch_ns"
"""Name of the metadata record with the time of day at time zero (ns since 1970), and key of that time."""
EVENTS = "/events"
"""Topic of text events with their times. Foxglove shows messages with this topic's schema as a text log."""
EVENT_SCHEMA = {
    "title": "foxglove.Log",
    "type": "object",
    "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "level": {"type": "integer"},
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
    },
}
NS_PER_TICK = 100
NS_PER_SECOND = 1_000_000_000


class Topic(NamedTuple):
    """Topic of a log file.

    fields: signals of the topic.  schema: name of the message schema.  text: JSON text of the schema.
    """

    name: str
    fields: Fields
    schema: str
    text: bytes


def group_by_topic(paths: tuple[str, ...]) -> dict[str, Fields]:
    """Return the topic -> signals of the topic.

    The signals are a dictionary: path of a signal -> keys under which the signal's value is nested in a message.
    """
    topics: dict[str, Fields] = {}
    for path in paths:
        names = path.split(".")
        split = 2 if names[0] in GROUPED and len(names) > 2 else 1
        topics.setdefault("/" + "/".join(names[:split]), {})[path] = tuple(names[split:])
    return topics


def topic_schema(log: Log, topic: str, fields: Fields) -> dict[str, Any]:
    """Return the JSON Schema of a topic.

    Each property has type, unit and meaning. A property that is a mode also has the names of the modes.
    """
    title = f"trimtab{topic.replace('/', '.')}"
    root: dict[str, Any] = {"title": title, "description": NOTE, "type": "object", "properties": {}}
    for path, keys in fields.items():
        node = root
        for key in keys[:-1]:
            node = node["properties"].setdefault(key, {"type": "object", "properties": {}})
        node["properties"][keys[-1]] = _property_schema(log.signals[path], log.declarations.get(path))
    return root


def _property_schema(values: np.ndarray, declared: Quantity | None) -> dict[str, Any]:
    """Return the schema of a property. It has a single type, because viewers reject unions such as number or null."""
    kind = {"b": "boolean", "f": "number"}.get(values.dtype.kind, "integer")
    schema: dict[str, Any] = {"type": kind}
    if values.ndim == 2:
        size = values.shape[1]
        schema = {"type": "array", "items": {"type": kind}, "minItems": size, "maxItems": size}
    if declared is None:
        return schema
    about = declared.doc + (f" [{declared.unit}]" if declared.unit != "1" else "")
    about += f" In {declared.frame}." if declared.frame else ""
    if declared.modes:
        about += " " + ", ".join(f"{i}: {mode}" for i, mode in enumerate(declared.modes)) + "."
        if kind == "integer" and values.ndim == 1:
            schema["oneOf"] = [{"title": mode, "const": i} for i, mode in enumerate(declared.modes)]
    schema |= {"description": about, "unit": declared.unit}
    return schema | ({"frame": declared.frame} if declared.frame else {})


def log_topics(log: Log) -> list[Topic]:
    """Return the topics of a log, in the order in which its messages are written."""
    topics = []
    for name, fields in group_by_topic(log.paths).items():
        schema = topic_schema(log, name, fields)
        topics.append(Topic(name, fields, schema["title"], json.dumps(schema, ensure_ascii=False).encode()))
    return topics


def run_record(log: Log) -> dict[str, str]:
    """Return the metadata record of a run, in which each value is JSON text."""
    return {key: dump_json(value) for key, value in log.metadata.items()}


def layout_record(log: Log) -> dict[str, str]:
    """Return the metadata record of the signals: types, shapes, declarations, last values and number of instants."""
    signals = {p: {"dtype": a.dtype.str, "shape": list(a.shape[1:])} for p, a in log.signals.items()}
    final = {p: {"dtype": np.asarray(v).dtype.str, "value": to_plain(p, v)} for p, v in log.final.items()}
    declared = {p: to_plain(p, dataclasses.asdict(d)) for p, d in log.declarations.items()}
    parts = {"rows": len(log), "signals": signals, "declared": declared, "final": final}
    return {"format": FORMAT, **{name: dump_json(part) for name, part in parts.items()}}


def message_texts(log: Log, fields: Fields, rows: slice) -> list[bytes]:
    """Return the messages of a topic, one for each row of a log.

    The texts of the numbers are inserted into a template. This is much faster than json.dumps, also because a constant
    number is converted only once.
    """
    columns: list[list[str]] = []
    template = _template(_tree(log, fields), rows, columns)
    return [(template % row).encode() for row in zip(*columns, strict=True)]


def event_text(time: int, text: str) -> bytes:
    """Return the message of a text event at a time (ns)."""
    sec, nsec = divmod(time, NS_PER_SECOND)
    about = {"timestamp": {"sec": sec, "nsec": nsec}, "level": 2, "message": text, "name": "trimtab"}
    return json.dumps(about | {"file": "", "line": 0}, ensure_ascii=False).encode()


def dump_json(value: Any) -> str:
    """Return the JSON text of a value. A number that is not finite is written as e.g. {"$float": "nan"}."""
    return json.dumps(_mark_non_finite(value), allow_nan=False, ensure_ascii=False)


def load_json(text: str) -> Any:
    """Parse a JSON text from `dump_json`."""
    return json.loads(text, object_hook=lambda d: float(d["$float"]) if d.keys() == {"$float"} else d)


def parse_quantity(fields: dict[str, Any]) -> Quantity:
    """Return the declaration of a signal, made from the fields in the metadata record of the signals."""
    plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    return Quantity(**plain)


def signal_values(messages: list[Any], keys: tuple[str, ...]) -> list[Any]:
    """Return the values of a signal, read from the decoded messages of the signal's topic."""
    for key in keys:
        messages = [message[key] for message in messages]
    return messages


def _mark_non_finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return {"$float": str(value)}
    if isinstance(value, dict):
        return {k: _mark_non_finite(v) for k, v in value.items()}
    return [_mark_non_finite(v) for v in value] if isinstance(value, list) else value


def _tree(log: Log, fields: Fields) -> dict[str, Any]:
    """Return the arrays of a topic's signals, in dictionaries nested like the topic's messages."""
    root: dict[str, Any] = {}
    for path, keys in fields.items():
        node = root
        for key in keys[:-1]:
            node = node.setdefault(key, {})
        node[keys[-1]] = log.signals[path]
    return root


def _template(node: Any, rows: slice, columns: list[list[str]]) -> str:
    """Return a template: the JSON text of a message with %s in place of each number.

    The texts of the numbers are appended to `columns`.
    """
    if isinstance(node, dict):
        inner = (json.dumps(k).replace("%", "%%") + ":" + _template(v, rows, columns) for k, v in node.items())
        return "{" + ",".join(inner) + "}"
    if node.ndim == 1:
        columns.append(_texts(node[rows]))
        return "%s"
    columns.extend(_texts(column) for column in node[rows].T)
    return "[" + ",".join(["%s"] * node.shape[1]) + "]"


def _texts(column: np.ndarray) -> list[str]:
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    if column.dtype.kind != "f":
        return list(map(repr, column.tolist()))
    bits = np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}")
    new = np.flatnonzero(np.diff(bits, prepend=~bits[:1]))
    different = column[new]
    texts = list(map(repr, different.tolist()))
    for i in np.flatnonzero(~np.isfinite(different)).tolist():
        texts[i] = "null" if np.isnan(different[i]) else "1e999" if different[i] > 0 else "-1e999"
    if len(new) == len(column):
        return texts
    counts = np.diff(new, append=len(column)).tolist()
    return [text for text, count in zip(texts, counts, strict=True) for _ in range(count)]

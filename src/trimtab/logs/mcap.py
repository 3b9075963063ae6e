"""Logs as MCAP files, which Foxglove and the mcap command line tool open as they are.

One topic per block, JSON messages, schemas from the declared quantities. This module is the only one here that touches
files; a file appears whole or not at all. Numbers survive exactly: JSON texts of floats are the shortest that read back
to the same bits, infinities are ``1e999`` and ``-1e999`` (valid JSON, read as infinite everywhere), NaN is ``null``.

Source: MCAP format specification 0 (mcap.dev/spec), well-known encodings "json" and "jsonschema".
"""

import dataclasses
import json
import math
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import Quantity
from trimtab.core.time import to_seconds
from trimtab.logs.log import Log, plain
from trimtab.logs.schema import Fields, schema_of, topics_of

if TYPE_CHECKING:  # the library is imported when a file is read or written, not by who only draws
    from mcap.writer import Writer

RUN, LAYOUT, FORMAT = "trimtab", "trimtab.layout", "1"
"""Names of the two metadata records, and the version of what this module writes."""
MAGIC = b"\x89MCAP0\r\n"
"""At both ends of a file."""
NS_PER_TICK = 100
CHUNK_BYTES = 64 * 1024
"""Uncompressed; a file that is cut short loses the chunk at the cut."""
BLOCK_ROWS = 4096
"""How many rows are turned to text at a time."""


def write_mcap(log: Log, path: str | os.PathLike[str]) -> Path:
    """Write a log; the file appears whole or not at all. Returns its path."""
    from mcap.writer import CompressionType, Writer

    with replacing(path) as stream:
        writer = Writer(stream, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(library="trimtab")
        writer.add_metadata(RUN, {key: _dump(value) for key, value in log.metadata.items()})
        writer.add_metadata(LAYOUT, _layout(log))
        channels: list[tuple[int, dict[str, Any]]] = []
        for topic, fields in topics_of(log.paths).items():
            schema = schema_of(log, topic, fields)
            text = json.dumps(schema, ensure_ascii=False).encode()
            schema_id = writer.register_schema(schema["title"], "jsonschema", text)
            channels.append((writer.register_channel(topic, "json", schema_id), _tree(log, fields)))
        for first in range(0, len(log), BLOCK_ROWS):
            _write_rows(writer, log, channels, slice(first, first + BLOCK_ROWS))
        writer.finish()
    return Path(path)


def read_mcap(path: str | os.PathLike[str]) -> Log:
    """Read a log back, exactly as it was written.

    A file that was cut short (a full disk, a copy that broke off) gives the instants before the cut, and
    ``metadata["truncated"]`` is True; `final` is still that of the whole run.
    """
    data = _bytes(Path(path))
    found, cut = _scan(path, data)
    if LAYOUT not in found.metadata or RUN not in found.metadata:
        problem = "is cut before its first sample" if cut else "is an MCAP file, but not a log of trimtab"
        raise InputError(f"log file '{path}'", problem, fix="give a file that write_mcap or trimtab run wrote")
    written = found.metadata[LAYOUT].get("format")
    if written != FORMAT:
        problem = f"has format {written}, this version reads {FORMAT}"
        raise InputError(f"log file '{path}'", problem, fix="read it with the version of trimtab that wrote it")
    try:
        return _log(found, cut)
    except Exception as error:  # whatever a foreign tool has changed, the answer names the file
        problem = f"is damaged: {getattr(error, 'problem', error)}"
        raise InputError(f"log file '{path}'", problem, fix="make it again") from None


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """A stream to a file that takes its name when all is written; after an error any old file is still there."""
    target = Path(path)
    beside = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        with open(beside, "xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(beside, target)
    except OSError as error:
        fix = "choose another path" if target.parent.is_dir() else f"make the folder first: mkdir -p '{target.parent}'"
        raise InputError(f"file '{target}'", f"cannot be written: {error.strerror or error}", fix=fix) from error
    finally:
        if target.parent.is_dir():
            beside.unlink(missing_ok=True)


def _layout(log: Log) -> dict[str, str]:
    signals = {p: {"dtype": a.dtype.str, "shape": list(a.shape[1:])} for p, a in log.signals.items()}
    final = {p: {"dtype": np.asarray(v).dtype.str, "value": plain(p, v)} for p, v in log.final.items()}
    declared = {p: plain(p, dataclasses.asdict(d)) for p, d in log.declared.items()}
    parts = {"rows": len(log), "signals": signals, "declared": declared, "final": final}
    return {"format": FORMAT, **{name: _dump(part) for name, part in parts.items()}}


def _dump(value: Any) -> str:
    return json.dumps(_mark(value), allow_nan=False, ensure_ascii=False)


def _mark(value: Any) -> Any:
    """Free-form values: a number that JSON lacks becomes {"$float": "nan"}, so that it is told from None."""
    if isinstance(value, float) and not math.isfinite(value):
        return {"$float": str(value)}
    if isinstance(value, dict):
        return {k: _mark(v) for k, v in value.items()}
    return [_mark(v) for v in value] if isinstance(value, list) else value


def _tree(log: Log, fields: Fields) -> dict[str, Any]:
    """The arrays of a topic, nested as its messages are."""
    root: dict[str, Any] = {}
    for path, keys in fields.items():
        node = root
        for key in keys[:-1]:
            node = node.setdefault(key, {})
        node[keys[-1]] = log.signals[path]
    return root


def _write_rows(writer: "Writer", log: Log, channels: list[tuple[int, dict[str, Any]]], rows: slice) -> None:
    """Messages are one template a topic, filled with the ready texts of the numbers: much faster than json.dumps."""
    texts: list[tuple[int, list[bytes]]] = []
    for channel, tree in channels:
        columns: list[list[str]] = []
        template = _template(tree, rows, columns)
        texts.append((channel, [(template % row).encode() for row in zip(*columns, strict=True)]))
    add = writer.add_message
    for i, time in enumerate((log.ticks[rows] * NS_PER_TICK).tolist()):
        for channel, messages in texts:
            add(channel, time, messages[i], time, rows.start + i)


def _template(node: Any, rows: slice, columns: list[list[str]]) -> str:
    """The JSON text of a node with %s for each number, whose texts are appended to columns in the same order."""
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
    texts = list(map(repr, column.tolist()))
    if column.dtype.kind == "f":
        for i in np.flatnonzero(~np.isfinite(column)).tolist():
            texts[i] = "null" if np.isnan(column[i]) else "1e999" if column[i] > 0 else "-1e999"
    return texts


@dataclasses.dataclass
class _Contents:
    """What a file holds: metadata records by name, and times (ns) and texts of the messages by topic."""

    metadata: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    times: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    texts: dict[str, list[bytes]] = dataclasses.field(default_factory=dict)


def _bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        fix = "check the path; trimtab run SCENARIO --out DIR  writes one, DIR/run.mcap"
        raise InputError(f"log file '{path}'", problem, fix=fix) from None
    if not data.startswith(MAGIC):
        raise InputError(f"log file '{path}'", "is not an MCAP file", fix="give a file that write_mcap wrote")
    return data


def _scan(path: Any, data: bytes) -> tuple[_Contents, bool]:
    """Everything up to the end or to the cut, and whether there was a cut."""
    from mcap.records import Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    found, channels = _Contents(), dict[int, str]()
    cut = len(data) < 2 * len(MAGIC) or not data.endswith(MAGIC)
    try:
        for item in StreamReader(BytesIO(data), validate_crcs=True, record_size_limit=len(data)).records:
            if isinstance(item, Message):
                topic = channels[item.channel_id]
                found.times[topic].append(item.log_time)
                found.texts[topic].append(item.data)
            elif isinstance(item, Channel) and item.id not in channels:
                channels[item.id] = item.topic
                found.times[item.topic], found.texts[item.topic] = [], []
            elif isinstance(item, Metadata):
                found.metadata[item.name] = item.metadata
    except Exception as error:  # the library lets the errors of its decoders through
        if not cut:
            problem = f"is damaged: {error or type(error).__name__}"
            raise InputError(f"log file '{path}'", problem, fix="make it again, or copy it again") from None
    return found, cut


def _log(found: _Contents, cut: bool) -> Log:
    layout = found.metadata[LAYOUT]
    signals, declared, final = (_load(layout[name]) for name in ("signals", "declared", "final"))
    metadata = {key: _load(text) for key, text in found.metadata[RUN].items()}
    topics = topics_of(tuple(signals))
    if found.texts:  # a tool may have taken topics out
        topics = {topic: fields for topic, fields in topics.items() if topic in found.texts}
    rows = min(len(found.texts.get(topic, ())) for topic in topics)
    if cut or rows < _load(layout["rows"]):
        metadata["truncated"] = True
    arrays: dict[str, np.ndarray] = {}
    for topic, fields in topics.items():
        messages = json.loads(b"[" + b",".join(found.texts.get(topic, [])[:rows]) + b"]")
        for path, keys in fields.items():
            dtype, shape = np.dtype(signals[path]["dtype"]), signals[path]["shape"]
            arrays[path] = np.array(_column(messages, keys), dtype).reshape(rows, *shape)
    ticks = np.array(found.times.get(next(iter(topics)), [])[:rows], np.int64) // NS_PER_TICK
    return Log(
        t=to_seconds(ticks),
        ticks=ticks,
        signals={path: arrays[path] for path in signals if path in arrays},
        declared={path: _quantity(d) for path, d in declared.items()},
        metadata=metadata,
        final={path: np.array(v["value"], v["dtype"])[()] for path, v in final.items()},
    )


def _column(messages: list[Any], keys: tuple[str, ...]) -> list[Any]:
    for key in keys:
        messages = [message[key] for message in messages]
    return messages


def _quantity(fields: dict[str, Any]) -> Quantity:
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    return Quantity(**given)


def _load(text: str) -> Any:
    return json.loads(text, object_hook=lambda d: float(d["$float"]) if d.keys() == {"$float"} else d)

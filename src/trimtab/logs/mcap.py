"""Logs as MCAP files, which Foxglove and the mcap command line tool open directly.

Each block of the loop has a topic with JSON messages. The schemas of the messages are made from the declarations of the
signals. This module reads complete logs, and writes complete logs atomically. `logs.stream` writes logs during a
flight.

Source: MCAP format specification 0 (mcap.dev/spec), well-known encodings "json" and "jsonschema".
"""

import io
import json
import os
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from trimtab.core.errors import InputError, command
from trimtab.core.explain_call import explain_call
from trimtab.core.time import SECONDS_PER_UNIT, to_seconds
from trimtab.core.user_file import read_user_bytes
from trimtab.logs.contents import MAGIC, Contents, parse_contents
from trimtab.logs.frames import FrameWriter, frame_topics
from trimtab.logs.gaps import describe_gaps, join_by_time
from trimtab.logs.log import Log
from trimtab.logs.messages import (
    CLOCK,
    EPOCH,
    EVENTS,
    FORMAT,
    LAYOUT,
    NS_PER_TICK,
    RUN,
    Fields,
    group_by_topic,
    layout_record,
    load_json,
    log_topics,
    message_texts,
    parse_quantity,
    run_record,
    signal_values,
)
from trimtab.logs.spatial import spatial_poses

if TYPE_CHECKING:  # the library is imported only where a file is read or written
    from mcap.writer import Writer

CHUNK_BYTES = 64 * 1024
"""Size (bytes) of a chunk before compression. A truncated file may lose its last chunk."""
VEHICLE = "vehicle"
"""Name of the vehicle's frame in the pose messages of a log."""
BLOCK_ROWS = 4096
"""Number of rows that are converted to text at a time."""
SAMPLE_ROWS, SAMPLES = 250, 4
"""Number of consecutive rows in a sample, and number of samples, from which the size of a log file is estimated."""


@explain_call()
def write_mcap(log: Log, path: str | os.PathLike[str]) -> Path:
    """Write a log to an MCAP file atomically, and return the path of the file.

    >>> import tempfile
    >>> from trimtab import simulate, write_log
    >>> write_log(simulate("hovercraft/spin", duration="100 ms"), f"{tempfile.mkdtemp()}/run.mcap").name
    'run.mcap'

    For a vehicle that moves in three dimensions, poses for maps and 3-D scenes are written too, see `logs.frames`.
    """
    with replace_file(path) as stream:
        _write_blocks(log, stream, [slice(first, first + BLOCK_ROWS) for first in range(0, len(log), BLOCK_ROWS)])
    return Path(path)


def estimate_size(log: Log) -> int:
    """Estimate the size (bytes) of a log's file before it is written, from a few of the log's rows.

    The rows are taken from all parts of the flight, because rows at rest compress better than rows in motion.
    """
    few = min(SAMPLE_ROWS, len(log))
    starts = np.linspace(0, len(log) - few, SAMPLES).astype(int).tolist()
    head, both = io.BytesIO(), io.BytesIO()
    _write_blocks(log, head, ())
    _write_blocks(log, both, [slice(first, first + few) for first in starts])
    a_row = (both.tell() - head.tell()) / max(SAMPLES * few, 1)
    return round(head.tell() + a_row * len(log))


def _write_blocks(log: Log, stream: IO[bytes], blocks: Iterable[slice]) -> None:
    """Write the given blocks of rows of a log as a file to a stream."""
    from mcap.writer import CompressionType, Writer

    writer = Writer(stream, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(library="trimtab")
    writer.add_metadata(RUN, run_record(log))
    writer.add_metadata(LAYOUT, layout_record(log))
    channels: list[tuple[int, Fields]] = []
    for topic in log_topics(log):
        schema_id = writer.register_schema(topic.schema, "jsonschema", topic.text)
        channels.append((writer.register_channel(topic.name, "json", schema_id), topic.fields))
    poses, frames, frame_channels = spatial_poses(log), FrameWriter(VEHICLE), list[int]()
    for topic in frame_topics() if poses is not None else ():
        schema_id = writer.register_schema(topic.schema, "jsonschema", topic.text)
        frame_channels.append(writer.register_channel(topic.name, "json", schema_id))
    for rows in blocks:
        _write_rows(writer, log, channels, rows)
        for message in () if poses is None else frames.messages(log.ticks[rows], poses[rows], 0):
            writer.add_message(frame_channels[message.topic], message.time, message.text, message.time)
    writer.finish()


@explain_call()
def read_mcap(path: str | os.PathLike[str]) -> Log:
    """Read a log from an MCAP file. The log of a complete, undamaged file equals the log that was written.

    >>> import tempfile
    >>> from trimtab import read_log, simulate, write_log
    >>> log = simulate("hovercraft/spin", duration="100 ms")
    >>> read_log(write_log(log, f"{tempfile.mkdtemp()}/run.mcap")).paths == log.paths
    True

    The messages of all topics with the same time form a row. A row with a missing message, or in a damaged chunk, is
    left out, and ``metadata["gaps"]`` describes the missing rows. If the end of the file is missing (e.g. because of a
    full disk or an interrupted copy), the existing rows are read, ``metadata["truncated"]`` is True, and `final` is
    still that of the complete run.
    """
    contents = parse_contents(path, _read_bytes(Path(path)))
    if LAYOUT not in contents.metadata or RUN not in contents.metadata:
        fix = "use a file that write_mcap or trimtab run wrote"
        fix = "copy the file again from where it was recorded" if contents.is_truncated else fix
        raise InputError(f"log file '{path}'", _missing_content(contents), fix=fix)
    written = contents.metadata[LAYOUT].get("format")
    if written != FORMAT:
        problem = f"has format {written}, but this version reads {FORMAT}"
        raise InputError(f"log file '{path}'", problem, fix="read the file with the version of trimtab that wrote it")
    try:
        return _build_log(contents)
    except Exception as error:  # other tools may have changed anything, and the message must name the file
        problem = f"is damaged: {getattr(error, 'problem', error)}"
        raise InputError(f"log file '{path}'", problem, fix="write the log again") from None


@contextmanager
def replace_file(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Open a new file for writing, which replaces the file `path` when it is complete.

    If an error occurs, the old file is not changed.
    """
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


def _read_bytes(path: Path) -> bytes:
    try:
        data = read_user_bytes(path)
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        raise InputError(f"log file '{path}'", problem, fix=f"check the path; {_how_to_write()}") from None
    if not data.startswith(MAGIC):
        raise InputError(f"log file '{path}'", "is not an MCAP file" if data else "is empty", fix=_how_to_write())
    return data


def _how_to_write() -> str:
    shell = "trimtab run SCENARIO --out DIR  writes a log, DIR/run.mcap"
    return command(shell, 'write_log(simulate("SCENARIO"), "run.mcap")  writes a log')


def _write_rows(writer: "Writer", log: Log, channels: list[tuple[int, Fields]], rows: slice) -> None:
    texts = [(channel, message_texts(log, fields, rows)) for channel, fields in channels]
    add = writer.add_message
    for i, time in enumerate((log.ticks[rows] * NS_PER_TICK).tolist()):
        for channel, messages in texts:
            add(channel, time, messages[i], time, rows.start + i)


def _missing_content(contents: Contents) -> str:
    """Return the reason why a file does not contain the metadata records of a trimtab log, for an error message."""
    if not contents.is_truncated:
        return "is an MCAP file, but not a log of trimtab"
    known = {key: load_json(text) for key, text in contents.metadata.get(RUN, {}).items()}
    rest = [f"{key} {known[key]}" for key in ("scenario", "seed") if key in known]
    said = f"; the rest of the file gives {', '.join(rest)}" if rest else ""
    return f"is cut before the first sample, within the description of the log{said}"


def _build_log(contents: Contents) -> Log:
    layout = contents.metadata[LAYOUT]
    signals, declared, final = (load_json(layout[name]) for name in ("signals", "declared", "final"))
    metadata = {key: load_json(text) for key, text in contents.metadata[RUN].items()}
    by_topic = group_by_topic(tuple(signals))
    if any(contents.texts.values()):  # another tool may have removed topics
        by_topic = {topic: fields for topic, fields in by_topic.items() if topic in contents.texts}
    epoch = int(contents.metadata.get(CLOCK, {}).get(EPOCH, 0))
    if epoch:
        metadata[EPOCH] = epoch
    joined = join_by_time({topic: contents.times.get(topic, []) for topic in by_topic})
    rows = len(joined.times)
    if contents.is_truncated or rows + len(joined.missing) < load_json(layout["rows"]):
        metadata["truncated"] = True
    gaps = describe_gaps(contents.damages, joined, epoch)
    if gaps:
        metadata["gaps"] = gaps
    events = [json.loads(text) for text in contents.texts.get(EVENTS, [])]
    if events:
        seconds = [(time - epoch) // NS_PER_TICK * SECONDS_PER_UNIT for time in contents.times[EVENTS]]
        metadata["events"] = [{"t": t, "text": e["message"]} for t, e in zip(seconds, events, strict=True)]
    arrays: dict[str, np.ndarray] = {}
    for topic, fields in by_topic.items():
        texts = contents.texts.get(topic, [])
        messages = json.loads(b"[" + b",".join(texts[k] for k in joined.places[topic]) + b"]")
        for path, keys in fields.items():
            dtype, shape = np.dtype(signals[path]["dtype"]), signals[path]["shape"]
            arrays[path] = np.array(signal_values(messages, keys), dtype).reshape(rows, *shape)
    ticks = (joined.times - epoch) // NS_PER_TICK
    return Log(
        t=to_seconds(ticks),
        ticks=ticks,
        signals={path: arrays[path] for path in signals if path in arrays},
        declarations={path: parse_quantity(d) for path, d in declared.items()},
        metadata=metadata,
        final={path: np.array(v["value"], v["dtype"])[()] for path, v in final.items()},
    )

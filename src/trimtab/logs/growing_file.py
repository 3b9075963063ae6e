"""MCAP file to which chunks are appended. A chunk is written completely, or the file remains unchanged.

If a chunk does not fit on the disk, the written bytes are removed again, so the file stays valid and can be continued.

Source: MCAP format specification 0 (mcap.dev/spec).
"""

import contextlib
import os
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from trimtab.logs.contents import CHUNK, CHUNK_HEAD, MAGIC, MESSAGE, RECORD
from trimtab.logs.messages import Topic

MESSAGE_INDEX = 0x07
MESSAGE_RECORD = struct.Struct("<BQHIQQ")
LEVEL = 1
"""Compression level of zstd. This level needs a third of the time of the default level, and files of numbers are hardly
larger."""

Message = tuple[int, int, int, bytes]
"""Message in a log file: channel, sequence number, time (ns), text."""


class GrowingFile:
    """MCAP file of a log that is still being written.

    Args:
        file: descriptor of an empty file, open for writing.
        metadata: name -> metadata record. The records are written uncompressed at the start of the file, so that a text
            search in the file finds them.
        topics: topics of the messages. Channel k + 1 belongs to topic k.
    """

    def __init__(self, file: int, metadata: dict[str, dict[str, str]], topics: Sequence[Topic]) -> None:
        """Write the beginning of the file. Raise OSError if this fails."""
        from mcap import records

        self._file, self._size, self._sum = file, 0, 0
        self._chunks: list[Any] = []
        self._counts: dict[int, int] = {}
        self._metadata: list[Any] = []
        numbered = list(enumerate(topics, 1))
        self._schemas = [records.Schema(id=k, data=t.text, encoding="jsonschema", name=t.schema) for k, t in numbered]
        self._channels = [
            records.Channel(id=k, topic=t.name, message_encoding="json", metadata={}, schema_id=k) for k, t in numbered
        ]
        self._first = self._last = 0
        self._append(MAGIC + _encode_record([records.Header(profile="", library="trimtab")]))
        self.add_metadata(metadata)
        self._append(_encode_record([*self._schemas, *self._channels]))

    def add_metadata(self, metadata: dict[str, dict[str, str]]) -> None:
        """Add metadata records, which replace earlier records of the same names. Raise OSError if the disk is full."""
        from mcap.records import Metadata, MetadataIndex

        for name, content in metadata.items():
            text, at = _encode_record([Metadata(name=name, metadata=content)]), self._size
            self._append(text)
            self._metadata.append(MetadataIndex(offset=at, length=len(text), name=name))

    def write(self, messages: Sequence[Message]) -> None:
        """Append messages to the file as one chunk. If this fails, raise OSError and leave the file unchanged."""
        import zstandard
        from mcap.records import ChunkIndex

        parts = [
            MESSAGE_RECORD.pack(MESSAGE, 22 + len(text), channel, sequence, time, time) + text
            for channel, sequence, time, text in messages
        ]
        raw = b"".join(parts)
        packed = zstandard.ZstdCompressor(level=LEVEL).compress(raw)
        times = [time for _, _, time, _ in messages]
        first, last = min(times), max(times)
        head = CHUNK_HEAD.pack(first, last, len(raw), zlib.crc32(raw)) + struct.pack("<I", 4) + b"zstd"
        head += struct.pack("<Q", len(packed))
        chunk = RECORD.pack(CHUNK, len(head) + len(packed)) + head + packed
        indices, offsets = _message_indices(messages, parts, self._size + len(chunk))
        at, inside = self._size, sum(map(len, indices))
        self._append(chunk + b"".join(indices))
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=at,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=last,
            message_index_length=inside,
            message_index_offsets=offsets,
            message_start_time=first,
            uncompressed_size=len(raw),
        )
        self._chunks.append(index)
        self._first = min(self._first, first) if self._counts else first
        self._last = max(last, self._last)
        for channel, _, _, _ in messages:
            self._counts[channel] = self._counts.get(channel, 0) + 1

    def finish(self) -> None:
        """Write the summary and the end of the file. Raise OSError if the disk is full."""
        from mcap import records
        from mcap.opcode import Opcode

        end = _encode_record([records.DataEnd(data_section_crc=self._sum)])
        start = self._size + len(end)
        counted = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=self._last,
            message_start_time=self._first,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [counted]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        text, places = b"", []
        for opcode, group in groups:
            part = _encode_record(group)
            place = {"group_start": start + len(text), "group_length": len(part)}
            places.append(records.SummaryOffset(group_opcode=opcode, **place))
            text += part
        offsets = start + len(text)
        text += _encode_record(places)
        footer = _encode_record([records.Footer(summary_start=start, summary_offset_start=offsets, summary_crc=0)])[:-4]
        footer += struct.pack("<I", zlib.crc32(text + footer))
        self._append(end + text + footer + MAGIC)

    def close(self) -> None:
        """Close the file descriptor."""
        os.close(self._file)

    def _append(self, data: bytes) -> None:
        """Append bytes to the file. If this fails, raise OSError and leave the file unchanged."""
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.pwrite(self._file, rest, self._size + len(data) - len(rest)) :]
            os.fsync(self._file)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise
        self._size += len(data)
        self._sum = zlib.crc32(data, self._sum)

    @property
    def size(self) -> int:
        """Return the size of the file in bytes."""
        return self._size


def _encode_record(items: Sequence[Any]) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    for item in items:
        item.write(builder)
    return builder.end()


def _message_indices(messages: Sequence[Message], parts: list[bytes], at: int) -> tuple[list[bytes], dict[int, int]]:
    """Return the message index of each channel in a chunk, and channel -> position of its index in the file.

    at: position of the first index in the file.
    """
    channels = np.array([m[0] for m in messages])
    starts = np.cumsum([0, *map(len, parts[:-1])])
    pairs = np.stack([np.array([m[2] for m in messages], np.uint64), starts.astype(np.uint64)], axis=1)
    indices, offsets = [], {}
    for channel in np.unique(channels).tolist():
        body = pairs[channels == channel].astype("<u8").tobytes()
        offsets[channel] = at
        indices.append(RECORD.pack(MESSAGE_INDEX, 6 + len(body)) + struct.pack("<HI", channel, len(body)) + body)
        at += len(indices[-1])
    return indices, offsets

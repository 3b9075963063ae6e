"""Content of an MCAP file, up to its end or to a cut; a cut chunk is decompressed as far as possible.

Source: MCAP format specification 0 (mcap.dev/spec), section "Records".
"""

import dataclasses
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any

from trimtab.core.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
"""Bytes at both ends of a file."""
FOOTER, CHANNEL, MESSAGE, CHUNK, METADATA, DATA_END = 0x02, 0x04, 0x05, 0x06, 0x0C, 0x0F
RECORD, MESSAGE_HEAD, CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")


@dataclasses.dataclass
class Contents:
    """Metadata records by name, times (ns) and texts of messages by topic. is_truncated: True without an end."""

    is_truncated: bool
    metadata: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    times: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    texts: dict[str, list[bytes]] = dataclasses.field(default_factory=dict)
    channels: dict[int, str] = dataclasses.field(default_factory=dict)


class _DamagedFileError(Exception):
    """The file contains bytes that no writer produces."""


def parse_contents(path: Any, data: bytes) -> Contents:
    """Parse a file that begins as MCAP; raise InputError if it is damaged, not merely cut."""
    contents = Contents(is_truncated=len(data) < 2 * len(MAGIC) or not data.endswith(MAGIC))
    try:
        for opcode, start, stop in _records(data, len(MAGIC)):
            if opcode == DATA_END:
                _verify_check_sum(data, start)
            if opcode == FOOTER:
                break
            _add_record(contents, opcode, data[start:stop], whole=stop <= len(data))
    except Exception as error:  # a cut file may end anywhere; decoders raise any type
        if not contents.is_truncated:
            problem = f"is damaged: {error or type(error).__name__}"
            raise InputError(f"log file '{path}'", problem, fix="make or copy the file again") from None
    return contents


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and stop of each record's content; the last may stop beyond the end."""
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        yield opcode, at, at + length
        at += length


def _verify_check_sum(data: bytes, start: int) -> None:
    (wanted,) = struct.unpack_from("<I", data, start)
    if wanted and wanted != zlib.crc32(memoryview(data)[: start - RECORD.size]):
        raise _DamagedFileError("its check sum is wrong")


def _add_record(contents: Contents, opcode: int, content: bytes, *, whole: bool) -> None:
    """Add a record; of a truncated record only a chunk is usable."""
    if opcode == CHUNK:
        inner = _decompress_chunk(content) if whole else _decompress_partial_chunk(content)
        for kind, start, stop in _records(inner, 0):
            if stop <= len(inner):
                _add_record(contents, kind, inner[start:stop], whole=True)
        return
    if not whole:
        return
    if opcode == MESSAGE:
        channel, _, time, _ = MESSAGE_HEAD.unpack_from(content)
        topic = contents.channels[channel]
        contents.times[topic].append(time)
        contents.texts[topic].append(content[MESSAGE_HEAD.size :])
    elif opcode in (CHANNEL, METADATA):
        _add_description(contents, opcode, content)


def _add_description(contents: Contents, opcode: int, content: bytes) -> None:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Channel, Metadata

    stream = ReadDataStream(BytesIO(content))
    if opcode == METADATA:
        item = Metadata.read(stream)
        contents.metadata[item.name] = item.metadata
        return
    channel = Channel.read(stream)
    if channel.id not in contents.channels:
        contents.channels[channel.id] = channel.topic
        contents.times[channel.topic], contents.texts[channel.topic] = [], []


def _decompress_chunk(content: bytes) -> bytes:
    """Return the records in a chunk."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk
    from mcap.stream_reader import get_chunk_data_stream

    stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(content))), validate_crc=True)
    return stream.read(length)


def _decompress_partial_chunk(content: bytes) -> bytes:
    """Return the records at the start of a truncated chunk; its check sum can't be verified."""
    at = CHUNK_HEAD.size
    (length,) = struct.unpack_from("<I", content, at)
    compression = content[at + 4 : at + 4 + length]
    data = content[at + 4 + length + 8 :]
    if compression == b"zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return b"" if compression else data

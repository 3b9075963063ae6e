"""Reader of complete or truncated MCAP files. Damaged chunks are left out and reported.

A truncated chunk is decompressed as far as possible. After a damaged section of the file, reading continues at the next
chunk that is compressed by zstd. All chunks of trimtab's logs are compressed by zstd.

Source: MCAP format specification 0 (mcap.dev/spec), section "Records".
"""

import dataclasses
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, NamedTuple

from trimtab.core.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
"""Bytes at the start and at the end of every MCAP file."""
FOOTER, CHANNEL, MESSAGE, CHUNK, METADATA, DATA_END = 0x02, 0x04, 0x05, 0x06, 0x0C, 0x0F
KNOWN, PRIVATE = range(0x01, 0x10), range(0x80, 0x100)
"""Opcodes (record types) of the MCAP format, and opcodes that programs may use for private records."""
RECORD, MESSAGE_HEAD, CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")
OWN_START = MAGIC + RECORD.pack(0x01, 15) + struct.pack("<II", 0, 7) + b"trimtab"
"""First bytes of every log of trimtab: the header record, with an empty profile, and with the name of the library."""
ZSTD = b"\x04\x00\x00\x00zstd"
"""Bytes that follow the header of a chunk compressed by zstd."""
LARGEST_CHUNK = 1 << 28
"""Largest accepted size of a decompressed chunk, so that a small file cannot fill the memory."""


class Damage(NamedTuple):
    """Damaged section of a file.

    why: description of the damage.  after: time (ns) of the last message before the damage, or None.
    """

    why: str
    after: int | None


@dataclasses.dataclass
class Contents:
    """Content of an MCAP file.

    is_truncated: True if the end of the file is missing.  metadata: name -> metadata record.  times: topic -> times of
    the messages (ns).  texts: topic -> contents of the messages.  damages: damaged sections of the file.
    """

    is_truncated: bool
    metadata: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    times: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    texts: dict[str, list[bytes]] = dataclasses.field(default_factory=dict)
    damages: list[Damage] = dataclasses.field(default_factory=list)


class _DamagedFileError(Exception):
    """Error for a file that contains invalid bytes."""


def parse_contents(path: Any, data: bytes) -> Contents:
    """Parse the bytes of a complete or truncated MCAP file. Raise InputError for damage outside of the chunks."""
    contents = Contents(is_truncated=len(data) < 2 * len(MAGIC) or not data.endswith(MAGIC))
    reader = _ContentsReader(contents)
    try:
        reader.read(data)
    except Exception as error:  # a truncated file may end anywhere; decoders raise errors of any type
        if not contents.is_truncated:
            problem = f"is damaged: {error or type(error).__name__}"
            raise InputError(f"log file '{path}'", problem, fix="write or copy the file again") from None
    reader.sort_by_topic()
    return contents


class _ContentsReader:
    """Reader of one MCAP file. It stores messages by channel, because the topic of a channel may be defined later."""

    def __init__(self, contents: Contents) -> None:
        self._contents = contents
        self._topics: dict[int, str] = {}
        self._messages: dict[int, tuple[list[int], list[bytes]]] = {}
        self._newest: int | None = None

    def read(self, data: bytes) -> None:
        """Read all records of the file. After a damaged section, continue at the next chunk."""
        at = len(MAGIC)
        while at + RECORD.size <= len(data):
            opcode, length = RECORD.unpack_from(data, at)
            start, stop = at + RECORD.size, at + RECORD.size + length
            is_cut = self._contents.is_truncated and stop > len(data)
            if opcode == FOOTER and stop <= len(data):
                return
            if opcode not in KNOWN and opcode not in PRIVATE:
                at = self._skip_damage(data, at, "the bytes between two records are wrong", len(data))
            elif stop > len(data) and not is_cut:
                at = self._skip_damage(data, at, "a record is longer than the file", len(data))
            elif opcode == CHUNK and not is_cut:
                try:
                    inner = _decompress_chunk(data[start:stop])
                except Exception as error:  # decoders raise errors of any type
                    at = self._skip_damage(data, at, f"a chunk is damaged: {error or type(error).__name__}", stop)
                else:
                    self._add_inner(inner)
                    at = stop
            else:
                if opcode == DATA_END and not self._contents.damages:
                    _verify_check_sum(data, start)
                if opcode == CHUNK:
                    self._add_inner(_decompress_partial_chunk(data[start:]))
                elif stop <= len(data):
                    self._add(opcode, data[start:stop])
                at = stop

    def sort_by_topic(self) -> None:
        """Store the messages of each channel under the channel's topic."""
        contents = self._contents
        for topic in self._topics.values():
            contents.times.setdefault(topic, [])
            contents.texts.setdefault(topic, [])
        for channel, (times, texts) in self._messages.items():
            if channel in self._topics:
                contents.times[self._topics[channel]] += times
                contents.texts[self._topics[channel]] += texts

    def _skip_damage(self, data: bytes, at: int, why: str, stop: int) -> int:
        """Store a damage. Return the position of the next chunk, or `stop` if no chunk follows.

        at: position of the damage.  why: description of the damage.
        """
        self._contents.damages.append(Damage(why, self._newest))
        found = data.find(ZSTD, at + RECORD.size + CHUNK_HEAD.size + 1)
        while found >= 0:
            place = found - CHUNK_HEAD.size - RECORD.size
            opcode, length = RECORD.unpack_from(data, place)
            if opcode == CHUNK and place + RECORD.size + length <= len(data):
                return place
            found = data.find(ZSTD, found + 1)
        return max(stop, at + 1)

    def _add_inner(self, inner: bytes) -> None:
        """Store the content of the records in a decompressed chunk."""
        for opcode, start, stop in _records(inner):
            if opcode not in KNOWN and opcode not in PRIVATE:
                return
            if stop <= len(inner):
                self._add(opcode, inner[start:stop])

    def _add(self, opcode: int, content: bytes) -> None:
        if opcode == MESSAGE:
            channel, _, time, _ = MESSAGE_HEAD.unpack_from(content)
            times, texts = self._messages.setdefault(channel, ([], []))
            times.append(time)
            texts.append(content[MESSAGE_HEAD.size :])
            self._newest = time if self._newest is None else max(self._newest, time)
        elif opcode in (CHANNEL, METADATA):
            self._add_description(opcode, content)

    def _add_description(self, opcode: int, content: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Metadata

        stream = ReadDataStream(BytesIO(content))
        if opcode == METADATA:
            item = Metadata.read(stream)
            self._contents.metadata[item.name] = item.metadata
            return
        channel = Channel.read(stream)
        self._topics.setdefault(channel.id, channel.topic)


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode, and start and end of the content, of each record. The last record may be truncated."""
    at = 0
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        yield opcode, at, at + length
        at += length


def _verify_check_sum(data: bytes, start: int) -> None:
    (wanted,) = struct.unpack_from("<I", data, start)
    if wanted and wanted != zlib.crc32(memoryview(data)[: start - RECORD.size]):
        raise _DamagedFileError("the check sum of the data section is wrong")


def _decompress_chunk(content: bytes) -> bytes:
    """Return the decompressed records of a chunk. Raise an error if the chunk's check sum is wrong."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk
    from mcap.stream_reader import get_chunk_data_stream

    size = CHUNK_HEAD.unpack_from(content)[2]
    if size > LARGEST_CHUNK:
        raise _DamagedFileError(f"the chunk states a size of {size} bytes")
    stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(content))), validate_crc=True)
    return stream.read(length)


def _decompress_partial_chunk(content: bytes) -> bytes:
    """Return the records at the start of a truncated chunk, whose check sum can't be verified."""
    at = CHUNK_HEAD.size
    (length,) = struct.unpack_from("<I", content, at)
    compression = content[at + 4 : at + 4 + length]
    data = content[at + 4 + length + 8 :]
    if compression == b"zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return b"" if compression else data

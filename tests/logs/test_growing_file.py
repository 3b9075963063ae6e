"""A file that grows by whole chunks: an error leaves it unchanged, and later chunks are valid."""

import errno
import os

import pytest
from mcap.reader import make_reader

from trimtab.core.errors import InputError
from trimtab.logs.contents import parse_contents
from trimtab.logs.growing_file import GrowingFile
from trimtab.logs.messages import Topic

TOPICS = [Topic("/law", {}, "law", b"{}"), Topic("/imu", {}, "imu", b"{}")]


def messages(k: int):
    return [(1 + i % 2, k, k * 1000 + i // 2, b'{"k":%d}' % k) for i in range(20)]


@pytest.fixture
def made(tmp_path):
    number = os.open(tmp_path / "a.mcap", os.O_WRONLY | os.O_CREAT)
    yield tmp_path / "a.mcap", GrowingFile(number, {"about": {"what": "a test"}}, TOPICS)
    os.close(number)


@pytest.mark.parametrize("allowed", [0, 1, 30])
def test_failed_write_leaves_the_file_unchanged(made, monkeypatch, allowed):
    path, file = made
    file.write(messages(0))
    before, write = path.read_bytes(), os.pwrite

    def little(number, data, at):
        """So many bytes have room."""
        room = len(before) + allowed - at
        if room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(number, bytes(data)[:room], at)

    monkeypatch.setattr(os, "pwrite", little)
    with pytest.raises(OSError, match="No space"):
        file.write(messages(1))
    assert path.read_bytes() == before
    monkeypatch.undo()
    file.write(messages(2))
    file.add_metadata({"about": {"what": "the end"}})
    file.finish()
    assert file.size == path.stat().st_size
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
        assert [m.metadata["what"] for m in reader.iter_metadata()] == ["a test", "the end"]
    wanted = [(TOPICS[c - 1].name, t, data) for k in (0, 2) for c, _, t, data in messages(k)]
    assert sorted(found) == sorted(wanted)
    contents = parse_contents(path, path.read_bytes())
    assert contents.metadata == {"about": {"what": "the end"}}
    assert contents.times["/law"] == [*range(10), *range(2000, 2010)]


def test_chunk_with_wrong_crc_is_damage_or_truncation(made):
    path, file = made
    for k in range(3):
        file.write(messages(k))
    at = path.stat().st_size - 200
    file.finish()
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    with pytest.raises(InputError, match="is damaged"):
        parse_contents(path, bytes(data))
    cut = parse_contents(path, bytes(data[:-1]))
    assert cut.is_truncated
    assert len(cut.texts["/law"]) in (20, 30)


def test_cut_chunk_gives_only_complete_messages(made):
    """An uncompressed chunk keeps all messages before the cut."""
    path, file = made
    file.write(messages(0))
    data = path.read_bytes()
    from mcap.writer import CompressionType, Writer

    with open(path, "wb") as stream:
        writer = Writer(stream, 10**6, CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/law", "json", writer.register_schema("law", "jsonschema", b"{}"))
        for k in range(50):
            writer.add_message(channel, k, b"x" * 100, k)
        writer.finish()
    plain = path.read_bytes()
    start = plain.index(b"x" * 100)
    for n in (1, 20, 49):
        assert len(parse_contents(path, plain[: start + 131 * n - 31]).texts["/law"]) == n
        assert len(parse_contents(path, plain[: start + 131 * n - 32]).texts["/law"]) == n - 1
    assert parse_contents(path, data[:-30]).texts["/law"] in ([], [m[3] for m in messages(0)[::2]])

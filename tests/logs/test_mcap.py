import json
import os
import struct
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap.writer import Writer

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.contents import MAGIC
from trimtab.logs.log import Log
from trimtab.logs.mcap import estimate_size, read_mcap, replace_file, write_mcap
from trimtab.logs.messages import NS_PER_TICK


def made(n: int = 200, **changes) -> Log:
    rng = np.random.default_rng(1)
    ticks = np.cumsum(rng.integers(1, 70_000, n)) - 1
    parts = {
        "t": to_seconds(ticks),
        "ticks": ticks,
        "signals": {
            "truth.heading": rng.normal(size=n) * 10.0 ** rng.integers(-300, 300, n),
            "truth.p_WB": rng.normal(size=(n, 3)),
            "sensors.navigation.value.yaw_rate": rng.normal(size=n).astype(np.float32),
            "sensors.navigation.t": rng.integers(0, 2**62, n),
            "sensors.imu.fresh": rng.random(n) < 0.5,
            "downlink.navigation.age": rng.random(n),
            "law.mode": rng.integers(0, 2, n).astype(np.int32),
            "law.demand.FX": rng.normal(size=n),
            "rng.word": rng.integers(0, 2**32, n).astype(np.uint32),
            "law.flags": rng.random((n, 2)) < 0.5,
        },
        "declarations": {
            "truth.heading": Quantity("rad", "Angle from north; 100 % unwrapped.", kind="angle", source="[1] eq. 2.11"),
            "law.mode": Quantity("1", "Which law.", kind="mode", modes=("damp", "turn")),
            "law.demand.FX": Quantity("N", "Surge force, µN exact.", frame="B", low=-np.inf, high=2.0),
            "truth.p_WB": Quantity("m", "Position.", frame="W", shape=(3,)),
        },
        "metadata": {
            "scenario": "hovercraft/spin",
            "seed": 7,
            "none": None,
            "parameters": {"mass": 2.6, "limit": np.inf, "gap": np.nan, "list": [1, [2.5, -np.inf]], "name": "Ω"},
        },
        "final": {"truth.heading": np.nan, "truth.p_WB": np.array([1.0, np.inf, 0.1]), "law.mode": np.int32(1)},
    }
    return Log(**(parts | changes))


def same_bits(a: np.ndarray, b: np.ndarray) -> None:
    assert a.dtype == b.dtype
    assert a.shape == b.shape
    np.testing.assert_array_equal(a, b)
    if a.dtype.kind == "f":
        np.testing.assert_array_equal(np.signbit(a[~np.isnan(a)]), np.signbit(b[~np.isnan(b)]))


def same(a: Log, b: Log) -> None:
    assert a.paths == b.paths
    same_bits(a.ticks, b.ticks)
    same_bits(a.t, b.t)
    for path in a.paths:
        same_bits(a[path], b[path])
    assert dict(a.declarations) == dict(b.declarations)
    assert repr(dict(a.metadata)) == repr(dict(b.metadata))  # as text, because NaN is not equal to itself
    assert a.final.keys() == b.final.keys()
    for path, value in a.final.items():
        same_bits(np.asarray(value), np.asarray(b.final[path]))


def test_log_round_trip_is_exact(tmp_path):
    log = made()
    assert write_mcap(log, tmp_path / "run.mcap") == tmp_path / "run.mcap"
    same(log, read_mcap(str(tmp_path / "run.mcap")))


def test_empty_log_round_trip(tmp_path):
    log = made().between(1e6, 2e6)
    assert len(log) == 0
    write_mcap(log, tmp_path / "run.mcap")
    same(log, read_mcap(tmp_path / "run.mcap"))


@pytest.mark.thorough
def test_log_of_several_blocks_round_trip(tmp_path):
    log = made(n=9001)
    write_mcap(log, tmp_path / "run.mcap")
    same(log, read_mcap(tmp_path / "run.mcap"))


FLOATS = hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=6), elements=st.floats())


@pytest.mark.thorough
@settings(max_examples=60, deadline=None)
@given(values=FLOATS, single=st.lists(st.floats(width=32), min_size=1, max_size=6))
def test_every_float_round_trips_exactly(tmp_path_factory, values, single):
    n = min(len(values), len(single))
    ticks = np.arange(n)
    narrow = np.array(single[:n], np.float32)
    log = Log(to_seconds(ticks), ticks, {"a.x": values[:n, 0], "a.v": values[:n], "a.s": narrow})
    path = tmp_path_factory.mktemp("float") / "run.mcap"
    write_mcap(log, path)
    same(log, read_mcap(path))


def messages(path: Path) -> list:
    with open(path, "rb") as stream:
        return list(make_reader(stream, validate_crcs=True).iter_messages())


@pytest.mark.thorough
def test_mcap_library_reads_topics_times_and_schemas(tmp_path):
    """Read by the mcap library alone: topics, times in ns, JSON that fits its own schema."""
    log = made()
    write_mcap(log, tmp_path / "run.mcap")
    found = messages(tmp_path / "run.mcap")
    topics = ["/truth", "/sensors/navigation", "/sensors/imu", "/downlink/navigation", "/law", "/rng"]
    assert [channel.topic for _, channel, _ in found[: len(topics)]] == topics
    assert len(found) == len(log) * len(topics)
    for i, (schema, channel, message) in enumerate(found):
        row = i // len(topics)
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert message.log_time == message.publish_time == int(log.ticks[row]) * 100
        assert message.sequence == row
        content = json.loads(message.data, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
        jsonschema.validate(content, json.loads(schema.data))
        if channel.topic == "/sensors/navigation":
            assert content["value"]["yaw_rate"] == log["sensors.navigation.value.yaw_rate"][row]
            assert content["t"] == log["sensors.navigation.t"][row]
    with open(tmp_path / "run.mcap", "rb") as stream:
        reader = make_reader(stream)
        record = next(m for m in reader.iter_metadata() if m.name == "trimtab").metadata
        summary = reader.get_summary()
    assert json.loads(record["scenario"]) == "hovercraft/spin"
    assert json.loads(record["parameters"])["mass"] == 2.6
    assert summary is not None
    assert all(chunk.compression == "zstd" for chunk in summary.chunk_indexes)


def test_nan_and_infinity_are_written_as_null_and_1e999(tmp_path):
    ticks = np.arange(3)
    log = Log(to_seconds(ticks), ticks, {"a.x": np.array([np.nan, np.inf, -np.inf])})
    write_mcap(log, tmp_path / "run.mcap")
    texts = [message.data for _, _, message in messages(tmp_path / "run.mcap")]
    assert texts == [b'{"x":null}', b'{"x":1e999}', b'{"x":-1e999}']


def test_percent_and_quotes_in_names_round_trip(tmp_path):
    ticks = np.arange(2)
    log = Log(to_seconds(ticks), ticks, {'a.50%s "x"': np.array([1.0, 2.0]), "a.%d": np.array([3, 4])})
    write_mcap(log, tmp_path / "run.mcap")
    same(log, read_mcap(tmp_path / "run.mcap"))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A log of many chunks, and the bytes of its file."""
    log = made(n=6000)
    return log, write_mcap(log, tmp_path_factory.mktemp("whole") / "run.mcap").read_bytes()


@pytest.mark.thorough("0.5", "0.75")
@pytest.mark.parametrize("share", [0.3, 0.5, 0.75, 0.95])
def test_truncated_file_is_read_up_to_the_cut(tmp_path, share, written):
    log, data = written
    (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
    cut = read_mcap(tmp_path / "cut.mcap")
    assert cut.metadata["truncated"] is True
    assert cut.metadata["seed"] == 7
    assert share - 0.1 < len(cut) / len(log) <= 1
    for path in log.paths:
        same_bits(cut[path], log[path][: len(cut)])


@pytest.mark.thorough
def test_truncation_at_any_byte_gives_a_log_or_an_error(tmp_path):
    log = made(n=30)
    write_mcap(log, tmp_path / "run.mcap")
    data = (tmp_path / "run.mcap").read_bytes()
    lengths: list[int] = []
    for end in range(0, len(data), 41):
        (tmp_path / "cut.mcap").write_bytes(data[:end])
        try:
            cut = read_mcap(tmp_path / "cut.mcap")
        except InputError:
            assert not lengths  # refused only before the metadata is whole
            continue
        assert cut.metadata["truncated"] is True
        lengths.append(len(cut))
        for path in log.paths:
            same_bits(cut[path], log[path][: len(cut)])
    assert lengths[-1] == 30
    assert lengths == sorted(lengths)


def chunk_places(data):
    """Start and stop of each chunk's record."""
    places, at = [], len(MAGIC)
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:
            places.append((at, at + 9 + length))
        at += 9 + length
    return places


def spoil(data, place, how):
    start, stop = place
    bad = bytearray(data)
    if how == "bit":
        bad[(start + stop) // 2] ^= 0x10
    elif how == "zeros":
        bad[start : min(start + 4096, stop)] = bytes(min(4096, stop - start))
    elif how == "length":
        bad[start + 1 : start + 9] = struct.pack("<Q", 1 << 40)
    elif how == "noise":
        bad[start:stop] = np.random.default_rng(1).bytes(stop - start)
    elif how == "short":
        bad[start + 1 : start + 9] = struct.pack("<Q", 100)
    return bytes(bad)


@pytest.mark.thorough(*(f"{which}-{how}" for which in (0, -1) for how in ("zeros", "length", "noise", "short")))
@pytest.mark.parametrize("how", ["bit", "zeros", "length", "noise", "short"])
@pytest.mark.parametrize("which", [0, 3, -1])
def test_damage_loses_only_its_chunk_and_is_reported(tmp_path, how, which, written):
    log, data = written
    places = chunk_places(data)
    assert len(places) > 6
    (tmp_path / "bad.mcap").write_bytes(spoil(data, places[which], how))
    read = read_mcap(tmp_path / "bad.mcap")
    kept = np.isin(log.ticks, read.ticks)
    lost = np.flatnonzero(~kept)
    assert 0 < len(lost) < 2.5 * len(log) / len(places)
    assert (np.diff(lost) == 1).all()
    for path in log.paths:
        same_bits(read[path], log[path][kept])
    texts = [gap["text"] for gap in read.metadata["gaps"]]
    assert any("damaged" in t or "wrong" in t or "longer" in t for t in texts)
    if which == 3:
        assert read.metadata["gaps"][0]["after_s"] == pytest.approx(log.t[lost[0] - 1])


def test_missing_message_drops_its_row_without_mixing_instants(tmp_path):
    """`mcap recover` and tools that filter messages write such files."""
    log = made(n=400)
    write_mcap(log, tmp_path / "run.mcap")
    with open(tmp_path / "run.mcap", "rb") as source, open(tmp_path / "less.mcap", "wb") as stream:
        reader, writer, channels = make_reader(source), Writer(stream), {}
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "json", schema_id)
            if channel.topic != "/law" or message.log_time // NS_PER_TICK != log.ticks[100]:
                writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    read = read_mcap(tmp_path / "less.mcap")
    kept = np.arange(400) != 100
    np.testing.assert_array_equal(read.ticks, log.ticks[kept])
    for path in log.paths:
        same_bits(read[path], log[path][kept])
    (gap,) = read.metadata["gaps"]
    assert gap["after_s"] == pytest.approx(log.t[99])
    assert gap["text"].startswith("1 instants, ")
    assert "truncated" not in read.metadata


def test_rejects_file_with_damaged_description(tmp_path):
    write_mcap(made(), tmp_path / "run.mcap")
    data = bytearray((tmp_path / "run.mcap").read_bytes())
    data[len(MAGIC) + 60] ^= 0x10
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(InputError, match=r"is damaged|not a log of trimtab"):
        read_mcap(tmp_path / "bad.mcap")


def test_file_with_removed_topics_is_read(tmp_path):
    log = made(n=50)
    write_mcap(log, tmp_path / "run.mcap")
    with open(tmp_path / "run.mcap", "rb") as source, open(tmp_path / "less.mcap", "wb") as stream:
        reader, writer = make_reader(source), Writer(stream)
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        schema_id = writer.register_schema("trimtab.law", "jsonschema", b"{}")
        channel = writer.register_channel("/law", "json", schema_id)
        for _, _, message in reader.iter_messages(topics=["/law"]):
            writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    less = read_mcap(tmp_path / "less.mcap")
    assert less.paths == ("law.mode", "law.demand.FX", "law.flags")
    assert "truncated" not in less.metadata
    for path in less.paths:
        same_bits(less[path], log[path])


def test_rejects_reading_missing_or_other_files(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_mcap(tmp_path / "missing.mcap")
    with pytest.raises(InputError, match="cannot be read"):
        read_mcap(tmp_path)
    (tmp_path / "text.mcap").write_text("t,heading\n0,1\n")
    with pytest.raises(InputError, match="not an MCAP file"):
        read_mcap(tmp_path / "text.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(InputError, match="is empty"):
        read_mcap(tmp_path / "empty.mcap")
    with open(tmp_path / "other.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(InputError, match="not a log of trimtab"):
        read_mcap(tmp_path / "other.mcap")


def test_rejects_a_newer_format_version(tmp_path):
    with open(tmp_path / "new.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("trimtab", {})
        writer.add_metadata("trimtab.layout", {"format": "2"})
        writer.finish()
    with pytest.raises(InputError, match="has format 2, but this version reads 1"):
        read_mcap(tmp_path / "new.mcap")


def test_rejects_writing_to_invalid_destinations(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="mkdir -p"):
        write_mcap(made(), tmp_path / "no" / "run.mcap")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_mcap(made(), tmp_path / "file" / "run.mcap")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_mcap(made(), tmp_path / "folder")

    def refuse(*_args, **_keywords):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(InputError, match="Permission denied"):
        write_mcap(made(), tmp_path / "run.mcap")
    monkeypatch.undo()
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("bug"), KeyboardInterrupt()])
def test_write_error_leaves_the_old_file_unchanged(tmp_path, monkeypatch, error):
    write_mcap(made(), tmp_path / "run.mcap")
    before = (tmp_path / "run.mcap").read_bytes()

    def fail(_self):
        raise error

    monkeypatch.setattr(Writer, "finish", fail)
    expected = InputError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        write_mcap(made(n=1000), tmp_path / "run.mcap")
    assert (tmp_path / "run.mcap").read_bytes() == before
    assert os.listdir(tmp_path) == ["run.mcap"]


def test_new_file_has_default_permissions(tmp_path):
    (tmp_path / "usual").write_text("")
    with replace_file(tmp_path / "new") as stream:
        stream.write(b"x")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.thorough("30000")
@pytest.mark.parametrize("rows", [0, 1, 900, 30_000])
def test_estimated_log_size_is_close_to_file_size(tmp_path, rows):
    """The log is constant at first, so its first rows alone would give a much smaller estimate."""
    rng = np.random.default_rng(3)
    x = np.where(np.arange(rows)[:, None] < rows / 3, 0.0, rng.standard_normal((rows, 6)))
    ticks = np.arange(rows) * ms(1)
    log = Log(to_seconds(ticks), ticks, {"truth.x": x, "law.y": rng.standard_normal(rows)})
    size = write_mcap(log, tmp_path / "one.mcap").stat().st_size
    assert size / 1.5 < estimate_size(log) < 1.5 * size

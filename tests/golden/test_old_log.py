"""Regression test: a recorded flight replays to the bit.

`old-log.mcap` is what `trimtab run hovercraft/forward --duration 0.25 --seed 4 --no-ideal --out DIR` wrote.
"""

import json
import math
from pathlib import Path

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer

from trimtab.cli import main

OLD = Path(__file__).parent / "old-log.mcap"
STEPS = 250
TICK_NS = 1_000_000


def replayed(file):
    done = CliRunner().invoke(main, ["replay", str(file), "--json"])
    assert done.exit_code in (0, 1), done.output
    return done.exit_code, json.loads(done.stdout)


def rewritten(target, change):
    """The old log with its messages passed through `change(topic, time_ns, content)`; all else as it is."""
    with OLD.open("rb") as source, target.open("wb") as stream:
        reader, writer = make_reader(source), Writer(stream)
        writer.start(library="trimtab")
        for found in reader.iter_metadata():
            writer.add_metadata(found.name, found.metadata)
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                kept = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kept)
            content = json.loads(message.data)
            change(channel.topic, message.log_time, content)
            data = json.dumps(content, separators=(",", ":")).encode()
            times = {"log_time": message.log_time, "publish_time": message.publish_time}
            writer.add_message(channels[channel.id], data=data, sequence=message.sequence, **times)
        writer.finish()
    return target


def test_old_log_replays_bit_for_bit():
    code, found = replayed(OLD)
    assert (code, found["equal"], found["first"], found["steps"]) == (0, True, None, STEPS)
    assert found["exact"] or not found["strict"]  # strict where the machine and the backend are those of the log


@pytest.mark.thorough
def test_rewritten_log_replays_bit_for_bit(tmp_path):
    code, found = replayed(rewritten(tmp_path / "same.mcap", lambda *_: None))
    assert (code, found["equal"], found["steps"]) == (0, True, STEPS)


@pytest.mark.thorough
@pytest.mark.parametrize(("topic", "path"), [("/command", "value.rudder_pulse"), ("/law", "demand.FY")])
def test_replay_detects_flipped_last_bit(tmp_path, topic, path):
    block, name = path.split(".")

    def flip(where, time_ns, content):
        if (where, time_ns) == (topic, 200 * TICK_NS):
            content[block][name] = math.nextafter(content[block][name], math.inf)

    wrong = rewritten(tmp_path / "wrong.mcap", flip)
    code, found = replayed(wrong)
    if not found["strict"]:
        pytest.skip("this machine or backend is not that of the log, so bits can't be asked for")
    first = found["first"]
    assert (code, found["equal"]) == (1, False)
    assert (first["t"], first["path"]) == (pytest.approx(0.2, abs=1e-9), f"{topic[1:]}.{path}")
    assert first["recorded"] == math.nextafter(first["replayed"], math.inf)
